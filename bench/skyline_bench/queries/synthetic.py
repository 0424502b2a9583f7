"""Synthetic queries: skylines of photos with known poses.

A synthetic query holds what a matcher gets for a photo: the skyline's row in each column of an
image, with the errors of an extraction, and a field of view that is nearly right. Each query has a
seed of its own: query k of a seed is the same whatever the number of queries, and its place and
pose are the same whatever the noise, the occluders or the elevation model.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from skyline.arrays import Float64Array, IntArray
from skyline.camera.projection import Projection
from skyline.camera.warps import distorted
from skyline.errors import InputError
from skyline.geodesy.map_frame import Frame, Rectangle
from skyline.match.rays import Rays
from skyline.photo.skyline import PhotoSkyline
from skyline.render.horizon import PanoramaRenderer
from skyline.skylines import Horizons, bin_azimuths_rad
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, stand_on
from skyline_bench.queries.pinhole import PIN_HOLE, Camera

BESIDE_M = 50.0
"""Distance of the place that is given from the true one, where a place is given."""
_MAX_DRAWS = 10_000
"""Draws of a place before an area counts as a hole."""
_POSE, _ERRORS, _MASKS, _OCCLUDERS, _LENS, _MAPPING = range(6)
"""Draws, each from a generator of its own."""
_SMOOTH_DEG = 1.0
"""Distance along a skyline at which the correlation of smooth errors drops to 1/e."""
_MASKED_RUNS = 2
_NOTICED = 0.5
"""Share of the things in front that an extraction notices and masks; the tops of the others stay in
the skyline."""


Run = tuple[int, int]
"""First column and the one after the last."""

_THINGS = ("tree", "tree", "building", "person")
"""Trees are the most frequent."""
_WIDTH_SHARE = {"tree": (0.02, 0.10), "building": (0.06, 0.20), "person": (0.015, 0.04)}
_RISE_SHARE = {"tree": (0.05, 0.25), "building": (0.03, 0.15), "person": (0.03, 0.12)}
"""How wide they are, and how far above the skyline they reach, as shares of the image's width."""
_NARROWEST_SHARE = 0.015
_ROUGHNESS = {"tree": 0.25, "building": 0.0, "person": 0.03}


@dataclass(frozen=True, slots=True, eq=False)
class Occluder:
    """Something near in a run of columns."""

    kind: str  # tree, building or person
    columns: Run  # First column and the one after the last
    row_px: Float64Array  # (n,); its top in these columns, above the skyline behind it


@dataclass(frozen=True, slots=True)
class QueryConfig:
    """How queries are drawn. Pairs are ranges to draw from evenly."""

    fov_deg: tuple[float, float] = (60.0, 60.0)  # True horizontal field of view
    mappings: tuple[str, ...] = (PIN_HOLE,)  # From directions to the image; one is drawn
    # The projection given to the matcher. With `PERSPECTIVE`, whatever camera took the photo, the
    # field of view given is a pin-hole camera's of the same focal length.
    projection: Projection = Projection.PERSPECTIVE
    # The field of view given is wrong by up to this share; 0 where it is known.
    fov_error: float = 0.05
    # Standard deviation of the lens's distortion; see `skyline.camera.warps.undistorted`.
    distortion_sd: float = 0.0
    max_tilt_deg: float = 5.0  # Pitch and roll are within this, at most 20
    # Standard deviations of pitch and roll as people hold cameras; None draws both evenly.
    tilt_sd_deg: tuple[float, float] | None = None
    # Whether cameras look to grid north, east, south or west, as stored views do.
    is_aligned: bool = False
    # Standard deviation of the skyline's error, an angle at the image's centre.
    noise_deg: tuple[float, float] = (0.1, 0.1)
    # Share of that error's variance that varies smoothly along the skyline, as where an extraction
    # follows a snow line; the rest is drawn anew in each column.
    smooth_share: float = 0.5
    masked_share: float = 0.1  # Share of the columns without a skyline, in two runs
    # Share of the columns with something near in front, which rises above the skyline.
    occluded_share: tuple[float, float] = (0.0, 0.0)
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M  # Above ground
    width_px: int = 640
    height_px: int = 960  # Tall, so that what rises steeply near by stays in the image
    azimuths: int = 10_240  # To a turn, of the exact horizon that the skyline is taken from

    @property
    def fov_sd_share(self) -> float:
        """Standard deviation of the given field of view, as a share.

        It is a share of the true one.
        """
        return self.fov_error / math.sqrt(3.0)


@dataclass(frozen=True, slots=True)
class Truth:
    """The true pose of a query.

    Angles are as in `skyline.camera.camera.Camera`.
    """

    # In the frame and above the datum of the query's elevation model.
    easting_m: float
    northing_m: float
    eye_elevation_m: float
    grid_heading_deg: float  # In [0, 360)
    pitch_deg: float
    roll_deg: float
    fov_deg: float  # Of the pin-hole camera, before the distortion
    distortion: float = 0.0

    def lonlat(self, frame: Frame) -> tuple[float, float]:
        """Return the longitude and the latitude of the place."""
        lon, lat = frame.to_lonlat(self.easting_m, self.northing_m)
        return float(lon), float(lat)

    def heading_deg(self, frame: Frame) -> float:
        """Return the heading from true north."""
        place_m = {"easting_m": self.easting_m, "northing_m": self.northing_m}
        return self.grid_heading_deg + float(frame.convergence_deg(**place_m))

    def beside_m(self, rng: np.random.Generator) -> tuple[float, float]:
        """Draw easting and northing of a place `BESIDE_M` beside this one."""
        off = BESIDE_M * np.exp(2j * np.pi * rng.uniform())
        return self.easting_m + off.real, self.northing_m + off.imag

    def off_m(self, easting_m: ArrayLike, northing_m: ArrayLike) -> Float64Array:
        """Return how far places are from this one, metres."""
        east_m = np.asarray(easting_m)
        north_m = np.asarray(northing_m)
        return np.asarray(np.hypot(east_m - self.easting_m, north_m - self.northing_m))

    def camera(self, width_px: int = 960, height_px: int = 640) -> Camera:
        """Return the camera as it was held, for a photo's size."""
        held = self.grid_heading_deg, self.pitch_deg, self.roll_deg, self.fov_deg
        return Camera(*held, width_px=width_px, height_px=height_px)


@dataclass(frozen=True, slots=True, eq=False)
class SyntheticQuery:
    """One query and the truth about it."""

    skyline: PhotoSkyline  # The matcher's input
    given_fov_deg: float  # The field of view it is given with
    fov_sd_share: float  # Standard deviation of the true one about that, as a share
    truth: Truth
    # (W,); the true skyline of the pin-hole camera, without errors, distortion, masks and
    # occluders; NaN where not in the image.
    row_px: Float64Array
    distance_m: float  # Harmonic mean of that skyline's; NaN where none is in the image
    occluders: tuple[Occluder, ...]

    def rays(self) -> Rays:
        """Return the query as a matcher's rays.

        They have what is known of its field of view. Raises `InputError` where no column has a
        skyline.
        """
        return Rays.of(self.skyline, self.fov_sd_share, finds_fov=True)


def make_queries(
    terrain: HeightField,
    bounds_m: Rectangle,
    count: int,
    seed: int = 0,
    config: QueryConfig | None = None,
) -> tuple[SyntheticQuery, ...]:
    """Make queries at places drawn evenly from an area, looking anywhere.

    The terrain is what the photos show, which need not be what a store was rendered from. The area
    is west, south, east and north; places off the surface are drawn again. An area without any
    surface raises `InputError`.
    """
    entropies = [[[seed, index]] for index in range(count)]
    made = _queries(terrain, bounds_m, entropies, config or QueryConfig())
    return tuple(query for (query,) in made)


def make_queries_together(
    terrain: HeightField,
    bounds_m: Rectangle,
    count: int,
    photos: int,
    seed: int = 0,
    config: QueryConfig | None = None,
) -> tuple[tuple[SyntheticQuery, ...], ...]:
    """Make several queries at each of ``count`` places; see `make_queries`."""
    entropies = [[[seed, index, photo] for photo in range(photos)] for index in range(count)]
    return tuple(_queries(terrain, bounds_m, entropies, config or QueryConfig()))


def _queries(
    terrain: HeightField, bounds_m: Rectangle, entropies: list[list[list[int]]], config: QueryConfig
) -> Iterator[tuple[SyntheticQuery, ...]]:
    """Yield the queries of each place.

    A place is drawn with its first query.
    """
    held = [[_hold(terrain, bounds_m, each, config) for each in some] for some in entropies]
    easting_m, northing_m = np.array([some[0][0] for some in held]).T
    eyes = stand_on(
        terrain, easting_m=easting_m, northing_m=northing_m, eye_height_m=config.eye_height_m
    )
    with PanoramaRenderer(terrain, config.azimuths) as renderer:
        rendered = renderer.render(eyes)
    for index, (some, drawn) in enumerate(zip(held, entropies, strict=True)):
        yield tuple(
            _photographed(rendered, index, camera, entropy, config)
            for (_, camera), entropy in zip(some, drawn, strict=True)
        )


def _hold(
    terrain: HeightField, bounds_m: Rectangle, entropy: list[int], config: QueryConfig
) -> tuple[tuple[float, float], Camera]:
    """Draw a place on the surface and a camera."""
    generator = np.random.default_rng([*entropy, _POSE])
    west, south, east, north = bounds_m
    grid_heading_deg = generator.uniform(0.0, 360.0)
    if config.is_aligned:
        grid_heading_deg = 90.0 * (grid_heading_deg // 90.0)
    most_deg = config.max_tilt_deg
    pitch_deg, roll_deg = (
        generator.uniform(-most_deg, most_deg, 2)
        if config.tilt_sd_deg is None
        else np.clip(generator.normal(0.0, config.tilt_sd_deg), -most_deg, most_deg)
    )
    camera = Camera(
        grid_heading_deg=grid_heading_deg,
        pitch_deg=float(pitch_deg),
        roll_deg=float(roll_deg),
        fov_deg=generator.uniform(*config.fov_deg),
        width_px=config.width_px,
        height_px=config.height_px,
        mapping=np.random.default_rng([*entropy, _MAPPING]).choice(config.mappings),
    )
    for _ in range(_MAX_DRAWS):
        easting_m = float(generator.uniform(west, east))
        northing_m = float(generator.uniform(south, north))
        if np.isfinite(terrain.height_at(easting_m=easting_m, northing_m=northing_m)):
            return (easting_m, northing_m), camera
    raise InputError(
        f"no place on the surface was found in easting {west:.0f} to {east:.0f}, northing "
        f"{south:.0f} to {north:.0f}; choose an area that is not all hole"
    )


def _photographed(
    horizons: Horizons, index: int, camera: Camera, entropy: list[int], config: QueryConfig
) -> SyntheticQuery:
    """Return the skyline that an extraction finds in a photo.

    The photo shows one of the horizons.
    """
    masks, errors, things, lens = (
        np.random.default_rng([*entropy, part]) for part in (_MASKS, _ERRORS, _OCCLUDERS, _LENS)
    )
    eye = (horizons.easting_m, horizons.northing_m, horizons.eye_elevation_m)
    easting_m, northing_m, eye_m = (float(part[index]) for part in eye)
    held = camera.grid_heading_deg, camera.pitch_deg, camera.roll_deg, camera.fov_deg
    distortion = config.distortion_sd * lens.standard_normal()
    truth = Truth(easting_m, northing_m, eye_m, *held, distortion)
    azimuth_deg = np.degrees(bin_azimuths_rad(horizons.elevation_tan.shape[1]))
    elevation_tan = horizons.elevation_tan[index].astype(np.float64)
    row_px, sample = camera.skyline(azimuth_deg, elevation_tan)
    inside = (row_px > -0.5) & (row_px < camera.height_px - 0.5)
    row_px = np.where(inside, row_px, np.nan)
    occluders = random_occluders(things, row_px, things.uniform(*config.occluded_share))
    found = row_px.copy()
    for occluder in occluders:
        noticed = things.uniform() < _NOTICED
        top_px = np.where(occluder.row_px > -0.5, occluder.row_px, np.nan)
        found[slice(*occluder.columns)] = np.nan if noticed else top_px
    found += _errors_px(errors, camera, config)
    for run in random_runs(masks, camera.width_px, config.masked_share, _MASKED_RUNS):
        found[slice(*run)] = np.nan
    found = _bent(found, camera.height_px, distortion)
    seen_m = np.maximum(horizons.distance_m[index, sample[inside]].astype(np.float64), 1.0)
    is_told = config.projection is not Projection.PERSPECTIVE
    told_deg = camera.fov_deg if is_told else camera.pin_hole_fov_deg
    given = told_deg * (1.0 + errors.uniform(-config.fov_error, config.fov_error))
    sure = np.isfinite(found).astype(np.float64)
    return SyntheticQuery(
        PhotoSkyline(found, sure, camera.width_px, camera.height_px, given, config.projection),
        given,
        config.fov_sd_share,
        truth,
        row_px,
        1.0 / float(np.mean(1.0 / seen_m)) if len(seen_m) else np.nan,
        occluders,
    )


def _bent(row_px: Float64Array, height_px: int, distortion: float) -> Float64Array:
    """Return a skyline's rows (W,) through a lens with distortion.

    Columns without a row stay without one.
    """
    width_px = len(row_px)
    known = np.isfinite(row_px)
    if distortion == 0.0 or not known.any():
        return row_px
    across = (2.0 * np.arange(width_px) + 1.0) / width_px - 1.0
    above = (height_px - 1.0 - 2.0 * _filled(row_px)) / width_px
    seen, height = distorted(across, above, distortion)
    bent = np.interp(across, seen, height, left=np.nan, right=np.nan)
    hidden = np.interp(across, seen, np.where(known, 0.0, 1.0)) > 0.0
    return np.where(hidden, np.nan, (height_px - 1.0 - bent * width_px) / 2.0)


def _errors_px(generator: np.random.Generator, camera: Camera, config: QueryConfig) -> Float64Array:
    """Draw the errors of the rows (W,).

    Each is the sum of the column's own error and of a smooth part.
    """
    rms_px = np.radians(generator.uniform(*config.noise_deg)) * camera.focal_px
    own, smooth = generator.standard_normal((2, camera.width_px))
    # White noise under a Gaussian of deviation s has the correlation exp(-d^2 / (4 s^2)).
    deviation_px = np.radians(_SMOOTH_DEG) * camera.focal_px / 2.0
    impulse = np.eye(1, camera.width_px)[0]
    smooth, kernel = (
        ndimage.gaussian_filter1d(values, deviation_px, mode="wrap") for values in (smooth, impulse)
    )
    smooth /= np.linalg.norm(kernel)
    share = config.smooth_share
    return np.asarray(rms_px * (np.sqrt(1.0 - share) * own + np.sqrt(share) * smooth))


# --- occluders: trees, people and buildings before the mountains ----------------------------


def random_runs(
    generator: np.random.Generator, width: int, share: float, count: int
) -> tuple[Run, ...]:
    """Return ``count`` runs of columns that do not overlap.

    Together they hold ``share`` of ``width`` columns.
    """
    hidden = round(share * width)
    count = min(count, hidden)
    return _placed(generator, width, 1 + _split(generator, hidden - count, count)) if count else ()


def random_occluders(
    generator: np.random.Generator, skyline_px: Float64Array, share: float
) -> tuple[Occluder, ...]:
    """Return occluders over ``share`` of the columns of a skyline (W,).

    Where the skyline is not in the picture (NaN), they rise from where it is last seen.
    """
    width = len(skyline_px)
    left = round(share * width)
    kinds = list[str]()
    lengths = list[int]()
    while left > 0:
        kinds.append(_THINGS[generator.integers(len(_THINGS))])
        length = round(generator.uniform(*_WIDTH_SHARE[kinds[-1]]) * width)
        # No sliver is left for a last one.
        lengths.append(left if left - length < _NARROWEST_SHARE * width else length)
        left -= lengths[-1]
    runs = zip(kinds, _placed(generator, width, lengths) if lengths else (), strict=True)
    behind = _filled(skyline_px)
    return tuple(_stand(generator, kind, run, behind) for kind, run in runs)


def _stand(
    generator: np.random.Generator, kind: str, run: Run, behind_px: Float64Array
) -> Occluder:
    """Return an occluder of a kind, higher than what it hides."""
    start, stop = run
    across = (2.0 * np.arange(stop - start) + 1.0) / (stop - start) - 1.0
    shapes = {"tree": 1.0 - np.abs(across), "person": np.sqrt(1.0 - across**2)}
    shape = shapes.get(kind, np.ones_like(across))
    rise_px = generator.uniform(*_RISE_SHARE[kind]) * len(behind_px)
    rough = 1.0 + _ROUGHNESS[kind] * generator.standard_normal(len(across))
    behind = behind_px[start:stop]
    level = behind.min() if kind == "building" else behind
    return Occluder(kind, run, level - np.maximum(rise_px * shape * rough, 1.0))


def _filled(row_px: Float64Array) -> Float64Array:
    """Return rows (W,) with unknown ones interpolated.

    All are 0 where none is known.
    """
    known = np.flatnonzero(np.isfinite(row_px))
    if not known.size:
        return np.zeros_like(row_px)
    return np.interp(np.arange(len(row_px)), known, row_px[known])


def _split(generator: np.random.Generator, total: int, parts: int) -> IntArray:
    """Return random whole numbers (parts,) with a given sum.

    They are at least 0 and drawn evenly.
    """
    cuts = np.sort(generator.integers(0, total + 1, parts - 1))
    return np.diff(cuts, prepend=0, append=total).astype(np.intp)


def _placed(generator: np.random.Generator, width: int, lengths: ArrayLike) -> tuple[Run, ...]:
    """Return runs of given lengths in order, with gaps drawn between them."""
    lengths = np.asarray(lengths)
    gaps = _split(generator, width - int(np.sum(lengths)), len(lengths) + 1)
    starts = np.cumsum(gaps[:-1]) + np.cumsum(lengths) - lengths
    return tuple(zip(starts.tolist(), (starts + lengths).tolist(), strict=True))
