"""Photos, sky masks and traces to query skylines."""

from skyline.photo.extract import extract_skyline
from skyline.photo.projection import Projection
from skyline.photo.query import QuerySkyline
from skyline.photo.read import extract_photo, read_picture, read_query, write_overlay
from skyline.photo.sky_model import SkySession, load_sky_model
from skyline.photo.trace import read_trace, write_trace

__all__ = [
    "Projection",
    "QuerySkyline",
    "SkySession",
    "extract_photo",
    "extract_skyline",
    "load_sky_model",
    "read_picture",
    "read_query",
    "read_trace",
    "write_overlay",
    "write_trace",
]
