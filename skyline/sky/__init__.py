"""The sun, the moon and the sky: where they stand, and what terrain hides."""
