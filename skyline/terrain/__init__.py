"""Terrain: elevation files to a metric grid of samples, and eyes that stand on it."""
