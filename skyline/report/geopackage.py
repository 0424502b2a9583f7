"""Places of a store as a GeoPackage; QGIS draws each as the square of ground that it represents.

The file holds the style too, in QGIS's own table of styles, so that QGIS applies it at once.
"""

import contextlib
import io
import sqlite3
from pathlib import Path

from skyline.errors import InputError
from skyline.files import write_whole
from skyline.store import Store

_LAYER = "places"
_STYLE = Path(__file__).with_name("places.qml")
_STYLES_TABLE = """
CREATE TABLE layer_styles (
    id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256),
    f_table_schema TEXT(256), f_table_name TEXT(256), f_geometry_column TEXT(256),
    styleName TEXT(30), styleQML TEXT, styleSLD TEXT, useAsDefault BOOLEAN, description TEXT,
    owner TEXT(30), ui TEXT(30), update_time DATETIME
);
INSERT INTO gpkg_contents (table_name, data_type, identifier) VALUES
    ('layer_styles', 'attributes', 'layer_styles');
"""


def write_geopackage(store: Store, path: Path) -> int:
    """Write the places of a store as points, with spacing and tolerance; return how many.

    Parameters
    ----------
    store : Store
        A store of places.
    path : Path
        Ends in ``.gpkg``; written whole or not at all.

    Raises
    ------
    InputError
        The store holds renderings, the suffix is another, the file cannot be written, or GeoPandas
        is not installed.
    StoreError
        The store's data are damaged.
    """
    if path.suffix.lower() != ".gpkg":
        raise InputError(f"--output is {path}; expected a name that ends in .gpkg")
    table = store.to_geodataframe()
    # The file is made in memory: SQLite needs file locks, which some network folders lack.
    held = io.BytesIO()
    table.to_file(held, layer=_LAYER, driver="GPKG")
    with contextlib.closing(sqlite3.connect(":memory:")) as file:
        file.deserialize(held.getvalue())
        file.executescript(_STYLES_TABLE)
        file.execute(
            "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, "
            "f_geometry_column, styleName, styleQML, useAsDefault, update_time) VALUES "
            "('', '', ?, 'geom', 'places', ?, 1, strftime('%Y-%m-%dT%H:%M:%fZ', 'now'))",
            (_LAYER, _STYLE.read_text(encoding="utf-8")),
        )
        file.commit()
        write_whole(path, file.serialize())
    return len(table)
