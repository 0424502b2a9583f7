"""What an eye sees of a wall before a higher wall, and which names stand where in a panorama."""

import numpy as np
import pytest
from scenes import FRAME, HeightField, fractal
from scipy.ndimage import maximum_filter

from skyline import PanoramaConfig, Peaks, save_panorama, stand_on
from skyline.camera import columns_u
from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.pipeline.panorama import panorama_view
from skyline.report.landscape import Landscape
from skyline.report.panorama import SUMMIT, draw_panorama
from skyline.views import Shells, Views

EDGES_M = np.array([0.0, 500.0, 1000.0, 2000.0, 4000.0])


def two_walls():
    """A wall 600 m away that rises 5 degrees, one 3,000 m away that rises 10, and a plain."""
    width = 64
    ahead = np.hypot(1.0, columns_u(width))
    tan = np.full((4, 4, width), np.nan)
    depth = np.full((4, 4, width), np.nan)
    for shell, (angle_deg, away_m) in enumerate([(-20, 499), (5, 600), (-1, 1999), (10, 3000)]):
        tan[:, shell] = np.tan(np.radians(angle_deg)) * ahead
        depth[:, shell] = away_m / ahead
    eye = np.zeros(4)
    return Views(
        eye, eye, eye, np.arange(4, dtype=np.uint8), tan[:, 3], depth[:, 3],
        np.zeros((4, width), np.uint8), Shells(EDGES_M, tan, depth),
    )  # fmt: skip


def test_the_nearer_wall_hides_the_plain_and_the_farther_one_stands_over_it():
    landscape = Landscape.of(two_walls(), 3.0, 0.0)
    assert (np.diff(landscape.azimuth_deg) > 0.0).all()
    assert 0.0 <= landscape.azimuth_deg[0] < 3.0
    np.testing.assert_allclose(landscape.skyline_deg, 10.0, atol=1e-5)
    assert landscape.is_seen.all(axis=1).tolist() == [True, True, False, True]
    elevation = np.array([-15.0, 4.9, 5.1, 9.9, 10.1])
    column = landscape.distance_m(np.array([200.0]), elevation)[:, 0]
    assert 0.0 < column[0] <= 600.0
    assert column[1] == pytest.approx(600.0, abs=5.0)
    assert 1900.0 < column[2] < 3000.0
    assert column[3] == pytest.approx(3000.0, abs=40.0)
    assert np.isinf(column[4])


def test_ridges_are_where_the_terrain_drops_out_of_sight():
    begins_m, lines = Landscape.of(two_walls(), 0.0, 0.0).ridges(30.0)
    assert np.isfinite(lines).all(axis=1).tolist() == [True, False, True, False]
    assert begins_m[2] == pytest.approx(500.0, rel=0.001)
    np.testing.assert_allclose(lines[2], 5.0, atol=1e-5)


@pytest.fixture(scope="module")
def mountains():
    heights = 1500.0 + fractal(300, 300, 1500.0, seed=8)
    field = HeightField(heights.astype(np.float32), 0.0, 0.0, 60.0, 60.0, FRAME)
    # The highest within 180 m, so that each is the summit that its name stands for.
    row, col = np.nonzero(field.heights_m == maximum_filter(field.heights_m, 7))
    easting, northing = field.to_map(row, col)
    names = tuple(f"{'Great ' * (index % 3)}Peak {index}" for index in range(len(row)))
    return field, Peaks(names, easting, northing, field.heights_m[row, col].astype(np.float64))


PLACES = [(0.5, 0.5), (0.3, 0.6), (0.7, 0.2), (0.55, 0.8), (0.2, 0.35)]


@pytest.mark.parametrize("share", PLACES)
def test_no_name_overlaps_another_or_leaves_the_picture(mountains, share):
    field, peaks = mountains
    eye = stand_on(field, *field.to_map(300.0 * share[0], 300.0 * share[1]), 500.0)
    view = panorama_view(field, eye, peaks, PanoramaConfig())
    figure = draw_panorama(view)
    figure.canvas.draw()
    names = figure.findobj(lambda one: one.get_gid() == SUMMIT)
    assert len(names) > 8
    extents = [name.get_window_extent() for name in names]
    page = figure.bbox
    for index, extent in enumerate(extents):
        assert page.x0 <= extent.x0 <= extent.x1 <= page.x1
        assert page.y0 <= extent.y0 <= extent.y1 <= page.y1
        assert not any(extent.overlaps(other) for other in extents[:index])
    title = figure.texts[0].get_window_extent()
    assert not any(title.overlaps(extent) for extent in extents)


def test_only_peaks_that_are_seen_are_named_and_they_stand_on_the_landscape(mountains):
    field, peaks = mountains
    eye = stand_on(field, *field.to_map(150.0, 150.0), 500.0)
    view = panorama_view(field, eye, peaks, PanoramaConfig())
    assert 8 < len(view.sightings) < len(peaks) / 2
    named = {one.label for one in view.sightings}
    landscape, hidden, free = view.landscape, 0, 0
    for index, name in enumerate(peaks.names):
        east = peaks.easting_m[index] - eye.easting_m[0]
        north = peaks.northing_m[index] - eye.northing_m[0]
        away_m = np.hypot(east, north)
        if away_m < 2000.0:
            continue
        azimuth = (np.degrees(np.arctan2(east, north)) + view.convergence_deg) % 360.0
        column = np.argmin(np.abs(landscape.azimuth_deg - azimuth))
        up = peaks.height_m[index] - eye.eye_elevation_m[0] - Curvature().drop_m(away_m)
        summit_deg = np.degrees(np.arctan(up / away_m))
        begins = landscape.nearest_m[:, column]
        ends = np.append(begins[1:], np.inf)
        before, maybe = (
            landscape.top_deg[to < away_m - 150.0, column].max(initial=-90.0)
            for to in (ends, begins)
        )
        seen = f"{name} {peaks.height_m[index]:.0f} m" in named
        if before > summit_deg + 0.15:
            hidden += 1
            assert not seen, name
        if maybe < summit_deg + 0.05:
            free += 1
            assert seen, name
    assert hidden > 50
    assert free > 10


def test_a_peak_below_the_picture_has_no_name(mountains):
    field, _ = mountains
    eye = stand_on(field, *field.to_map(150.0, 150.0), 500.0)
    east, north = float(eye.easting_m[0]) + 400.0, float(eye.northing_m[0])
    below = Peaks(("Below",), np.array([east]), np.array([north]), np.array([np.nan]))
    view = panorama_view(field, eye, below, PanoramaConfig())
    assert len(view.sightings) == 1
    assert not draw_panorama(view).findobj(lambda one: one.get_gid() == SUMMIT)


def test_a_part_of_the_round_has_its_peaks_alone(mountains):
    field, peaks = mountains
    eye = stand_on(field, *field.to_map(150.0, 150.0), 500.0)
    whole = panorama_view(field, eye, peaks, PanoramaConfig())
    part = panorama_view(field, eye, peaks, PanoramaConfig(heading_deg=350.0, fov_deg=60.0))
    assert 0 < len(part.sightings) < len(whole.sightings)
    off = [(one.azimuth_deg + part.convergence_deg - 350.0 + 180.0) % 360.0 - 180.0
           for one in part.sightings]  # fmt: skip
    assert np.abs(off).max() <= 30.0
    shown = (part.landscape.azimuth_deg >= 320.0) & (part.landscape.azimuth_deg <= 380.0)
    there = np.interp(
        part.landscape.azimuth_deg[shown] % 360.0,
        whole.landscape.azimuth_deg, whole.landscape.skyline_deg, period=360.0,
    )  # fmt: skip
    np.testing.assert_allclose(part.landscape.skyline_deg[shown], there, atol=0.01)


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_pictures_are_of_their_kind(mountains, tmp_path, suffix):
    field, peaks = mountains
    path = tmp_path / f"panorama{suffix}"
    lon, lat = (float(at) for at in field.frame.to_lonlat(*field.to_map(150.0, 150.0)))
    assert save_panorama(field, lon, lat, path, peaks, PanoramaConfig(90.0, 40.0)) >= 0
    begins = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}[suffix]
    assert path.read_bytes().startswith(begins)


@pytest.mark.parametrize(("heading", "fov"), [(0.0, 4.0), (0.0, 361.0), (np.nan, 90.0)])
def test_angles_out_of_range(heading, fov):
    with pytest.raises(InputError, match="expected a field of view of 5 to 360"):
        PanoramaConfig(heading, fov)


def test_a_suffix_that_is_no_picture(mountains, tmp_path):
    with pytest.raises(InputError, match=r"expected \.png, \.svg, \.pdf"):
        save_panorama(mountains[0], 9.8, 46.8, tmp_path / "panorama.txt")
