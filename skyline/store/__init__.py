"""The store: an HDF5 file of renderings (views with skylines and keypoints) or of places.

A store is written once, takes its name when its bytes are on disk, and is never appended to.
`skyline.build.parts` writes the parts of a store and merges them.
"""

from skyline.store.format import StoreHeader, columns_of
from skyline.store.read import PlaceMap, Store, is_store, open_store
from skyline.store.write import (
    StoreReport,
    check_store,
    merge_stores,
    open_joined,
    repair_store,
    write_store,
)

__all__ = [
    "PlaceMap",
    "Store",
    "StoreHeader",
    "StoreReport",
    "check_store",
    "columns_of",
    "is_store",
    "merge_stores",
    "open_joined",
    "open_store",
    "repair_store",
    "write_store",
]
