"""Representations of terrain, stores and results in a REPL and in a notebook."""

import re

import numpy as np
from scenes import candidate_at, field_from

from skyline import (
    Matcher,
    MatchResult,
    Orientation,
    PhotoSkyline,
    Viewer,
    Viewpoints,
    open_store,
)

BLANK = PhotoSkyline(np.full(8, 3.0), np.ones(8), 8, 8, 60.0)


def test_terrain_is_one_line_and_a_table():
    field = field_from(lambda east, north: 0.5 * east + 0.0 * north, 301, 20.0)
    assert repr(field).startswith("HeightField(301 x 301 samples, 20 x 20 m apart, local ")
    assert "-1500 to 1500 m" in field._repr_html_()


def test_what_holds_arrays_is_printed_in_a_line_with_their_shapes(store):
    eyes = Viewpoints(
        easting_m=np.zeros(1000), northing_m=np.zeros(1000), eye_elevation_m=np.zeros(1000)
    )
    assert repr(eyes).startswith("Viewpoints(easting_m=(1000,) float64, northing_m=(1000,)")
    assert len(eyes[3]) == 1
    assert len(list(eyes[:3])) == 3
    flat = field_from(lambda east, north: 0.0 * east * north, 61, 30.0)
    places = Viewer(flat).places(candidate_at(0.0, 0.0, eye_elevation_m=2.0), BLANK)
    with open_store(store) as opened:
        things = [eyes, places, opened.header, opened.places()]
    assert max(len(repr(thing)) for thing in things) < 400


def test_poses_are_printed_with_their_angles():
    pose = candidate_at(1000.0, 2000.0, 140.0, confidence=0.93)
    assert repr(pose).startswith("Pose(latitude 46.8")
    assert repr(pose).endswith(
        "pitch 0.00, roll 0.00, FOV 60.00, confidence 0.93; angles in degrees)"
    )
    held = Orientation(BLANK, pose, heading_sd_deg=0.1, confidence=0.9, refusal="unsure")
    assert f"heading {pose.heading_deg:.2f} +- 0.10, pitch 0.00 +- nan, " in repr(held)
    assert repr(held).endswith("confidence 0.90; not trusted: unsure)")


def test_a_matcher_says_what_it_searches(store, dem):
    with Matcher(store, dem) as matcher:
        assert repr(matcher) == f"Matcher({matcher.rows} places, answers refined)"


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
