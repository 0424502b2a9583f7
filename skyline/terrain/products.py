"""Which known elevation product a file is of, and whether that is a surface or the bare ground."""

import re
from collections.abc import Sequence
from pathlib import Path

import rasterio
from rasterio.errors import RasterioError

SURFACE, GROUND, UNKNOWN = "surface (DSM)", "bare ground (DTM)", "not known"

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
"""Patterns of names and tags, the product, and what it is a model of; the first found counts."""


def model_of(files: Sequence[str]) -> str:
    """Return whether a DEM is a model of the surface or of the bare ground, as far as it says.

    The names and tags of its files are looked at. It is `SURFACE` or `GROUND`, with the product
    where that is known, or `UNKNOWN`: also where files differ.
    """
    models = {_model_of_file(file) for file in files}
    return models.pop() if len(models) == 1 else UNKNOWN


def _model_of_file(file: str) -> str:
    for text in (Path(file).name, *_tags(file)):
        for pattern, product, model in _PRODUCTS:
            if re.search(pattern, text.lower()):
                return f"{model}, {product}" if product else model
    return UNKNOWN


def _tags(file: str) -> list[str]:
    if file.lower().endswith(".gz"):  # an .hgt, which has none
        return []
    try:
        with rasterio.open(file) as dataset:
            return [*map(str, dataset.tags().values()), *filter(None, dataset.descriptions)]
    except RasterioError:
        return []
