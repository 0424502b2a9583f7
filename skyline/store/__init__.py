"""The HDF5 reference store: what many eyes see, one row each.

A store holds renderings (views with their skylines and keypoints) or places (see
`skyline.places`); all but the rows' layout is the same.

One process writes, any number read at the same time. The writer uses HDF5's single-writer,
multiple-reader mode (SWMR), which orders its writes so that the file is whole at every instant:
a writer killed between any two writes leaves every committed row readable. Without that mode,
one kill in three between two writes damaged the file.

SWMR does not lock, so the writer holds ``STORE.lock`` beside the store. A killed writer leaves
its mark in the file (see `skyline.store.superblock`); the next `open_for_append` then copies the
committed rows to a fresh file, which takes the store's name once it is complete.

Renderings are held as rendered ("exact") or rounded to a stated error ("compact", see
`skyline.store.coding`); readers get float32 either way. Every chunk of rows has a checksum that
readers verify, every row and the header one of their own (see `skyline.store.rows`).
"""

from skyline.store.built import Built
from skyline.store.coding import RowCoding
from skyline.store.copying import CopyReport, compact_store, merge_stores, repair_store
from skyline.store.header import SCHEMA, SCHEMA_VERSION, KeypointColumns, StoreHeader
from skyline.store.integrity import Damage, StoreReport, check_store
from skyline.store.place_map import PlaceMap
from skyline.store.reader import Locations, RowIndex, Store, is_store, open_store
from skyline.store.rows import as_stored
from skyline.store.writer import StoreWriter, amend_config, create_store, open_for_append

__all__ = [
    "SCHEMA",
    "SCHEMA_VERSION",
    "Built",
    "CopyReport",
    "Damage",
    "KeypointColumns",
    "Locations",
    "PlaceMap",
    "RowCoding",
    "RowIndex",
    "Store",
    "StoreHeader",
    "StoreReport",
    "StoreWriter",
    "amend_config",
    "as_stored",
    "check_store",
    "compact_store",
    "create_store",
    "is_store",
    "merge_stores",
    "open_for_append",
    "open_store",
    "repair_store",
]
