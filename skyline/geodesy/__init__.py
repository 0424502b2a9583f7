"""Positions on the Earth and on maps, and directions from north."""
