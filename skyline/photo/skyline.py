"""The query skyline of a photo, and the camera behind it: its projection and its lens."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.polynomial import legendre

from skyline.arrays import BoolArray, Float64Array
from skyline.errors import InputError
from skyline.photo.exif import NOTHING_NOTED, NotedPlace

MIN_FOV_DEG = 1.0
MAX_FOV_DEG = 179.0
MAX_PANORAMA_DEG = 360.0
MOST_DISTORTION = 0.3
"""Greatest distortion of a lens, see `undistorted`; a lens with more is a fisheye."""
WANDER_DEGREES = range(2, 6)
"""Degrees of the Legendre polynomials by which the rows of a panorama wander."""
_NEWTON_STEPS = 30
_MET = 1e-9
_SAME_ROWS = 0.02


class Projection(StrEnum):
    """Projections of a photo.

    Each is described by the two quantities that grow evenly across and up the photo.

    Attributes
    ----------
    PERSPECTIVE
        Tangents of the angle, across and upwards: a photo through a lens.
    CYLINDRICAL
        Azimuth across, tangent of elevation upwards: swept and most stitched panoramas.
    EQUIRECTANGULAR
        Azimuth across, elevation upwards: photo spheres.
    """

    PERSPECTIVE = "perspective"
    CYLINDRICAL = "cylindrical"
    EQUIRECTANGULAR = "equirectangular"

    @classmethod
    def _missing_(cls, value: object) -> "Projection":
        raise InputError(f"projection is {value!r}; expected {', '.join(cls)}")

    @property
    def is_panorama(self) -> bool:
        """True if the photo was swept or stitched, rather than taken in one exposure."""
        return self is not Projection.PERSPECTIVE

    def check_fov_deg(self, fov_deg: float) -> float:
        """Return a horizontal field of view, or raise `InputError` if it is impossible."""
        greatest = MAX_PANORAMA_DEG if self.is_panorama else MAX_FOV_DEG
        if not MIN_FOV_DEG <= fov_deg <= greatest:
            hint = (
                "a full turn is the most"
                if self.is_panorama
                else "a phone's main camera has about 65; a panorama needs its projection, too, "
                "usually cylindrical"
            )
            raise InputError(
                f"horizontal field of view is {fov_deg:g} degrees; expected {MIN_FOV_DEG:g} to "
                f"{greatest:g}: {hint}"
            )
        return float(fov_deg)

    def rays(
        self, across: Float64Array, above: Float64Array, fov_deg: float
    ) -> tuple[Float64Array, Float64Array]:
        """Return places u, v on an image of unit focal length for places in a photo.

        Through a lens u and v are right and up over forward: the ray is (u, v, 1). A panorama's
        image is a cylinder: u is the azimuth from its middle, radians, v the tangent of the
        elevation, and the ray is (sin u, v, cos u).

        Parameters
        ----------
        across, above : (N,) float64
            From the photo's middle to the right and upwards, in halves of its width.
        fov_deg : float
            Horizontal field of view.
        """
        half = np.radians(fov_deg) / 2.0
        if self is Projection.PERSPECTIVE:
            return across * np.tan(half), above * np.tan(half)
        up = above * half if self is Projection.CYLINDRICAL else np.tan(above * half)
        return across * half, up

    def places(
        self, u: Float64Array, v: Float64Array, fov_deg: float
    ) -> tuple[Float64Array, Float64Array]:
        """Return the places across and above in a photo of rays u, v: the inverse of `rays`."""
        half = np.radians(fov_deg) / 2.0
        if self is Projection.PERSPECTIVE:
            return u / np.tan(half), v / np.tan(half)
        above = v if self is Projection.CYLINDRICAL else np.arctan(v)
        return u / half, above / half

    def column_deg(self, width: int, fov_deg: float) -> Float64Array:
        """Return the degrees of azimuth that each of ``width`` columns spans, (width,)."""
        edges = np.linspace(-1.0, 1.0, width + 1)
        u, _ = self.rays(edges, np.zeros_like(edges), fov_deg)
        azimuth = u if self.is_panorama else np.arctan(u)
        return np.asarray(np.degrees(np.diff(azimuth)), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Lens:
    """The horizontal field of view that a file notes for its photo.

    Attributes
    ----------
    fov_deg : float or None
        The likeliest horizontal field of view; None if nothing is known.
    sd_deg : float or None
        Standard deviation of ``fov_deg``; None if it is as accurate as a value that a user gives.
    most_deg : float or None
        The greatest possible field of view, if the photo was cropped or digitally zoomed.
    reason : str
        The source of the values in words, or the reason that there are none; empty if the file
        notes no lens.
    """

    fov_deg: float | None = None
    sd_deg: float | None = None
    most_deg: float | None = None
    reason: str = ""

    @property
    def in_words(self) -> str:
        """One line: the field of view and its source; empty if the file notes no lens."""
        if not self.reason:
            return ""
        fov = "not known" if self.fov_deg is None else f"{self.fov_deg:.1f} degrees"
        sd = self.sd_deg
        slack = "" if sd is None else f", give or take {sd:.{int(sd < 1.0)}f}"
        return f"field of view: {fov}{slack}; {self.reason}"


@dataclass(frozen=True, slots=True, eq=False)
class PhotoSkyline:
    """The skyline of one photo, one row per column; pixel centres are at whole numbers.

    Attributes
    ----------
    row_px : (W,) float64
        Row of the border between sky and ground; NaN where it is absent or not trusted. A border
        known to the pixel only is the row of the last sky pixel plus 0.5.
    confidence : (W,) float64
        0 to 1; 0 where ``row_px`` is NaN.
    width_px, height_px : int
        Size of the photo the rows refer to.
    fov_deg : float or None
        Horizontal field of view, None if unknown.
    projection : Projection
        Maps columns and rows to rays.
    noted : NotedPlace
        Place and heading that the photo notes.
    lens : Lens, optional
        Accuracy of `fov_deg`, if it comes from the photo's EXIF or XMP.
    eye_height_m : float, optional
        Height of the camera above the ground, None if unknown.
    crests : (3, W) float64, optional
        Rows of up to three crests a column, the likeliest first, NaN where there are fewer. None if
        the skyline was not extracted.
    """

    row_px: Float64Array
    confidence: Float64Array
    width_px: int
    height_px: int
    fov_deg: float | None = None
    projection: Projection = Projection.PERSPECTIVE
    noted: NotedPlace = NOTHING_NOTED
    lens: Lens | None = None
    eye_height_m: float | None = None
    crests: Float64Array | None = None

    def __post_init__(self) -> None:
        shapes: dict[str, tuple[int, ...]] = {
            "row_px": (self.width_px,),
            "confidence": (self.width_px,),
        }
        if self.crests is not None:
            shapes["crests"] = (3, self.width_px)
        for name, shape in shapes.items():
            values = np.ma.array(getattr(self, name), dtype=np.float64).filled(np.nan)
            if values.shape != shape:
                raise InputError(
                    f"{name} has shape {values.shape}; expected {shape}, one value per image column"
                )
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if self.height_px < 1 or self.width_px < 1:
            raise InputError(
                f"image size is {self.width_px} x {self.height_px} px; expected at least 1 x 1"
            )
        object.__setattr__(self, "projection", Projection(self.projection))
        if self.fov_deg is not None:
            object.__setattr__(self, "fov_deg", self.projection.check_fov_deg(self.fov_deg))
        # Means of confidences pass 0 and 1 by rounding.
        if not np.all(np.abs(self.confidence - 0.5) <= 0.5 + 1e-6):
            raise InputError("a confidence is not a number from 0 to 1; scale them")
        if np.any((self.confidence > 0.0) & ~self.trusted):
            raise InputError("confidence is above 0 where row_px is NaN; expected 0 there")

    def __repr__(self) -> str:
        lens = "unknown" if self.fov_deg is None else f"{self.fov_deg:.1f} degrees"
        return (
            f"PhotoSkyline({self.width_px} x {self.height_px} px; columns trusted: "
            f"{100.0 * self.trusted.mean():.0f} %; field of view: {lens})"
        )

    @property
    def trusted(self) -> BoolArray:
        """(W,) bool: True for columns with a skyline."""
        return np.isfinite(self.row_px)

    def other_crest_px(self) -> Float64Array:
        """Return the row (W,) of the likeliest crest that is not the skyline; NaN where none is.

        A crest nearer than 2 % of the height is the skyline itself.
        """
        if self.crests is None:
            return np.full(self.width_px, np.nan)
        rows = self.crests
        other = np.isfinite(rows) & ~(np.abs(rows - self.row_px) < _SAME_ROWS * self.height_px)
        likeliest = rows[other.argmax(axis=0), np.arange(self.width_px)]
        return np.where(other.any(axis=0), likeliest, np.nan)

    def with_fov(self, fov_deg: float) -> "PhotoSkyline":
        """Return the same skyline with another horizontal field of view, degrees."""
        return replace(self, fov_deg=fov_deg, lens=None)

    def image_plane(self) -> tuple[Float64Array, Float64Array]:
        """Return the trusted columns on an image of unit focal length.

        Returns
        -------
        u, v : (N,) float64
            To the right of and above the image's middle; square pixels. A perspective photo has
            rays (u, v, 1), u = ((2q + 1)/W - 1) tan(fov/2) and v = (H - 1 - 2r)/W tan(fov/2); for
            panoramas see `Projection.rays`.

        Raises
        ------
        InputError
            No field of view is known.
        """
        columns = np.flatnonzero(self.trusted)
        across = (2.0 * columns + 1.0) / self.width_px - 1.0
        above = (self.height_px - 1.0 - 2.0 * self.row_px[columns]) / self.width_px
        return self.projection.rays(across, above, self._known_fov_deg())

    def visible_deg(self) -> float:
        """Return the degrees of azimuth that the trusted columns span with the camera held level.

        Raises as `image_plane`.
        """
        spans = self.projection.column_deg(self.width_px, self._known_fov_deg())
        return float(spans[self.trusted].sum())

    def _known_fov_deg(self) -> float:
        if self.fov_deg is None:
            raise InputError(
                "the photo's field of view is not known; give its horizontal field of view, "
                f"from {MIN_FOV_DEG:g} degrees on (--fov-deg)"
            )
        return self.fov_deg


def check_of_image(query: PhotoSkyline, shape: tuple[int, ...]) -> None:
    """Raise `InputError` unless a skyline belongs to an image of a shape (H, W, ...)."""
    height, width = shape[:2]
    if (width, height) != (query.width_px, query.height_px):
        raise InputError(
            f"the skyline is of an image of {query.width_px} x {query.height_px} px, the photo has "
            f"{width} x {height}; expected the same image"
        )


def wander_of(across: Float64Array) -> Float64Array:
    """Return the ways in which the rows of a panorama wander up and down, at places across it.

    A panorama is joined from many exposures, and its horizon is seldom straight. Each of the ways,
    (..., 4), is a Legendre polynomial of ``across``, which is -1 and 1 at the sides. The lower
    degrees are left out: they are a shift and a turn of the whole image.
    """
    return np.asarray(legendre.legvander(across, WANDER_DEGREES[-1])[..., WANDER_DEGREES])


def wandered(across: Float64Array, wander: Sequence[float]) -> Float64Array:
    """Return how far up the rows of a panorama have wandered, as tangents, at places across it.

    ``wander`` has a factor for each of the ways of `wander_of`.
    """
    return np.asarray(legendre.legval(across, (0.0,) * WANDER_DEGREES[0] + tuple(wander)))


def undistorted(
    across: Float64Array, above: Float64Array, distortion: float
) -> tuple[Float64Array, Float64Array]:
    """Return the places at which a lens without distortion would show what this lens shows.

    The distortion k multiplies the distance r from the middle, in halves of the width, by
    1 + k r^2; it is positive for barrel distortion.
    """
    stretch = 1.0 + distortion * (across**2 + above**2)
    return across * stretch, above * stretch


def distorted(
    across: Float64Array, above: Float64Array, distortion: float
) -> tuple[Float64Array, Float64Array]:
    """Return the inverse of `undistorted`; NaN for places that the lens does not show."""
    if distortion == 0.0:
        return across, above
    aim = np.hypot(across, above)
    # Beyond this radius a negative distortion would show things twice.
    farthest = np.inf if distortion > 0.0 else 1.0 / np.sqrt(-3.0 * distortion)
    r = np.minimum(aim, 0.9 * min(farthest, 1.0))
    for _ in range(_NEWTON_STEPS):
        r = r - (r + distortion * r**3 - aim) / (1.0 + 3.0 * distortion * r**2)
        r = np.minimum(r, (1.0 - _MET) * farthest)
    met = np.abs(r + distortion * r**3 - aim) < _MET
    shrink = np.where(met, 1.0 / (1.0 + distortion * r**2), np.nan)
    return across * shrink, above * shrink
