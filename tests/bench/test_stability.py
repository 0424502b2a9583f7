"""Every hard case along every path that has a bound there, and the verdicts."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.skylines import FLAG_HOLE, FLAG_TRUNCATED
from skyline.terrain.viewpoints import stand_on
from skyline_bench.truth import agreement, oracle
from skyline_bench.truth.closed_forms import SceneCase
from skyline_bench.truth.stability import HARD_CASES, measure

pytestmark = pytest.mark.usefixtures("no_gl_error")


class OracleRenderer:
    """The oracle as if it were a renderer."""

    def __init__(self, field, width, curvature):
        self.field, self.width, self.curvature = field, width, curvature

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def render(self, viewpoints):
        return oracle.skyline(self.field, viewpoints, self.width, self.curvature)


def closely(scene, views, truth):
    """The oracle against a closed form: nothing but how the terrain is sampled."""
    error = np.abs(views.v - truth.views.v) * scene.width / 2.0
    bound = np.full(error.shape, truth.slack_px + 1e-6)
    return agreement.Agreement(np.nan_to_num(error), bound, views.flags == truth.views.flags)


CLOSED_FORM = agreement.RenderPath("closed form", OracleRenderer, closely)


def paths_of(case):
    """The paths to try, a case's together, since its scene and truth are then made once."""
    yield from (path for path in (agreement.HORIZON, agreement.DEPTH) if path.name in case.paths)
    if isinstance(case, SceneCase) and case.closed_form:
        yield CLOSED_FORM


TRIALS = [(case, path) for case in HARD_CASES for path in paths_of(case)]


@pytest.mark.parametrize(
    ("case", "path"), TRIALS, ids=[f"{case.name}-{path.name}" for case, path in TRIALS]
)
def test_hard_case(case, path):
    if path is CLOSED_FORM:
        assert case.agreement(path, quick=False).holds
    else:
        row = measure(path, case)
        assert row["ok"], row


def rough_scene():
    heights = fractal(40, 50, seed=4)
    heights[8:12, 20:30] = np.nan
    field = field_of(heights, 32.0)
    place = {"easting_m": [700.3, 901.7], "northing_m": [-600.9, -800.2]}
    return agreement.SkylineScene(field, stand_on(field, **place, eye_height_m=3.0), 160)


@pytest.mark.parametrize(
    ("columns", "off_px", "flag", "ok"),
    [
        (..., 0.0, 0, True),
        (..., 1e-5, 0, True),
        (..., 5e-3, 0, False),
        (..., 0.0, FLAG_TRUNCATED, False),
        (..., 0.0, FLAG_HOLE, False),
        ((2, 40), np.nan, 0, False),
    ],
)
def test_a_wrong_view_fails(columns, off_px, flag, ok):
    case = SceneCase("altered", "nothing", rough_scene)

    class Altered(OracleRenderer):
        def render(self, viewpoints):
            views = super().render(viewpoints)
            v = views.v.copy()
            flags = views.flags.copy()
            v[columns] += off_px * 2.0 / 160
            flags[3, 17] ^= flag
            return replace(views, v=v, flags=flags)

    row = measure(agreement.RenderPath("horizon", Altered, agreement.exact_agreement), case)
    assert row["ok"] is ok
    assert (row["error_px"] <= row["bound_px"] and row["flags_agree"]) is ok
