"""Building stores: plans of places, parts of stores, and workers."""
