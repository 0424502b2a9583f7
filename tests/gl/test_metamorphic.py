"""Terrain and photo turned, mirrored or shifted together: so is the answer.

No answer is looked up here. The tests compare two answers, each found in a store of its own, which
leaves no room for a frame, an axis or a heading the wrong way round.
"""

from dataclasses import replace

import numpy as np
import pytest
from scenes import FRAME, field_of, fractal

from skyline import MatchConfig, Matcher, build_places
from skyline_bench.queries.synthetic import QueryConfig, make_queries

SIZE, SPACING_M = 200, 30.0
HALF_M = (SIZE - 1) / 2.0 * SPACING_M
SQUARE_M = 600.0
"""Half the side of the area that is searched."""
PLACES_M = 50.0
QUERY = QueryConfig(max_tilt_deg=3.0, noise_deg=(0.005, 0.005), smooth_share=0.0, masked_share=0.0)
BOLD = MatchConfig(min_confidence=0.0, fov_sd_share=0.05)


def terrain_of(heights_m, shift=0.0):
    """Return terrain about the frame's origin, or shifted (east + i north, metres)."""
    corner = {"west_m": shift.real - HALF_M, "north_m": shift.imag + HALF_M}
    return field_of(np.ascontiguousarray(heights_m), SPACING_M, **corner)


def answers(terrain, queries, store, shift=0.0):
    """Return place (east + i north) and grid heading of the best candidate of each query."""
    corners = shift + SQUARE_M * np.array([-1 - 1j, 1 + 1j])
    lon, lat = FRAME.to_lonlat(corners.real, corners.imag)
    square_deg = float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1])
    build_places(terrain, store, PLACES_M, square_deg)
    with Matcher(store, terrain, config=BOLD) as matcher:
        best = [matcher.match(query).candidates[0] for query in queries]
    place = np.array([one.easting_m + 1j * one.northing_m for one in best])
    return place, np.array([one.grid_heading_deg for one in best])


@pytest.fixture(scope="module")
def heights():
    # The sum of two profiles: the corners of a cell lie in a plane, so that it does not matter
    # which diagonal halves the cell, and turned terrain is the same surface.
    south, east = fractal(SIZE, SIZE, relief_m=900.0, seed=21, exponent=2.2)[[20, 140]]
    across = np.abs(SPACING_M * (np.arange(SIZE) - (SIZE - 1) / 2.0)) - 2300.0
    wall = 700.0 * np.exp(-((across / 400.0) ** 2))
    return ((south + wall)[:, np.newaxis] + east + wall).astype(np.float32)


@pytest.fixture(scope="module")
def queries(heights):
    bounds = (-SQUARE_M, -SQUARE_M, SQUARE_M, SQUARE_M)
    return [q.skyline for q in make_queries(terrain_of(heights), bounds, 2, 5, QUERY)]


@pytest.fixture(scope="module")
def plain(heights, queries, tmp_path_factory):
    return answers(terrain_of(heights), queries, tmp_path_factory.mktemp("plain") / "store.h5")


def assert_same(got, place, heading_deg):
    assert np.abs(got[0] - place).max() < SPACING_M  # A sample
    assert np.abs((got[1] - heading_deg + 180.0) % 360.0 - 180.0).max() < 1.0


def test_turned(heights, queries, plain, tmp_path):
    # A quarter turn to the left: what lay in the east lies in the north.
    got = answers(terrain_of(np.rot90(heights)), queries, tmp_path / "store.h5")
    assert_same(got, plain[0] * 1j, plain[1] - 90.0)


def test_mirrored(heights, queries, plain, tmp_path):
    # West and east change places.
    photos = [
        replace(query, row_px=query.row_px[::-1].copy(), trust=query.trust[::-1].copy())
        for query in queries
    ]
    got = answers(terrain_of(heights[:, ::-1]), photos, tmp_path / "store.h5")
    assert_same(got, -plain[0].conj(), -plain[1])


def test_shifted(heights, queries, plain, tmp_path):
    shift = 7000.0 - 4000.0j
    got = answers(terrain_of(heights, shift), queries, tmp_path / "store.h5", shift)
    assert_same(got, plain[0] + shift, plain[1])
