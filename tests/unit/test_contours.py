"""Evidence for an answer from what a photo shows below its skyline."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import candidate_at, field_of, fractal

from skyline.camera.projection import Projection
from skyline.geodesy.earth import Curvature
from skyline.match.contours import weighed_by_contours
from skyline.photo.skyline import PhotoSkyline
from skyline.view.viewer import Viewer

WIDTH_PX, HEIGHT_PX = 400, 240
COVARIANCE_M2 = ((100.0, 0.0), (0.0, 100.0))


@pytest.fixture(scope="module")
def field():
    return field_of(fractal(280, 280, relief_m=2500.0, seed=5), 60.0)


def pose_at(field, east_m, north_m, heading_deg=20.0, **known):
    eye_m = float(field.height_at(easting_m=east_m, northing_m=north_m)) + 300.0
    sure = {"confidence": 0.3, "confidence_1km": 0.5, "covariance_m2": COVARIANCE_M2} | known
    return candidate_at(east_m, north_m, heading_deg, -4.0, eye_elevation_m=eye_m, **sure)


@pytest.fixture(scope="module")
def right(field):
    return pose_at(field, 8400.0, -14000.0)


@pytest.fixture(scope="module")
def photo(field, right):
    """The view at the right pose through haze: the farther, the lighter."""
    unknown = np.full(WIDTH_PX, np.nan), np.zeros(WIDTH_PX)
    blank = PhotoSkyline(*unknown, WIDTH_PX, HEIGHT_PX, 60.0)
    with Viewer(field) as viewer:
        distance_m = viewer.places(right, blank).distance_m
    texture = np.random.default_rng(1).normal(0.0, 4.0, distance_m.shape)
    haze = 250.0 * (1.0 - np.exp(-distance_m / 8000.0)) + texture
    shades = np.where(np.isnan(distance_m), 255.0, np.clip(haze, 0.0, 255.0)).astype(np.uint8)
    picture = np.repeat(shades[..., np.newaxis], 3, axis=2)
    row_px = np.isfinite(distance_m).argmax(axis=0) - 0.5
    return replace(blank, row_px=row_px, trust=np.ones(WIDTH_PX), picture=picture)


def weighed(candidates, photo, field):
    return weighed_by_contours(candidates, photo, field, Curvature())


def test_ridges_on_edges_raise_the_confidence(right, photo, field):
    (found,) = weighed([right], photo, field)
    assert found.confidence_1km > 0.8
    # The odds of the place within the answer are as before.
    assert found.confidence == pytest.approx(0.6 * found.confidence_1km)
    assert replace(found, confidence=0.3, confidence_1km=0.5) == right


def test_odds_change_tenfold_at_most(right, photo, field):
    (found,) = weighed([right], photo, field)
    assert found.confidence_1km <= 10.0 / 11.0 + 1e-12


def test_ridges_beside_the_edges_lower_the_confidence(right, photo, field):
    (found,) = weighed([replace(right, pitch_deg=right.pitch_deg + 2.5)], photo, field)
    assert found.confidence_1km < 0.4


def test_the_other_candidates_share_the_rest(right, photo, field):
    other = replace(right, easting_m=right.easting_m + 5000.0, confidence=0.1, confidence_1km=0.25)
    best, rest = weighed([right, other], photo, field)
    assert rest.confidence_1km == pytest.approx(0.5 * (1.0 - best.confidence_1km))
    assert rest.confidence == pytest.approx(0.2 * (1.0 - best.confidence_1km))


def test_poses_of_one_answer_are_weighed_by_their_costs(right, photo, field):
    beside = replace(right, pitch_deg=right.pitch_deg + 2.5, cost=right.cost)
    (alone,) = weighed([right], photo, field)
    both = weighed([right, beside], photo, field)
    far_behind = weighed([right, replace(beside, cost=right.cost + 1000.0)], photo, field)
    assert 0.5 < both[0].confidence_1km < alone.confidence_1km
    assert both[0].confidence_1km == both[1].confidence_1km
    assert far_behind[0].confidence_1km == pytest.approx(alone.confidence_1km)


@pytest.mark.parametrize(
    "said",
    [
        {"picture": None},
        {"picture": np.full((HEIGHT_PX, WIDTH_PX, 3), 90, np.uint8)},
        {"projection": Projection.CYLINDRICAL},
    ],
    ids=["a trace", "fog", "a panorama"],
)
def test_a_picture_that_shows_no_edges_changes_nothing(right, photo, field, said):
    assert weighed([right], replace(photo, **said), field) == (right,)


@pytest.mark.parametrize("unknown", ["covariance_m2", "confidence"])
def test_a_pose_that_is_not_refined_or_not_judged_is_left_as_it_is(right, photo, field, unknown):
    pose = pose_at(field, right.easting_m, right.northing_m, **{unknown: None})
    assert weighed([pose], photo, field) == (pose,)


def test_ground_without_ridges_changes_nothing(photo):
    plain = field_of(np.zeros((60, 60)), 60.0)
    pose = pose_at(plain, 1800.0, -1800.0)
    assert weighed([pose], photo, plain) == (pose,)
