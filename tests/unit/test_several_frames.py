"""Poses and priors in several frames at once."""

import numpy as np
import pytest

from skyline.geodesy.map_frame import Frame
from skyline.match.narrowing import Narrowing
from skyline.match.prior import Prior
from skyline.photo.noted_place import NotedPlace
from skyline.pose.poses import Poses

FRAMES = [Frame.from_crs("EPSG:32632"), Frame.from_crs("EPSG:32633")]
LON, LAT = 12.0, 46.5
"""On the border of both zones."""


def poses_at(easting_m, northing_m, area):
    """Return poses that cost 0, 1, 2 ... and look north."""
    count = len(area)
    zeros = np.zeros(count)
    poses = Poses(
        easting_m=np.array(easting_m, dtype=float),
        northing_m=np.array(northing_m, dtype=float),
        eye_elevation_m=zeros,
        grid_heading_deg=zeros,
        pitch_deg=zeros,
        roll_deg=zeros,
        fov_deg=zeros,
        cost=np.arange(count, dtype=float),
    )
    return poses.found_in(np.array(area), FRAMES)


def test_equal_eastings_of_two_frames_are_two_places():
    """At the equator the zones' middles are 6 degrees apart, of 111.32 km each."""
    poses = poses_at([500_000.0, 500_000.0], [0.0, 0.0], [0, 1])
    apart_m = poses.distances_m()
    # The chord of 6 degrees.
    assert apart_m[0, 1] == pytest.approx(2.0 * 6_378_137.0 * np.sin(np.radians(3.0)), rel=1e-6)
    one, other = poses.on_map(*FRAMES)
    assert one.distance_m(other) == pytest.approx(667_917.0, abs=1.0)
    assert (one.area, other.area) == (0, 1)
    assert (one.lon, other.lon) == pytest.approx((9.0, 15.0))


def test_one_place_in_two_frames_is_one_answer():
    places = [[float(one) for one in frame.from_lonlat(LON, LAT)] for frame in FRAMES]
    (east, other_east), (north, other_north) = zip(*places, strict=True)
    poses = poses_at(
        [east, other_east, other_east + 500.0], [north, other_north, other_north], [0, 1, 1]
    )
    assert poses.distances_m()[0, 1] < 0.01
    assert poses.suppress_non_maxima(3, 100.0).tolist() == [0, 2]
    assert poses.rival_margin(200.0)[0] == 2.0


def test_distances_within_an_area_are_those_of_its_map():
    poses = poses_at([0.0, 300.0, 0.0], [0.0, 400.0, 0.0], [0, 0, 1])
    assert poses.distances_m()[0, 1] == 500.0


def test_a_prior_is_as_wide_in_every_frame():
    narrowing = Narrowing(near=(LON, LAT, 2.0))
    exif = NotedPlace(lonlat_deg=(LON, LAT))
    priors = Prior.of(narrowing, FRAMES[0], exif).in_frames(FRAMES)
    for prior, frame in zip(priors, FRAMES, strict=True):
        ((east, north, radius_m),) = prior.circles_m
        assert frame.to_lonlat(east, north) == pytest.approx((LON, LAT))
        assert radius_m == 2000.0
        assert (prior.position.easting_m, prior.position.northing_m) == (east, north)


def test_a_noted_place_off_a_map_costs_as_much_as_one_far_away():
    there = NotedPlace(lonlat_deg=(LON, LAT))
    antipode = Frame.from_crs("+proj=gnom +lat_0=-46 +lon_0=-168 +datum=WGS84")
    here, away = Prior.of(Narrowing(), FRAMES[0], there).in_frames([FRAMES[0], antipode])
    east, north = FRAMES[0].from_lonlat(LON, LAT + 3.0)
    far = here.position.cost(np.array([east + 1j * north]), np.zeros(1), np.zeros(1))
    off = away.position.cost(np.zeros(1, dtype=complex), np.zeros(1), np.zeros(1))
    np.testing.assert_allclose(off, far, atol=0.01)


def test_the_surroundings_of_a_noted_place_are_in_every_frame():
    """They reach 1 km and three scales of 30 m."""
    prior = Prior.of(Narrowing(), FRAMES[0], NotedPlace(lonlat_deg=(LON, LAT))).near_noted()
    for number, (frame, its) in enumerate(zip(FRAMES, prior.in_frames(FRAMES), strict=True)):
        east, north = (float(one) for one in frame.from_lonlat(LON, LAT))
        poses = poses_at([east + 1089.0, east + 1091.0], [north, north], [number, number])
        assert its.contains(poses).tolist() == [True, False]


def test_a_prior_around_a_place_contains_what_lies_in_both_circles():
    """Circles of 3 km whose middles are 4 km apart: the middle between them lies in both."""
    prior = Prior.of(Narrowing(near=(LON, LAT, 3.0)), FRAMES[0])
    east, north = (float(one) for one in FRAMES[0].from_lonlat(LON, LAT))
    lon, lat = FRAMES[0].to_lonlat(east + 4000.0, north)
    around = prior.around(FRAMES[0], lon=float(lon), lat=float(lat), radius_km=3.0)
    poses = poses_at([east - 500.0, east + 2000.0, east + 4500.0], [north] * 3, [0] * 3)
    assert around.contains(poses).tolist() == [False, True, False]
