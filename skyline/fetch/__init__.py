"""Fetching elevation tiles and named peaks from servers."""
