"""Terrain: elevation files, the metric grid read from them, and viewpoints."""
