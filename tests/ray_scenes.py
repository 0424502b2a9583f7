"""Rays of skylines whose pose is known."""

from dataclasses import replace

import numpy as np

from skyline.camera.projection import Projection
from skyline.match.rays import Rays
from skyline.pose.poses import Poses
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline_bench.queries.pinhole import Camera

BINS = 1440


def photographed(azimuth_rad, y, heading_deg, pitch_deg, roll_deg, fov_deg):
    """Return rays (u, v) of a camera that sees a skyline of elevation tangents y, left to right."""
    camera = Camera(heading_deg, pitch_deg, roll_deg, fov_deg, 1, 1)
    column, row, ahead = camera.project(azimuth_rad - np.radians(heading_deg), y)
    u, v = column / camera.focal_px, -row / camera.focal_px
    seen = ahead & (np.abs(column) < 0.5)
    order = np.argsort(u[seen])
    return u[seen][order], v[seen][order]


def photographed_from(field, eye, **camera):
    """Return rays (u, v) of a camera at one eye on a field, columns as fine as a photo's."""
    with HorizonRenderer(field, RenderConfig(1280)) as renderer:
        views = renderer.render(eye)
    tangent = np.tan(np.radians(views.elevation_deg()))
    return photographed(np.radians(views.grid_azimuth_deg()).ravel(), tangent.ravel(), **camera)


def equally_trusted(u, v, fov_deg):
    """Return rays that all weigh the same."""
    return Rays(u=u, v=v, weight=np.ones_like(u), fov_deg=fov_deg)


def rays_of(u, v, fov_deg, assumed_fov_deg=None, fov_range_deg=None):
    """Return rays whose field of view was assumed to be another one."""
    rays = Rays(u=u, v=v, weight=np.ones_like(u), fov_deg=fov_deg, fov_range_deg=(1.0, 179.0))
    return replace(rays.with_fov(assumed_fov_deg or fov_deg), fov_range_deg=fov_range_deg)


def swept(
    function, heading_deg, raised_deg, fov_deg, projection=Projection.CYLINDRICAL, columns=2000
):
    """Return the rays of a panorama of a made-up skyline, whose middle row is above the horizon."""
    u = np.radians(fov_deg * ((np.arange(columns) + 0.5) / columns - 0.5))
    y, raised = function(u + np.radians(heading_deg)), np.radians(raised_deg)
    v = y - np.tan(raised)
    if projection is Projection.EQUIRECTANGULAR:
        v = np.tan(np.arctan(y) - raised)
    return Rays(u=u, v=v, weight=np.ones_like(u), fov_deg=fov_deg, projection=projection)


def poses(count=1, **given):
    """Return poses at the origin, level and looking north, but for what is given."""
    names = ("easting_m", "northing_m", "eye_elevation_m", "grid_heading_deg", "pitch_deg")
    names += ("roll_deg", "fov_deg", "cost")
    values = dict.fromkeys(names, 0.0) | {"fov_deg": 60.0} | given
    return Poses(**{name: np.zeros(count) + value for name, value in values.items()})


def hills(azimuth_rad):
    """Return elevation tangents of a made-up skyline, smooth and never the same."""
    waves = [(3, 0.05, 0.3), (7, 0.03, 1.1), (19, 0.012, 2.0), (41, 0.005, 0.7)]
    return 0.15 + sum(size * np.sin(k * azimuth_rad + phase) for k, size, phase in waves)


def panorama_of(function, count=1, distance_m=4000.0):
    """Return elevation tangents and distances of the same skyline for each of ``count`` eyes."""
    azimuth = 2.0 * np.pi / BINS * np.arange(BINS)
    y = np.tile(function(azimuth), (count, 1))
    return y, np.full_like(y, distance_m)


def seen(function, heading_deg, pitch_deg=0.0, roll_deg=0.0, fov_deg=60.0, columns=4000):
    """Return rays (u, v) of a camera before a made-up skyline."""
    azimuth = np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False)
    return photographed(azimuth, function(azimuth), heading_deg, pitch_deg, roll_deg, fov_deg)
