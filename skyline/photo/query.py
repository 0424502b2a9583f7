"""The query skyline of a photo: extracted, drawn as a trace, or the border of a mask."""

from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import BoolArray, Float64Array
from skyline.errors import InputError
from skyline.photo.exif import NOTHING_NOTED, NotedPlace
from skyline.photo.lens import Lens
from skyline.photo.projection import MIN_FOV_DEG, Projection, undistorted

_SAME_ROWS = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class QuerySkyline:
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
    crests : (2, 3, W) float64, optional
        Rows (0) and probabilities (1) of up to three crests a column, the likeliest first, NaN
        where there are fewer; their sum falls short of 1 by the probability of no skyline. None if
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
            shapes["crests"] = (2, 3, self.width_px)
        for name, shape in shapes.items():
            values = np.array(getattr(self, name), dtype=np.float64)
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
        if self.fov_deg is not None:
            object.__setattr__(self, "fov_deg", self.projection.check_fov_deg(self.fov_deg))
        if np.any((self.confidence > 0.0) & ~self.trusted):
            raise InputError("confidence is above 0 where row_px is NaN; expected 0 there")

    def __repr__(self) -> str:
        lens = "unknown" if self.fov_deg is None else f"{self.fov_deg:.1f} degrees"
        return (
            f"QuerySkyline({self.width_px} x {self.height_px} px; columns trusted: "
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
        rows = self.crests[0]
        other = np.isfinite(rows) & ~(np.abs(rows - self.row_px) < _SAME_ROWS * self.height_px)
        likeliest = rows[other.argmax(axis=0), np.arange(self.width_px)]
        return np.where(other.any(axis=0), likeliest, np.nan)

    def with_fov(self, fov_deg: float) -> "QuerySkyline":
        """Return the same skyline with another horizontal field of view, degrees."""
        return replace(self, fov_deg=fov_deg, lens=None)

    def image_plane(
        self, fov_deg: float | None = None, distortion: float = 0.0
    ) -> tuple[Float64Array, Float64Array]:
        """Return the trusted columns on an image of unit focal length.

        Parameters
        ----------
        fov_deg : float, optional
            Horizontal field of view, degrees; overrides the query's own.
        distortion : float
            Distortion of the lens; see `skyline.photo.projection.undistorted`.

        Returns
        -------
        u, v : (N,) float64
            To the right of and above the image's middle; square pixels. A perspective photo has
            rays (u, v, 1), u = ((2q + 1)/W - 1) tan(fov/2) and v = (H - 1 - 2r)/W tan(fov/2); for
            panoramas see `Projection.rays`.

        Raises
        ------
        InputError
            No field of view is known, or it has no rays; see `Projection.check_fov_deg`.
        """
        columns = np.flatnonzero(self.trusted)
        across = (2.0 * columns + 1.0) / self.width_px - 1.0
        above = (self.height_px - 1.0 - 2.0 * self.row_px[columns]) / self.width_px
        across, above = undistorted(across, above, distortion)
        return self.projection.rays(across, above, self._known_fov_deg(fov_deg))

    def visible_deg(self, fov_deg: float | None = None) -> float:
        """Return the degrees of azimuth that the trusted columns span together; see `image_plane`.

        Each trusted column counts the angle between its edges with the camera held level.
        """
        spans = self.projection.column_deg(self.width_px, self._known_fov_deg(fov_deg))
        return float(spans[self.trusted].sum())

    def _known_fov_deg(self, fov_deg: float | None) -> float:
        known = self.fov_deg if fov_deg is None else fov_deg
        if known is None:
            raise InputError(
                "the photo's field of view is not known; give its horizontal field of view, "
                f"from {MIN_FOV_DEG:g} degrees on (--fov-deg)"
            )
        return self.projection.check_fov_deg(known)


def check_of_image(query: QuerySkyline, shape: tuple[int, ...]) -> None:
    """Raise `InputError` unless a skyline belongs to an image of a shape (H, W, ...)."""
    height, width = shape[:2]
    if (width, height) != (query.width_px, query.height_px):
        raise InputError(
            f"the skyline is of an image of {query.width_px} x {query.height_px} px, the photo has "
            f"{width} x {height}; expected the same image"
        )
