"""Photo spots: places that people photograph from, and files of them."""

import json

import numpy as np
import pytest
from scenes import FRAME
from scipy.integrate import quad

from skyline.errors import InputError
from skyline.match.narrowing import Narrowing
from skyline.match.photo_spots import PhotoSpots, read_spots

NONE = np.zeros(1)


def lonlats(*position_m):
    """Return longitudes and latitudes of eastings and northings in `FRAME`."""
    lon, lat = FRAME.to_lonlat(*np.transpose(position_m))
    return tuple(zip(lon.tolist(), lat.tolist(), strict=True))


def spots_at(*position_m):
    return PhotoSpots.of(lonlats(*position_m), FRAME)


SPOTS = spots_at((600_000.0, 5_180_000.0), (603_000.0, 5_184_000.0))
FIRST = np.array([600_000.0 + 5_180_000.0j])


def density(spots, position_m):
    """Return the density over an even one."""
    return float(np.exp(-spots.cost(position_m, NONE, NONE)[0]))


def test_half_of_the_photos_are_taken_near_a_spot():
    """Each of two spots stands for 500 of 1,000 square kilometres."""
    ring = quad(lambda r: 2.0 * np.pi * r * (density(SPOTS, FIRST - r) - 0.5), 0.0, 5e4, limit=200)
    assert ring[0] / 5e8 == pytest.approx(0.5, abs=1e-3)


def test_the_nearest_spot_counts():
    second = np.array([603_000.0 + 5_184_000.0j])
    assert density(SPOTS, second + 40.0j) == pytest.approx(density(SPOTS, FIRST + 40.0), rel=1e-5)
    precision, offset_m = SPOTS.pull(second + 40.0j, NONE)
    assert offset_m[0] == pytest.approx([0.0, 40.0, 0.0], abs=1e-3)
    assert precision[0, 0] == precision[0, 1] > precision[0, 2] == 0.0


def test_its_pull_is_the_slope_of_the_cost():
    for off_m in (1.0, 30.0, 300.0):
        precision, offset_m = SPOTS.pull(FIRST + off_m, NONE)
        east = [SPOTS.cost(FIRST + off_m + step, NONE, NONE)[0] for step in (-0.01, 0.01)]
        assert precision[0, 0] * offset_m[0, 0] == pytest.approx(np.diff(east)[0] / 0.02, rel=1e-3)


def test_the_more_spots_there_are_the_less_each_counts():
    one = spots_at((600_000.0, 5_180_000.0))
    assert density(one, FIRST) - 0.5 == pytest.approx(2.0 * (density(SPOTS, FIRST) - 0.5), rel=1e-4)


def test_spots_next_to_each_other_count_as_one():
    dense = spots_at(*((599_990.0 + east_m, 5_180_010.0) for east_m in range(0, 30, 3)))
    assert len(dense.spot_m) == 1


def test_spots_over_a_large_area_stand_for_their_share_of_it():
    """A hundred spots over 100 by 100 km stand for 100 square kilometres each."""
    steps_m = np.linspace(0.0, 1e5, 10)
    grid = spots_at(*((5.5e5 + east, 5.1e6 + north) for east in steps_m for north in steps_m))
    assert grid.density.anywhere_m2 == pytest.approx(1e8, rel=0.01)
    far_apart = spots_at((5.5e5, 5.1e6), (6.5e5, 5.2e6))
    assert far_apart.density.anywhere_m2 == 1e9


def test_positions_within_half_a_kilometre_of_a_spot_are_near():
    off_m = np.array([0.0, 490.0, 510.0, 1e5])
    assert SPOTS.are_near(FIRST - off_m).tolist() == [True, True, False, False]


def test_spots_that_are_on_no_map_say_the_same_of_all_places():
    nowhere = PhotoSpots.of(((-170.0, -46.8),), FRAME)
    assert density(nowhere, FIRST) == pytest.approx(0.5)
    assert not nowhere.are_near(FIRST).any()


def written(path, shapes):
    features = [
        {"type": "Feature", "geometry": {"type": kind, "coordinates": given}, "properties": {}}
        for kind, given in shapes
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def test_spots_are_read_from_a_table(tmp_path):
    (tmp_path / "spots.csv").write_text("name,lon,lat\nHorn,9.8,46.8\n,9.9,46.7\n")
    assert read_spots(tmp_path / "spots.csv") == ((9.8, 46.8), (9.9, 46.7))


def test_a_trail_is_a_row_of_spots_at_most_a_scale_apart(tmp_path):
    """A hundredth of a degree of latitude is 1,112 m: 23 steps of at most 50 m."""
    path = written(
        tmp_path / "a.geojson",
        [("Point", [9.5, 46.5]), ("LineString", [[9.8, 46.8], [9.8, 46.81]])],
    )
    spots = read_spots(path)
    assert spots[0] == (9.5, 46.5)
    assert len(spots) == 1 + 24
    assert spots[1] == (9.8, 46.8)
    assert spots[-1] == (9.8, 46.81)
    assert np.diff([lat for _, lat in spots[1:]]) == pytest.approx(0.01 / 23)


def test_waypoints_of_gpx_are_spots(tmp_path):
    (tmp_path / "a.gpx").write_text(
        '<gpx xmlns="http://www.topografix.com/GPX/1/1"><wpt lat="46.8" lon="9.8"/></gpx>'
    )
    assert read_spots(tmp_path / "a.gpx") == ((9.8, 46.8),)


@pytest.mark.parametrize(
    ("name", "content", "error"),
    [
        ("a.csv", "lon,lat\n", "holds no spots; expected points"),
        ("a.csv", "name,x,y\na,1,2\n", "has the columns"),
        ("a.csv", "lon,lat\n9.8,146.8\n", "lat"),
        ("a.txt", "9.8,46.8\n", "expected one of .csv"),
        ("a.svg", "<svg/>", "expected one of .csv"),
        ("a.json", '{"shapes": [{"points": [[1, 2]], "shape_type": "point"}]}', "drawn in a photo"),
        ("a.json", '{"images": [], "annotations": []}', "drawn in a photo"),
        ("a.json", '{"type": "Point", "coordinates": [6e5, 5e6]}', "no CRS; give the CRS in the"),
    ],
)
def test_a_file_that_holds_no_spots_is_refused(tmp_path, name, content, error):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=error):
        read_spots(tmp_path / name)


def test_a_polygon_is_no_spot(tmp_path):
    path = written(tmp_path / "a.json", [("Polygon", [[[9, 46], [10, 46], [10, 47], [9, 46]]])])
    with pytest.raises(InputError, match="feature 1 is a polygon; expected points, or lines"):
        read_spots(path)


@pytest.mark.parametrize("given", [(9.8,), "9.8,46.8", (9.8, 146.8), (np.nan, 46.8)])
def test_a_spot_is_a_longitude_and_a_latitude(given):
    with pytest.raises(InputError, match="a photo spot is"):
        Narrowing(photo_spots=[given])


@pytest.mark.parametrize("given", [None, 9.8, "spots.csv"])
def test_spots_are_pairs(given):
    with pytest.raises(InputError, match="photo_spots is"):
        Narrowing(photo_spots=given)


def test_spots_may_be_an_array():
    given = np.array([[9.8, 46.8], [9.9, 46.7]], dtype=np.float64)
    assert Narrowing(photo_spots=given).photo_spots == ((9.8, 46.8), (9.9, 46.7))
