"""Well-known elevation products: bare ground, or trees and houses too."""

import re
from collections.abc import Sequence
from pathlib import Path

import rasterio
from rasterio.errors import RasterioError

SURFACE = "surface (DSM)"
GROUND = "bare ground (DTM)"
UNKNOWN = "not known"

_PRODUCTS = (
    (r"fabdem", "FABDEM", GROUND),
    (r"copernicus|glo-?[39]0|eu-?dem", "Copernicus", SURFACE),
    (r"aw3d|alpsmlc30", "AW3D", SURFACE),
    (r"nasadem", "NASADEM", SURFACE),
    (r"srtm", "SRTM", SURFACE),
    (r"astgtm|aster[ _-]?gdem", "ASTER GDEM", SURFACE),
    (r"tdm1_dem|tandem-?x", "TanDEM-X", SURFACE),
    (r"3dep|usgs_(13|1|1m|one_meter)_", "3DEP", GROUND),
    (r"swissalti3d", "swissALTI3D", GROUND),
    (r"arcticdem", "ArcticDEM", SURFACE),
    (r"(?<![a-z])dsm(?![a-z])", "", SURFACE),
    (r"(?<![a-z])(dtm|dgm|dem_bare)(?![a-z])", "", GROUND),
)
"""Patterns of the names and tags of files, the product of each, and what the product shows; the
first pattern that is found counts."""


def model_of(files: Sequence[str]) -> str:
    """Return what a DEM shows, by its files' names and tags.

    The result is `SURFACE` or `GROUND` with the product, and `UNKNOWN` where these say nothing, or
    where the files differ.
    """
    models = {_model_of_file(file) for file in files}
    return models.pop() if len(models) == 1 else UNKNOWN


def _model_of_file(file: str) -> str:
    """Return what a file shows, by its name or else its tags."""
    for text in (Path(file).name, *_tags(file)):
        for pattern, product, model in _PRODUCTS:
            if re.search(pattern, text.lower()):
                return f"{model}, {product}" if product else model
    return UNKNOWN


def _tags(file: str) -> list[str]:
    """Return a raster's tag values and band descriptions."""
    if file.lower().endswith(".gz"):  # An .hgt, which has none
        return []
    try:
        with rasterio.open(file) as dataset:
            return [*map(str, dataset.tags().values()), *filter(None, dataset.descriptions)]
    except RasterioError:
        return []
