"""Horizons of places, the sun above them, and how much of the sky they leave."""
