"""The types of results: `make check` lets mypy check this file strictly.

It is not for running: python -m mypy --strict examples/typed_results.py
"""

from typing import assert_type

import numpy as np
from numpy.typing import NDArray
from xarray import DataArray, Dataset

from skyline import (
    HeightField,
    LocalHorizons,
    Matcher,
    MatchResult,
    Narrowing,
    PixelPlaces,
    Pose,
    Viewer,
    horizon,
    horizon_grid,
    locate,
    read_dem,
    sky_view_grid,
)


def of_a_model(model: DataArray) -> None:
    """Take a DataArray wherever a DEM goes."""
    assert_type(read_dem(model), HeightField)
    places = horizon(model, lon=[9.8, 9.9], lat=46.8, ids=["A", "B"])
    assert_type(places, LocalHorizons)
    assert_type(places[0], LocalHorizons)
    assert_type(places.sel("A"), LocalHorizons)
    assert_type([one.lon for one in places], list[NDArray[np.float64]])
    assert_type(places.to_xarray(), Dataset)
    assert_type(sky_view_grid(model), DataArray)
    assert_type(horizon_grid(["a.tif", "b.tif"], step_deg=3.0), DataArray)


def of_a_photo(terrain: HeightField) -> Pose | None:
    """Match a photo, and look at its answer."""
    with Matcher("alps.h5", terrain) as matcher:
        found = matcher.match("photo.jpg", fov_deg=60.0, narrowing=Narrowing(near=(9.8, 46.8, 3.0)))
    assert_type(found, MatchResult)
    assert_type(locate("photo.jpg", dem=terrain), MatchResult)
    best = found.answer or found.best
    assert_type(best, Pose | None)
    if best is None:
        return None
    assert_type(best.confidence, float | None)
    with Viewer(terrain) as viewer:
        pixels = viewer.places(best, found.skyline)
    assert_type(pixels, PixelPlaces)
    assert_type(pixels.to_xarray(), Dataset)
    return best
