"""Skylines and summits at poses, fits from poses set by hand, and rendering for many threads."""

import math
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from skyline import Matcher, Narrowing, OffMapError, Viewer, read_dem, read_skyline
from skyline.errors import InputError
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline.skylines import HEADINGS
from skyline.terrain.viewpoints import stand_on
from skyline.view.viewer import sight_of

EASTING_M, NORTHING_M = 601_800.0, 5_178_000.0
COLUMN_DEG = 90.0 / 1024


@pytest.fixture(scope="module")
def matcher(store):
    """A matcher of the small store."""
    with Matcher(store) as made:
        yield made


@pytest.fixture(scope="module")
def skyline(photo):
    """The photo's skyline."""
    return read_skyline(photo, 60.0)


ENDS_WHILE_LOADING = """
import sys, time
from concurrent.futures import thread
from skyline import read_dem
from skyline.render import horizon

class Late(horizon.HorizonRenderer):
    def load(self):
        while not thread._shutdown:
            time.sleep(0.01)
        super().load()

horizon.HorizonRenderer = Late
horizon.RenderedScene(read_dem(sys.argv[1:]), horizon.RenderConfig())
"""


def test_a_program_that_ends_while_terrain_is_loaded_prints_nothing(dem):
    command = [sys.executable, "-c", ENDS_WHILE_LOADING, str(dem)]
    done = subprocess.run(command, capture_output=True, check=True, text=True, timeout=120)
    assert done.stderr == ""


def true_pose(viewer, frame, **other):
    lon, lat = (float(one) for one in frame.to_lonlat(EASTING_M, NORTHING_M))
    turn = float(frame.convergence_deg(easting_m=EASTING_M, northing_m=NORTHING_M))
    return viewer.pose(lon=lon, lat=lat, heading_deg=140.0 + turn, **other)


def test_a_pose_says_where_the_eye_stands(matcher, dem):
    ground_m = float(read_dem([dem]).height_at(easting_m=EASTING_M, northing_m=NORTHING_M))
    with Viewer(matcher.terrain) as viewer:
        pose = true_pose(viewer, matcher.frame, eye_height_m=7.0, pitch_deg=3.0)
        assert pose.easting_m == pytest.approx(EASTING_M, abs=1e-3)
        assert pose.northing_m == pytest.approx(NORTHING_M, abs=1e-3)
        assert pose.eye_elevation_m == pytest.approx(ground_m + 7.0, abs=1e-2)
        assert pose.grid_heading_deg == pytest.approx(140.0, abs=1e-6)
        assert (pose.pitch_deg, pose.confidence, pose.refined) == (3.0, None, False)
        assert pose.origin == "set by hand"
        with pytest.raises(OffMapError):
            viewer.pose(lon=9.0, lat=40.0, heading_deg=0.0)


def test_the_skyline_at_the_true_pose_is_the_photos(matcher, skyline):
    with Viewer(matcher.terrain) as viewer:
        sight = viewer.look(true_pose(viewer, matcher.frame), skyline)
        assert sight.median_gap_deg < 0.1
        aside = viewer.look(true_pose(viewer, matcher.frame, pitch_deg=2.0), skyline)
    gap_deg = aside.gap_deg[np.isfinite(aside.gap_deg)]
    assert np.median(gap_deg) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize(("heading_deg", "pitch_deg", "roll_deg", "fov_deg"), [
    (181.0, 6.0, -4.0, 95.0), (359.5, -8.0, 10.0, 30.0),
])  # fmt: skip
def test_a_sight_is_what_four_fine_views_show(
    matcher, skyline, heading_deg, pitch_deg, roll_deg, fov_deg
):
    """Between columns a skyline is straight: a column's height apart where it is not."""
    with Viewer(matcher.terrain) as viewer:
        angles = {"pitch_deg": pitch_deg, "roll_deg": roll_deg, "fov_deg": fov_deg}
        pose = replace(true_pose(viewer, matcher.frame, **angles), heading_deg=heading_deg)
        sight = viewer.look(pose, skyline)
    terrain = matcher.terrain
    eye = stand_on(terrain, easting_m=pose.easting_m, northing_m=pose.northing_m, eye_height_m=2.0)
    config = RenderConfig(4096, matcher.header.curvature)
    with HorizonRenderer(terrain, config) as renderer:
        fine = sight_of(pose, skyline, renderer.render(eye[np.zeros(4, int)], HEADINGS))
    near = np.abs(fine.column_px - skyline.width_px / 2.0) < 0.5 * skyline.width_px
    order = np.argsort(sight.column_px)
    there = np.interp(fine.column_px[near], sight.column_px[order], sight.row_px[order])
    off_px = np.abs(there - fine.row_px[near])
    a_column_px = skyline.width_px * COLUMN_DEG / fov_deg
    assert np.percentile(off_px, 99) < 2.0 * a_column_px
    assert sight.column_px.min() < 10.0
    assert sight.column_px.max() > skyline.width_px - 10.0


@pytest.mark.parametrize(("east_m", "north_m", "turn_deg"), [(60.0, 0.0, 3.0), (-40.0, 50.0, -4.0)])
def test_a_pose_is_fitted_from_nearby(matcher, skyline, east_m, north_m, turn_deg):
    with Viewer(matcher.terrain) as viewer:
        true = true_pose(viewer, matcher.frame)
        start = replace(
            true,
            easting_m=true.easting_m + east_m,
            northing_m=true.northing_m + north_m,
            heading_deg=true.heading_deg + turn_deg,
        )
        found = matcher.fit(skyline, start).answer
        before, after = (viewer.look(one, skyline).median_gap_deg for one in (start, found))
    assert math.hypot(found.easting_m - EASTING_M, found.northing_m - NORTHING_M) < 45.0
    assert after < min(0.1, before / 2.0)
    assert (found.origin, found.confidence) == ("fitted", None)
    assert found.radius_m is not None
    assert found.residual_deg < 0.05
    assert found.terrain_share > 0.9


def test_a_bad_fit_has_failed(matcher, skyline):
    with Viewer(matcher.terrain) as viewer:
        true = true_pose(viewer, matcher.frame)
        fit = matcher.fit(skyline, replace(true, heading_deg=true.heading_deg + 180.0))
        (found,) = fit.candidates
        gap_deg = viewer.look(found, skyline).gap_deg
    assert fit.answer is None
    assert (found.confidence, found.radius_m) == (None, None)
    assert found.residual_deg == pytest.approx(np.sqrt(np.nanmean(gap_deg**2)), rel=0.2)
    said = f"{found.residual_deg:.2f} degrees apart (rms) over {100 * found.terrain_share:.0f} %"
    assert said in fit.refusal
    assert "70 % are needed" in fit.refusal


def test_a_fit_at_a_candidate_of_a_search_is_that_candidate(matcher, photo):
    """Whether the pose was moved a little or not, and also with an unknown field of view."""
    for skyline in (read_skyline(photo, 60.0), read_skyline(photo)):
        searched = matcher.match(skyline)
        for one in searched.candidates[:2]:
            moved = replace(one, easting_m=one.easting_m + 20.0, heading_deg=one.heading_deg + 1.0)
            for start in (one, moved):
                fit = matcher.fit(searched, start)
                again = searched.candidates[fit.best.rank - 1]
                assert fit.best.confidence == again.confidence
                assert fit.best.confidence_1km == again.confidence_1km
                assert fit.best.cost <= again.cost
                assert (fit.refusal, fit.within_m) == (
                    (searched.refusal, searched.within_m)
                    if again.rank == 1
                    else (searched.refusal or "chosen by a person", None)
                )


def test_a_fit_is_to_what_is_known(matcher, skyline):
    with Viewer(matcher.terrain) as viewer:
        start = true_pose(viewer, matcher.frame, eye_height_m=30.0)
        known = matcher.fit(skyline, start, Narrowing(eye_height_m=30.0)).best
        found = matcher.fit(skyline, start).best

    def above_m(pose):
        place = {"easting_m": pose.easting_m, "northing_m": pose.northing_m}
        return pose.eye_elevation_m - float(matcher.terrain.height_at(**place))

    assert above_m(known) == pytest.approx(30.0, abs=1e-3)
    assert above_m(found) == pytest.approx(2.0, abs=3.0)
    assert found.residual_deg < known.residual_deg
    searched = matcher.match(skyline)
    for wrong, narrowing in ((searched, Narrowing()), (matcher.fit(skyline, start), None)):
        with pytest.raises(InputError, match="the result of `match`"):
            matcher.fit(wrong, start, narrowing)


def test_a_match_reports_its_progress_and_ends_when_the_callback_raises(matcher, skyline):
    reports = []
    plain = matcher.match(skyline)
    watched = matcher.match(skyline, report_progress=lambda *report: reports.append(report))
    assert watched.candidates == plain.candidates
    steps = [step for step, _ in reports]
    assert list(dict.fromkeys(steps)) == ["screening", "fitting", "refining"]
    assert steps == sorted(steps, key=["screening", "fitting", "refining"].index)
    assert all(0.0 <= share <= 1.0 for _, share in reports)
    refining = [share for step, share in reports if step == "refining"]
    assert refining == sorted(refining)
    assert refining[0] == 0.0 < refining[len(refining) // 2] < 1.0

    for wanted in ("screening", "fitting", "refining"):
        with pytest.raises(ZeroDivisionError):
            matcher.match(skyline, report_progress=lambda step, _, at=wanted: 1 / (step != at))
    assert matcher.match(skyline).candidates == plain.candidates


def test_threads_match_at_once_after_this_one_has_rendered(matcher, skyline):
    """As in a notebook, whose own thread has drawn horizons and has made the matcher."""
    plain = matcher.match(skyline).candidates
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda _: matcher.match(skyline).candidates, range(3)))
    assert found == [plain] * 3
    assert matcher.match(skyline).candidates == plain


def test_a_closed_matcher_is_refused(store, skyline):
    made = Matcher(store)
    made.close()
    made.close()
    with pytest.raises(InputError, match="closed; make another"):
        made.match(skyline)
