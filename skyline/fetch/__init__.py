"""Elevation tiles and peaks from servers."""
