"""Where things are on the Earth and on a map, and which way north is."""
