"""What the sun needs of a place: its horizon, when the sun is above it, how much sky there is."""
