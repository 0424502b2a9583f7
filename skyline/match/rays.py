"""The trusted columns of a photo's skyline as rays, and their means."""

import math
from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import Float64Array, IntArray
from skyline.camera.image_points import ImagePoints
from skyline.camera.levelling import level
from skyline.camera.projection import Projection
from skyline.camera.warps import WANDER_DEGREES
from skyline.errors import InputError
from skyline.match.lens_prior import LensPrior
from skyline.photo.skyline import Lens, PhotoSkyline

REFERENCE_FOV_DEG = 60.0
"""The field of view with which pixel sizes are compared."""
FOV_RANGE_DEG = (25.0, 100.0)
"""Fields of view that are searched where none is known."""
USUAL_FOV_DEG = (55.0, 14.0)
"""Mean and standard deviation of those fields of view: most photos are taken with a phone or a
usual zoom lens."""


@dataclass(frozen=True, slots=True)
class CameraModel:
    """Assumptions about the lenses and the panoramas of photos."""

    distortion_sd: float = 0.01
    """Standard deviation of a lens's distortion. The distortions of 3,500 lenses in lensfun's
    database are 2 to 6 % of half the width, rms; phones and many cameras correct their photos. With
    a larger deviation, wrong near slopes could be bent to fit."""
    wide_distortion_sd: float = 0.05
    """Standard deviation of a wide lens's distortion."""
    wide_deg: float = 75.0
    """Lenses with a greater field of view are wide."""
    fisheye_sd: float = 0.06
    """Standard deviation of t in a fisheye's mapping, x + t x^3, from the radius x in the image to
    the angle off the axis. An equidistant lens has 0, an equisolid one 1/24, a stereographic one
    -1/12."""
    wander_fov_deg: float = 240.0
    """A panorama that spans this wanders by 1 / (n - 1) degrees, one standard deviation, along the
    polynomial of degree n. The deviations grow with the square root of the field of view."""
    searched_sds: float = 4.0
    """Standard deviations to either side of a given field of view that are searched."""


_CAMERAS = CameraModel()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Rays(ImagePoints):
    """The trusted columns of a skyline, with the range of possible cameras.

    Raises `InputError` where all weights are 0.
    """

    weight: Float64Array
    """(R,) float64. Trust in each ray, at least 0; see `thinned` and `in_runs` for averages."""
    fov_range_deg: tuple[float, float] | None = None
    """Range of the true field of view; by default it is `fov_deg` exactly."""
    lens: LensPrior = LensPrior()  # noqa: RUF009  (it is frozen)
    """How likely the fields of view in that range are."""
    distortion_sd: float = 0.0
    """Standard deviation of the lens's distortion about 0; 0 for a panorama, and for a lens without
    distortion. See `skyline.camera.warps.undistorted`."""

    @classmethod
    def of(cls, photo: PhotoSkyline, fov_sd_share: float, *, finds_fov: bool) -> "Rays":
        """Return a photo's rays, and its possible fields of view.

        ``fov_sd_share`` is the standard deviation of a field of view, as a share of it, where the
        photo's `Lens` has none. Raises `InputError` for a photo of unknown field of view, unless
        the matcher finds it, and for a panorama or a fisheye of unknown field of view.
        """
        if photo.fov_deg is None:
            if not finds_fov or photo.projection is not Projection.PERSPECTIVE:
                raise InputError(
                    "the photo's field of view is not known: it is not in the image; give --fov-deg"
                )
            usual_deg, fov_sd_deg = USUAL_FOV_DEG
            usual = cls._with_known_fov(photo, usual_deg)
            return replace(usual.about(fov_sd_deg), fov_range_deg=FOV_RANGE_DEG)
        lens = photo.lens or Lens(photo.fov_deg)
        is_whole = photo.projection.is_panorama and photo.fov_deg == photo.projection.most_fov_deg
        share = 0.0 if is_whole else fov_sd_share
        fov_sd_deg = share * photo.fov_deg if lens.fov_sd_deg is None else lens.fov_sd_deg
        rays = cls._with_known_fov(photo, photo.fov_deg)
        return rays.about(fov_sd_deg, lens.most_fov_deg or math.inf, lens.crop_share)

    @classmethod
    def _with_known_fov(cls, photo: PhotoSkyline, fov_deg: float) -> "Rays":
        """Return a photo's rays with exactly this field of view."""
        u, v = photo.with_fov(fov_deg).image_plane()
        return cls(
            u=u,
            v=v,
            weight=photo.trust[photo.trusted],
            fov_deg=fov_deg,
            projection=photo.projection,
            distortion_sd=usual_distortion_sd(photo.projection, fov_deg),
        )

    def __post_init__(self) -> None:
        if not self.weight.any():
            raise InputError("all weights of the photo are 0, so there is nothing to match")

    @property
    def fov_bounds_deg(self) -> tuple[float, float]:
        """The smallest and the largest field of view that are searched."""
        return self.fov_range_deg or (self.fov_deg, self.fov_deg)

    @property
    def log_scale_bounds(self) -> tuple[float, float]:
        """The smallest and the largest `log_scale`."""
        low, high = self.log_scale(np.array(self.fov_bounds_deg))
        return float(low), float(high)

    def searched_fov_deg(self, log_scale: Float64Array) -> Float64Array:
        """Return `fov_at` of logarithms of scales, clipped to `fov_bounds_deg`."""
        return np.asarray(np.clip(self.fov_at(log_scale), *self.fov_bounds_deg))

    @property
    def warp_sd(self) -> Float64Array:
        """Standard deviations (K,) of how an image may be warped.

        There is one for the distortion of a lens that may distort, and one for each column of a
        panorama's `wander_ways`.
        """
        if self.is_panorama:
            grown = math.sqrt(self.fov_deg / _CAMERAS.wander_fov_deg)
            # As in a random walk, the shifts of rows fall with the inverse of the degree.
            return np.radians(1.0 / (np.array(WANDER_DEGREES) - 1.0)) * grown
        return np.array([self.distortion_sd] if self.distortion_sd > 0.0 else [])

    def with_fov(self, fov_deg: float) -> "Rays":
        """Return the rays for another field of view, degrees, within the range."""
        u, v = self.scaled(np.asarray(self.projection.half_width(fov_deg) / self.half_width))
        return replace(self, u=u, v=v, fov_deg=fov_deg)

    def about(
        self, fov_sd_deg: float, most_deg: float = math.inf, crop_share: float = 0.0
    ) -> "Rays":
        """Return the rays with a standard deviation of the field of view.

        The search reaches four standard deviations to either side, but not beyond what a camera
        allows or ``most_deg``, nor below half the field of view. If ``crop_share``, the probability
        that the photo was cropped, is above 0, it always reaches down to that half. With a
        deviation of 0 the field of view is known exactly.
        """
        if fov_sd_deg == 0.0:
            return self
        fov_deg = self.fov_deg
        possible_deg = 0.5 * (fov_deg + 180.0)
        if self.projection.spreads_angles:
            possible_deg = self.projection.most_fov_deg
        widest_deg = min(fov_deg + _CAMERAS.searched_sds * fov_sd_deg, possible_deg, most_deg)
        narrowest_deg = 0.5 * fov_deg
        if not crop_share:
            narrowest_deg = max(fov_deg - _CAMERAS.searched_sds * fov_sd_deg, narrowest_deg)
        fov_rad = math.radians(fov_deg)
        sd = math.radians(fov_sd_deg) / (
            fov_rad if self.projection.spreads_angles else math.sin(fov_rad)
        )
        return replace(
            self, fov_range_deg=(narrowest_deg, widest_deg), lens=LensPrior(sd, crop_share)
        )


def usual_distortion_sd(projection: Projection, fov_deg: float) -> float:
    """Return the standard deviation of a distortion about 0, which is usual."""
    if projection.is_panorama:
        return 0.0
    if projection is Projection.FISHEYE:
        return float(_CAMERAS.fisheye_sd * projection.half_width(fov_deg) ** 2)
    is_wide = fov_deg > _CAMERAS.wide_deg
    return _CAMERAS.wide_distortion_sd if is_wide else _CAMERAS.distortion_sd


def thinned(rays: Rays, bins: int) -> Rays:
    """Average the rays within each step of azimuth.

    There are ``bins`` steps all the way round a level camera. The terrain's curve is no finer than
    its bins, so averages hold nearly all the information of many columns at the cost of few. The
    averages run from left to right. The weight of an average is the mean weight of its rays, so
    weights refer to the noise of averages.
    """
    azimuth_rad = rays.projection.azimuth_rad(rays.u)
    step = np.floor(azimuth_rad * (bins / (2.0 * np.pi))).astype(np.intp)
    step -= step.min()
    total = np.bincount(step, rays.weight)
    kept = np.flatnonzero(total)
    return _averaged(rays, step, kept, total[kept] / np.bincount(step)[kept])


def in_runs(rays: Rays, count: int) -> Rays:
    """Average rays over ``count`` equal steps of u.

    Steps with few trusted rays are left out. The mean weight is 1. A panorama is joined from
    photos, so it has ``count`` steps in each 60 degrees, and so does a fisheye, which is as wide.
    """
    if rays.projection.spreads_angles:
        count = max(1, round(count * rays.fov_deg / REFERENCE_FOV_DEG))
    left, right = rays.u.min(), rays.u.max()
    width = max((right - left) / count, 1e-9)
    step = np.minimum((rays.u - left) / width, count - 1).astype(np.intp)
    total = np.bincount(step, rays.weight, count)
    kept = np.flatnonzero(total > 0.3 * np.median(total[total > 0.0]))
    return _averaged(rays, step, kept, total[kept] / total[kept].mean())


def _averaged(rays: Rays, step: IntArray, kept: IntArray, weight: Float64Array) -> Rays:
    """Return the rays' weighted means in the kept steps, with new weights."""
    total = np.bincount(step, rays.weight)[kept]
    u, v = (np.bincount(step, rays.weight * ray)[kept] / total for ray in (rays.u, rays.v))
    return replace(rays, u=u, v=v, weight=weight)


def on_bins(rays: Rays, pitch_deg: float, bins: int) -> tuple[Float64Array, Float64Array]:
    """Return rays, levelled at one pitch, on B equal steps of azimuth.

    The results are tangents y (B,) of elevation angles, NaN outside the photo, and the trust (B,)
    in each, 0 outside. Bin B / 2 is straight ahead.

    Rays in one bin are averaged both in azimuth and in y, which removes noise without shifting a
    slope. Values at bin centres are interpolated linearly between these averages.
    """
    azimuth, y = level(rays.u, rays.v, pitch_deg, 0.0, rays.projection)
    position = azimuth * bins / (2.0 * np.pi) + bins / 2.0
    nearest = np.clip(np.rint(position), 0, bins - 1).astype(np.intp)
    weight = np.bincount(nearest, rays.weight, bins)
    filled = np.flatnonzero(weight)
    total = weight[filled]
    at = np.bincount(nearest, rays.weight * position, bins)[filled] / total
    mean_y = np.bincount(nearest, rays.weight * y, bins)[filled] / total
    mean_weight = total / np.bincount(nearest, minlength=bins)[filled]
    centres = np.arange(bins, dtype=np.float64)
    after = np.searchsorted(at, centres)
    spacing = np.diff(at, prepend=-np.inf, append=np.inf)
    step = float(np.median(np.diff(np.sort(position)))) if len(position) > 1 else 0.0
    # A centre within half a bin of a lone or outermost average still belongs to it.
    seen = (spacing[after] <= 3.0 * max(step, 1.0)) | (weight > 0.0)
    return (
        np.where(seen, np.interp(centres, at, mean_y), np.nan),
        np.where(seen, np.interp(centres, at, mean_weight), 0.0),
    )
