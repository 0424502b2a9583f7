"""The places of a store as a GeoPackage."""

import io
from pathlib import Path

from skyline.errors import suffix_of
from skyline.files.disk import write_whole
from skyline.store.read import Store


def write_geopackage(store: Store, path: Path) -> int:
    """Write the places of a store as points of a GeoPackage.

    A point has its spacing and tolerance. Returns the number of places.

    Raises `InputError` for a store of renderings, for a path that cannot be written or does not end
    in ``.gpkg``, and without GeoPandas; `StoreError` for damaged data.
    """
    suffix_of(path, [".gpkg"])
    table = store.to_geodataframe()
    # The file is made in memory: SQLite needs file locks, which some network folders lack.
    held = io.BytesIO()
    table.to_file(held, layer="places", driver="GPKG")
    write_whole(path, held.getvalue())
    return len(table)
