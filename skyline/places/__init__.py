"""Places: what a search compares a photo with, in few bytes each.

A place is an eye, its skyline all the way round, how far off that skyline is, and how far around
the eye it stands for. Places are rendered when a store is built and mapped when it is opened.
"""

from skyline.places.coding import BINS, DISTANCE_BINS, PHASE_BINS
from skyline.places.places import Places, PlaceSource

__all__ = ["BINS", "DISTANCE_BINS", "PHASE_BINS", "PlaceSource", "Places"]
