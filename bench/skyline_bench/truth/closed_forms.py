"""Hard cases with their terrain, and cases of map frames.

Positions are whole multiples of powers of two, so that an eye that is to be on a sample, an edge or
a diagonal is there exactly.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pyproj import Geod, Transformer

from skyline.angles import wrapped_deg
from skyline.arrays import Float64Array
from skyline.geodesy.earth import Curvature
from skyline.geodesy.map_frame import Frame
from skyline.skylines import HEADINGS, columns_u, pixel_size
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, at_elevation, stand_on
from skyline_bench.geotiff import write_geotiff
from skyline_bench.truth.agreement import (
    Agreement,
    RenderPath,
    SkylineScene,
    SkylineTruth,
    oracle_truth,
)

FLAT = Curvature(enabled=False)
FRAME = Frame.local(lon=9.8, lat=46.8)
WEST_M = 2.0**19
NORTH_M = 2.0**22
SPACING_M = 32.0

HORIZON_ONLY = ("horizon",)
"""For cases in which a depth image shows too little to promise anything."""


@dataclass(frozen=True, slots=True)
class ClosedForm:
    """Skylines known without looking at any edge."""

    v: Float64Array  # (N, W)
    # How far the surface between samples may be from the form that gave the skylines.
    slack_tan: float = 0.0


@dataclass(frozen=True, slots=True)
class SceneCase:
    """A scene whose skylines are compared with the truth."""

    name: str
    breaks: str  # What a renderer could get wrong, one phrase
    scene: Callable[[], SkylineScene]  # Makes the scene
    # Gives the skylines of a scene; without it the oracle does.
    closed_form: Callable[[SkylineScene], ClosedForm] | None = None
    paths: tuple[str, ...] = ("horizon", "depth")  # Names of the paths that promise something here

    def agreement(self, path: RenderPath, quick: bool) -> Agreement:
        """Render the scene along a path and compare it with the truth."""
        scene, truth = _posed(self, quick)
        return path.agreement(scene, path.render(scene), truth)

    def truth(self, scene: SkylineScene) -> SkylineTruth:
        """Return the truth: flags and depth are the oracle's in any case."""
        truth = oracle_truth(scene)
        if self.closed_form is None:
            return truth
        form = self.closed_form(scene)
        missing = np.isnan(truth.views.v)
        v = np.where(missing, np.nan, form.v)
        return SkylineTruth(replace(truth.views, v=v), form.slack_tan / pixel_size(scene.width))


@lru_cache(maxsize=1)
def _posed(case: SceneCase, quick: bool) -> tuple[SkylineScene, SkylineTruth]:
    """Return a case's scene and truth.

    They are kept, since several paths look at one case in turn.
    """
    scene = case.scene().quick() if quick else case.scene()
    return scene, case.truth(scene)


def rough_heights(rows: int, cols: int, relief_m: float = 800.0, seed: int = 0) -> Float64Array:
    """Return rough heights with a power-law spectrum.

    At a spacing of 32 m, slopes are 45 degrees and more.
    """
    return 1500.0 + relief_m * fractal(rows, cols, seed, 1.8)


def fractal(rows: int, cols: int, seed: int, exponent: float) -> Float64Array:
    """Return noise (rows, cols) from -1 to 1 with a power-law spectrum."""
    generator = np.random.default_rng(seed)
    frequency = np.hypot(np.fft.fftfreq(rows)[:, np.newaxis], np.fft.rfftfreq(cols))
    frequency[0, 0] = np.inf
    spectrum = generator.normal(size=frequency.shape) + 1j * generator.normal(size=frequency.shape)
    noise = np.fft.irfft2(spectrum * frequency**-exponent, s=(rows, cols))
    return np.asarray(noise / np.abs(noise).max(), dtype=np.float64)


def field_of(
    heights_m: ArrayLike,
    spacing_m: float = SPACING_M,
    spacing_north_m: float | None = None,
    west_m: float = WEST_M,
    north_m: float = NORTH_M,
) -> HeightField:
    """Make a field of 32-bit heights, row 0 north."""
    heights = np.array(heights_m, dtype=np.float32)
    return HeightField(heights, west_m, north_m, spacing_m, spacing_north_m or spacing_m, FRAME)


def eyes_at(
    field: HeightField, row: ArrayLike, col: ArrayLike, eye_height_m: ArrayLike
) -> Viewpoints:
    """Stand at fractional rows and columns of a field."""
    east_m, north_m = field.to_map(row, col)
    return stand_on(field, easting_m=east_m, northing_m=north_m, eye_height_m=eye_height_m)


def spots(field: HeightField, count: int) -> tuple[Float64Array, Float64Array]:
    """Return rows and columns of samples away from the border."""
    generator = np.random.default_rng(7)
    row = generator.integers(field.rows // 8, field.rows - field.rows // 8 - 1, count)
    col = generator.integers(field.cols // 8, field.cols - field.cols // 8 - 1, count)
    return row.astype(np.float64), col.astype(np.float64)


def rough_field(seed: int = 1) -> HeightField:
    """Return 96 x 96 rough samples at 32 m."""
    return field_of(rough_heights(96, 96, seed=seed))


def eyes_anywhere(field: HeightField, count: int, eye_height_m: ArrayLike) -> Viewpoints:
    """Stand at random places away from the border."""
    row, col = spots(field, count)
    row_share, col_share = np.random.default_rng(3).uniform(0.0, 1.0, (2, count))
    return eyes_at(field, row + row_share, col + col_share, eye_height_m)


# --- map frames: degrees in, through `read_dem`, true azimuths out --------------------------

# The truth uses no map: from the eye, geodesics of WGS 84 leave at each column's true azimuth over
# terrain that is a function of place on the ellipsoid.

_GEOD = Geod(ellps="WGS84")
_TO_EARTH_CENTRED = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
_EYE_M = 510.0
"""Elevation of the eye, 10 m above the plain."""
_PEAK_M = 1500.0
"""Height of the peaks above the plain."""
_SIGMA_M = 2000.0
"""Distance from a peak's middle at which its height has dropped to 0.61."""
_PEAK_AWAY_M = 17_000.0
"""Distance of the peaks from the eye."""
_PEAK_AZIMUTHS_DEG = np.array([20.0, 100.0, 190.0, 300.0])
_REACH_M = 26_000.0
"""Every azimuth is in the data at least so far."""

_STEP_DEG = 1.0 / 600.0
"""6 arc-seconds of latitude, 186 m; longitude has as many metres."""

_PROFILE_M = np.linspace(50.0, _REACH_M, 400)


@dataclass(frozen=True, slots=True)
class _Country:
    """Four peaks on flat ground around a place on the ellipsoid.

    The DEM is centred 10 km west of the eye, so that grid north at the eye is not true north.
    """

    lon_deg: float
    lat_deg: float

    def scene(self) -> SkylineScene:
        """Return the scene of the country, read from DEM tiles.

        The tiles are in degrees, and are written first.
        """
        with tempfile.TemporaryDirectory() as folder:
            field = read_dem(self._write_tiles(Path(folder)))
        eye = field.frame.from_lonlat(self.lon_deg, self.lat_deg)
        return SkylineScene(field, at_elevation(field, *eye, _EYE_M), 320)

    def skyline(self, scene: SkylineScene) -> ClosedForm:
        """Return the skylines along geodesics."""
        eyes = scene.viewpoints
        frame = scene.field.frame
        turn = frame.convergence_deg(easting_m=eyes.easting_m, northing_m=eyes.northing_m)[0]
        u = columns_u(scene.width)
        azimuth_deg = (90.0 * heading + np.degrees(np.arctan(u)) + turn for heading in HEADINGS)
        rows = [self._skyline(each, scene) for each in azimuth_deg]
        tan = np.stack(rows) * np.hypot(1.0, u)
        return ClosedForm(tan, _slack_tan(scene.field.spacing_m))

    def _skyline(self, azimuth_deg: Float64Array, scene: SkylineScene) -> Float64Array:
        """Return the tangent of the skyline's elevation angle at true azimuths."""
        azimuth, distance = np.broadcast_arrays(azimuth_deg[:, np.newaxis], _PROFILE_M)
        here = np.full(azimuth.shape, self.lon_deg), np.full(azimuth.shape, self.lat_deg)
        lon, lat, _ = _GEOD.fwd(*here, azimuth, distance)
        rise = self.height_m(lon, lat) - _EYE_M - scene.curvature.drop_m(distance)
        return np.asarray((rise / distance).max(axis=1), dtype=np.float64)

    def height_m(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> Float64Array:
        """Return heights: a Gaussian of the straight distance to each peak."""
        place = _earth_centred_m(lon_deg, lat_deg)
        height = np.full(place.shape[:-1], 500.0)
        for azimuth in _PEAK_AZIMUTHS_DEG:
            lon, lat, _ = _GEOD.fwd(self.lon_deg, self.lat_deg, azimuth, _PEAK_AWAY_M)
            away = np.linalg.norm(place - _earth_centred_m(lon, lat), axis=-1)
            height += _PEAK_M * np.exp(-0.5 * (away / _SIGMA_M) ** 2)
        return height

    def _write_tiles(self, folder: Path) -> list[Path]:
        """Write two tiles that meet at the eye's meridian.

        Their degrees are within +-180.
        """
        shrink = np.cos(np.radians(self.lat_deg))
        step_lon = _STEP_DEG * np.round(1.0 / shrink)
        reach_deg = 1.1 * _REACH_M / 111_000.0
        rows = int(np.ceil(reach_deg / _STEP_DEG))
        east = int(np.ceil(reach_deg / shrink / step_lon))
        west = int(np.ceil(east * (1.0 + 20_000.0 / _REACH_M)))
        lat = self.lat_deg + (rows - 0.5 - np.arange(2 * rows)) * _STEP_DEG
        paths = []
        for first, count in ((-west, west), (0, east)):
            left = float(wrapped_deg(self.lon_deg + first * step_lon))
            lon = left + (np.arange(count) + 0.5) * step_lon
            heights = self.height_m(*np.meshgrid(lon, lat)).astype(np.float32)
            corner = (left, lat[0] + 0.5 * _STEP_DEG)
            step = (step_lon, _STEP_DEG)
            path = folder / f"tile{first}.tif"
            paths.append(write_geotiff(path, heights, "EPSG:4326", corner, step))
        return paths


def _slack_tan(spacing_m: float) -> float:
    """Return how far v on the samples may be off.

    The truth is v on the function that is sampled. The function's second derivative is at most k =
    peak / sigma^2. Triangles with legs of one spacing lie within k spacing^2 / 4 of it, cubic
    convolution of samples a spacing apart within a tenth of that, twice over for the profile's
    steps of 65 m; seen from beyond two sigmas before a peak. Geodesic and grid line to 20 km part
    by less than 20 km * 20 km / R^2 = 1e-5 in azimuth, and the frame's scale is within 2e-5 of 1.
    """
    curve = _PEAK_M / _SIGMA_M**2
    nearest = _PEAK_AWAY_M - 2.0 * _SIGMA_M
    return 1.2 * curve * spacing_m**2 / 4.0 / nearest + 3e-5


def _earth_centred_m(lon_deg: ArrayLike, lat_deg: ArrayLike) -> Float64Array:
    """Return ellipsoid places (..., 3), metres from the Earth's centre."""
    lon, lat = np.broadcast_arrays(lon_deg, lat_deg)
    return np.stack(_TO_EARTH_CENTRED.transform(lon, lat, np.zeros(lon.shape)), axis=-1)


FRAME_CASES = tuple(
    SceneCase(name, breaks, (country := _Country(*lonlat_deg)).scene, country.skyline)
    for name, breaks, *lonlat_deg in (
        ("latitude 0", "the equator: latitudes of both signs in one tile", 9.0, 0.0),
        ("latitude 60", "a degree of longitude is half one of latitude", 9.0, 60.0),
        ("latitude 84", "a tenth; meridians converge by a degree in 6 km", 9.0, 84.0),
        ("antimeridian", "longitudes jump from 180 to -180 at the eye", 180.0, 52.0),
        ("southern hemisphere", "north and south swapped", -70.0, -33.0),
    )
)
