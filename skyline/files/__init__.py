"""Files: read, written, listed and locked, and the formats of other programs."""
