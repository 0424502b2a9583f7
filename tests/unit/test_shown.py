"""Representations of terrain, stores and results in a REPL and in a notebook."""

import re

import numpy as np
from scenes import candidate_at, field_from

from skyline import MatchResult, PhotoSkyline, open_store


def test_terrain_is_one_line_and_a_table():
    field = field_from(lambda east, north: 0.5 * east + 0.0 * north, 301, 20.0)
    assert repr(field).startswith("HeightField(301 x 301 samples, 20 x 20 m apart, local ")
    assert "-1500 to 1500 m" in field._repr_html_()


def test_a_store_says_what_it_holds(store):
    with open_store(store) as opened:
        assert repr(opened) == f"Store({store.name}: {len(opened)} places)"
        html = opened._repr_html_()
    assert f"<th>places</th><td>{len(opened):,}</td>" in html
    assert "<th>spacing_m</th><td>80.0</td>" in html


def test_a_result_draws_its_skyline_without_what_is_not_trusted():
    row_px = np.full(40, 12.0)
    row_px[10:15] = np.nan
    skyline = PhotoSkyline(row_px, np.isfinite(row_px) * 1.0, 40, 30, 60.0)
    found = candidate_at(1000.0, 2000.0, confidence=0.93, confidence_1km=0.97)
    html = MatchResult(skyline, (found,), 1.0, None, 200.0)._repr_html_()
    line = re.search(r' d="([^"]*)"', html)[1]
    assert [len(run.split()) for run in line.split("M")[1:]] == [10, 25]
    assert line.startswith("M0,12.0 1,12.0")
    assert "0.93" in html
