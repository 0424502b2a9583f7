"""Synthetic queries with known answers: skylines, photographs, and the terrain they show."""
