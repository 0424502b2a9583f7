"""Ground in photos: its places, lines and areas, and where rays cross."""
