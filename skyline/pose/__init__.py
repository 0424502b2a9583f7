"""Poses of cameras: fitted, noted, in files, and their errors."""
