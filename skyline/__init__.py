"""Skyline."""
