"""Elevation tiles and peaks from servers: cloud-optimized GeoTIFFs, read over HTTP by windows.

A source is a template of addresses, one tile a degree of latitude and longitude. Of each tile only
the part inside the bounds is read, and written whole or not at all.
"""

from skyline.fetch.overpass import fetch_peaks
from skyline.fetch.remote import HttpOptions
from skyline.fetch.sources import SOURCES, TileSource
from skyline.fetch.tiles import FetchResult, fetch_dem

__all__ = ["SOURCES", "FetchResult", "HttpOptions", "TileSource", "fetch_dem", "fetch_peaks"]
