"""Elevation tiles and peaks from servers: cloud-optimized GeoTIFFs, read over HTTP by windows.

A source is a template of addresses, one tile a degree of latitude and longitude. Of each tile only
the part inside the bounds is read, and written whole or not at all.
"""
