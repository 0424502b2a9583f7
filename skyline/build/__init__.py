"""Building stores: grids and spacing of places, parts of the work, and workers."""
