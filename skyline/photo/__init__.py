"""Photos, sky masks and traces to query skylines."""

from skyline.photo.extract import extract_skyline
from skyline.photo.query import QuerySkyline
from skyline.photo.read import extract_photo, read_picture, read_query, write_overlay
from skyline.photo.trace import read_trace, write_trace

__all__ = [
    "QuerySkyline",
    "extract_photo",
    "extract_skyline",
    "read_picture",
    "read_query",
    "read_trace",
    "write_overlay",
    "write_trace",
]
