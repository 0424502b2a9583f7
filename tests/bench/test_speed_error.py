"""Where the measured viewpoints stand, what the configuration refuses, what is drawn."""

import itertools

import cv2
import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.errors import InputError
from skyline_bench.figures.plots import save_speed_error
from skyline_bench.peers.embree import Bisection
from skyline_bench.runs.speed_error import SpeedErrorConfig, central_viewpoints

MACHINE = {"processor": "abacus", "cores": 2, "renderer": "by hand"}


@pytest.mark.parametrize("count", [1, 2, 9, 16, 100])
def test_viewpoints_are_a_square_in_the_middle(count):
    field = field_of(fractal(200, 160), 30.0, west_m=5e5 + 7.0, north_m=5e6 + 3.0)
    viewpoints = central_viewpoints(field, count, 100.0)
    assert len(viewpoints) == count
    west, south, east, north = field.bounds_m
    side = np.ceil(np.sqrt(count))
    for place, middle in [
        (viewpoints.easting_m, (west + east) / 2.0),
        (viewpoints.northing_m, (south + north) / 2.0),
    ]:
        assert (place % 100.0 == 0.0).all()
        assert np.ptp(place) <= (side - 1.0) * 100.0
        assert abs((place.min() + place.max()) / 2.0 - middle) <= 100.0


def test_a_small_dem_gives_what_it_has():
    field = field_of(fractal(20, 20), 30.0)
    assert 20 <= len(central_viewpoints(field, 400, 100.0)) <= 36


def test_a_dem_without_a_middle_is_refused():
    heights = fractal(60, 60)
    heights[15:45, 15:45] = np.nan
    with pytest.raises(InputError, match="no viewpoint"):
        central_viewpoints(field_of(heights), 4, 100.0)


def test_bad_settings_are_refused():
    for bad, message in [
        ({"width": 0}, "width is 0"),
        ({"depth_widths": (640, 1)}, "width is 1"),
        ({"viewpoints": 0}, "viewpoints is 0"),
        ({"repeats": 0}, "repeats is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"spacing_m": float("nan")}, "spacing_m is nan"),
    ]:
        with pytest.raises(InputError, match=message):
            SpeedErrorConfig(**bad)


def test_quick_is_a_part_of_the_whole():
    whole = SpeedErrorConfig(width=320, seed=7)
    quick = whole.quick()
    assert (quick.width, quick.seed) == (320, 7)
    assert set(quick.depth_widths) < set(whole.depth_widths)
    assert set(quick.bisections) < set(whole.bisections)
    assert quick.viewpoints < whole.viewpoints
    assert SpeedErrorConfig(viewpoints=3).quick().viewpoints == 3


def made_up_rows():
    rows = [
        {"path": "depth", "setting": f"W = {width}", "ms_per_viewpoint": width / 2.0,
         "rms_px": 200.0 / width, "max_px": 400.0 / width}
        for width in (160, 640)
    ] + [
        {"path": "embree", "start": each.start, "setting": f"{each.start} {each.depth}",
         "ms_per_viewpoint": 1.0 * each.depth, "rms_px": each.bracket_tan * 100.0,
         "max_px": each.bracket_tan * 200.0}
        for each in itertools.starmap(Bisection, [(9, "plain"), (12, "plain"), (12, "neighbour")])
    ]  # fmt: skip
    exact = {"path": "oracle", "setting": "exact", "ms_per_viewpoint": 400.0}
    return [*rows, {**exact, "rms_px": 0.0, "max_px": 0.0}]


def test_every_path_is_drawn(tmp_path):
    rows = made_up_rows()
    pictures = []
    for name, kept in [("all", rows), ("no oracle", rows[:-1]), ("depth", rows[:2])]:
        save_speed_error(kept, MACHINE, tmp_path / f"{name}.png")
        pictures.append(cv2.imread(str(tmp_path / f"{name}.png")))
    assert all(picture.std() > 5.0 for picture in pictures)
    for one, other in itertools.combinations(pictures, 2):
        assert one.shape != other.shape or (one != other).any()


def test_rows_that_could_not_be_compared_are_no_obstacle(tmp_path):
    rows = [{**row, "rms_px": None, "max_px": None} for row in made_up_rows()]
    save_speed_error(rows, MACHINE, tmp_path / "none.png")
    assert cv2.imread(str(tmp_path / "none.png")) is not None
