"""A made-up mountain area seen by the oracle: a store's views, and queries taken in it."""

from functools import cache

import numpy as np

from skyline.features import polyline_keypoints
from skyline.geodesy import Frame
from skyline.matching.profiles import Profiles
from skyline.matching.query import QueryRays
from skyline.oracle import skyline
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import stand_on
from skyline.views import Views

SPACING_M = 200.0
SIDE = 6
SAMPLE_M = 30.0


@cache
def field() -> HeightField:
    """Mountains of the usual roughness, 7.7 km square."""
    size = 256
    rng = np.random.default_rng(7)
    frequency = np.hypot(np.fft.fftfreq(size)[:, np.newaxis], np.fft.rfftfreq(size))
    frequency[0, 0] = np.inf
    spectrum = rng.normal(size=(2, *frequency.shape)) * frequency**-2.0
    heights = np.fft.irfft2(spectrum[0] + 1j * spectrum[1], (size, size))
    heights *= 250.0 / heights.std()
    return HeightField(heights + 1500.0, 0.0, 0.0, SAMPLE_M, SAMPLE_M, Frame.from_crs("EPSG:32632"))


def locations_m() -> tuple[np.ndarray, np.ndarray]:
    west, south, east, north = field().bounds_m
    steps = (np.arange(SIDE) - (SIDE - 1) / 2.0) * SPACING_M
    easting, northing = np.meshgrid((west + east) / 2 + steps, (south + north) / 2 + steps)
    return easting.ravel(), northing.ravel()


@cache
def stored_views(width: int = 640) -> Views:
    return skyline(field(), stand_on(field(), *locations_m()), width)


@cache
def stored_profiles(tolerance_px: float = 1.0) -> Profiles:
    views = stored_views()
    return Profiles.from_views([(views, polyline_keypoints(views, tolerance_px))])


@cache
def horizon(easting_m: float, northing_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Azimuth (radians, three turns) and elevation tangent of the true skyline."""
    views = skyline(field(), stand_on(field(), easting_m, northing_m), 1200)
    azimuth = np.radians(views.azimuth_deg()).ravel()
    y = np.tan(np.radians(views.elevation_deg())).ravel()
    order = np.argsort(azimuth)
    turns = 2.0 * np.pi * np.array([-1.0, 0.0, 1.0])[:, np.newaxis]
    return (azimuth[order] + turns).ravel(), np.tile(y[order], 3)


def project(azimuth_rad, y, pitch_deg: float, roll_deg: float):
    """Rays of directions relative to the optical axis' vertical: written apart from `level`."""
    world = np.stack([np.sin(azimuth_rad), y, np.cos(azimuth_rad)])
    pitch, roll = np.radians([pitch_deg, roll_deg])
    tilt = np.array(
        [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]
    )
    # A camera turned clockwise sees the world turned counter-clockwise.
    turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    right, up, forward = turn @ tilt @ world
    return right / forward, up / forward


def take_query(
    place_m: tuple[float, float],
    heading_deg: float,
    pitch_deg: float = 0.0,
    roll_deg: float = 0.0,
    noise_deg: float = 0.0,
    trees: int = 0,
    fov_deg: float = 60.0,
    seed: int = 0,
) -> QueryRays:
    azimuth, y = horizon(*place_m)
    relative = np.radians(np.linspace(-0.75 * fov_deg, 0.75 * fov_deg, 1500))
    seen = np.interp(relative + np.radians(heading_deg), azimuth, y)
    u, v = project(relative, seen, pitch_deg, roll_deg)
    columns = 480
    half = np.tan(np.radians(fov_deg / 2.0))
    u_columns = ((2.0 * np.arange(columns) + 1.0) / columns - 1.0) * half
    order = np.argsort(u)
    v_columns = np.interp(u_columns, u[order], v[order])
    rng = np.random.default_rng(seed)
    v_columns += np.radians(noise_deg) * rng.normal(size=columns)
    for centre in rng.integers(0, columns, trees):
        trunk = slice(max(centre - 8, 0), centre + 8)
        v_columns[trunk] += rng.uniform(0.03, 0.08)
    return QueryRays.equally_trusted(u_columns, v_columns, fov_deg)
