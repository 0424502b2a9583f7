"""Local horizons of places, hours of sun above them, and sky view factors."""
