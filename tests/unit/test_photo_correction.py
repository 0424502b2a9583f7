"""Skylines mended by strokes: columns under a stroke follow it, all others stay."""

from dataclasses import replace

import numpy as np
import pytest
from photo_scenes import make_scene

from skyline import Correction, NotedPlace, Photo, PhotoSkyline, Projection, Stroke
from skyline.photo.extract import extract_skyline
from skyline.photo.sky_mask import skyline_of_mask
from skyline.photo.strokes import StrokeKind

WIDTH, HEIGHT = 960, 640


def photo_of(image):
    return Photo(image, 60.0, Projection.PERSPECTIVE, NotedPlace())


@pytest.fixture(scope="module")
def photo():
    return photo_of(make_scene("clouds", 3).image)


@pytest.fixture(scope="module")
def correction(photo):
    return Correction(photo)


def stroke(kind, columns, rows, radius_px=0.0):
    points = np.stack(np.broadcast_arrays(columns, rows), axis=1).astype(float)
    return Stroke(StrokeKind(kind), tuple(map(tuple, points.tolist())), radius_px)


def same(one, other):
    return np.array_equal(one.row_px, other.row_px, equal_nan=True) and np.array_equal(
        one.trust, other.trust
    )


@pytest.mark.parametrize("kind", ["clear", "snow"])
def test_without_a_stroke_it_is_the_extractor_s_skyline(kind):
    image = make_scene(kind, 1).image
    found = Correction(photo_of(image)).solve()
    assert same(found, extract_skyline(image))
    assert found.fov_deg == 60.0


@pytest.mark.parametrize(("kind", "away_px"), [("sky", 70.0), ("ground", -70.0)])
def test_painted_ground_and_sky_are_on_their_sides(correction, kind, away_px):
    before = correction.solve()
    columns = np.arange(400, 520, 4)
    rows = before.row_px[columns] + away_px
    after = correction.solve([stroke(kind, columns, rows, 10.0)])
    inner = np.arange(400, 517)
    beyond = np.interp(inner, columns, rows)
    if kind == "sky":
        assert (after.row_px[inner] > beyond).all()
    else:
        assert (after.row_px[inner] < beyond).all()
    assert after.trusted[inner].all()
    far = np.r_[0:300, 620:WIDTH]
    np.testing.assert_array_equal(after.row_px[far], before.row_px[far])
    np.testing.assert_array_equal(after.trust[far], before.trust[far])


def test_a_line_is_taken_as_it_is(correction):
    after = correction.solve([stroke("line", [100, 150, 200], [300.0, 320.5, 280.0])])
    assert after.row_px[100] == 300.0
    assert after.row_px[125] == pytest.approx(310.25)
    assert after.row_px[200] == 280.0
    assert (after.trust[100:201] == 1.0).all()
    back = correction.solve([stroke("line", [100, 140, 120], [300.0, 300.0, 200.0])])
    assert back.row_px[120] == 200.0


def test_erased_columns_are_not_trusted_until_they_are_drawn_again(correction):
    erased = stroke("erase", [300, 340], [5.0, 5.0], 4.0)
    after = correction.solve([erased])
    assert not after.trusted[296:345].any()
    drawn = stroke("line", [310, 320], [200.0, 200.0])
    again = correction.solve([erased, drawn])
    assert again.trusted[310:321].all()
    assert not again.trusted[296:310].any()
    assert not correction.solve([drawn, erased]).trusted[296:345].any()


def test_the_quick_way_is_the_slow_way():
    """All columns are refined again, and not those alone that a stroke has changed."""
    photo = photo_of(make_scene("layers", 5, 1440, 960).image)
    before = Correction(photo).solve()
    columns = np.arange(500, 900, 10)
    painted = stroke("sky", columns, before.row_px[columns] + 40.0, 25.0)
    quick = Correction(photo).solve([painted])
    slow = Correction(photo, beside_px=1440).solve([painted])
    inner = np.arange(490, 890)
    assert quick.trusted[inner].sum() > 390
    assert (quick.row_px[inner] != before.row_px[inner]).sum() > 390
    assert same(quick, slow)


def test_a_trace_is_begun_with_and_mended(correction):
    trace = PhotoSkyline(np.full(WIDTH, 250.0), np.ones(WIDTH), WIDTH, HEIGHT)
    assert same(correction.solve(start=trace), replace(trace, fov_deg=60.0))
    mended = correction.solve([stroke("line", [10, 20], 100.0)], trace)
    assert (mended.row_px[10:21] == 100.0).all()
    assert (mended.row_px[30:] == 250.0).all()


def test_the_border_of_a_mask_or_a_trace_stays_as_it_is():
    image = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    image[200 + np.arange(WIDTH) // 20 % 40 <= np.arange(HEIGHT)[:, np.newaxis]] = 0
    image[:, :60] = 255
    mask = skyline_of_mask(image)
    assert mask.trusted[60:].all()
    assert same(Correction(photo_of(image)).solve(), replace(mask, fov_deg=60.0))
    trace = replace(mask, row_px=np.full(WIDTH, 77.0), trust=np.ones(WIDTH))
    assert same(Correction(photo_of(image)).solve(start=trace), trace)


def test_strokes_leave_nothing_behind(correction):
    before = correction.solve()
    strokes = [stroke("sky", [100, 300], 400.0, 15.0), stroke("line", [5, 40], 90.0)]
    once = correction.solve(strokes)
    assert same(correction.solve(strokes), once)
    assert same(correction.solve(), before)
