"""Photos, sky masks and traces to query skylines."""

from skyline.photo.correction import Correction, Stroke, StrokeKind
from skyline.photo.decode import Photo
from skyline.photo.exif import NotedPlace
from skyline.photo.extract import extract_skyline
from skyline.photo.lens import Lens
from skyline.photo.projection import Projection
from skyline.photo.query import QuerySkyline
from skyline.photo.read import (
    check_fov,
    extract_photo,
    read_photo,
    read_picture,
    read_query,
    write_overlay,
)
from skyline.photo.sky_model import SkySession, load_sky_model
from skyline.photo.trace import read_trace, write_trace

__all__ = [
    "Correction",
    "Lens",
    "NotedPlace",
    "Photo",
    "Projection",
    "QuerySkyline",
    "SkySession",
    "Stroke",
    "StrokeKind",
    "check_fov",
    "extract_photo",
    "extract_skyline",
    "load_sky_model",
    "read_photo",
    "read_picture",
    "read_query",
    "read_trace",
    "write_overlay",
    "write_trace",
]
