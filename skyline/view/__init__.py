"""What a camera sees at a pose: the skyline, named summits, sun and moon."""
