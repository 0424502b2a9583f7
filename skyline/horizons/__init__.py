"""Horizons all the way round: of places, and of every sample of a model."""
