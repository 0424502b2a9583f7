"""Poses of cameras: on maps, in columns and in files, and their errors."""
