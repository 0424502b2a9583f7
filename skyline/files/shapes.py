"""Points, lines and polygons in a photo or on a map."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from skyline.arrays import Float64Array
from skyline.camera.pixels import in_picture
from skyline.errors import InputError, printable
from skyline.files.disk import is_name_of

POINT, LINE, POLYGON = "Point", "LineString", "Polygon"
"""Kinds of shapes, by their GeoJSON names."""
EXPECTED = (
    "expected points, lines or polygons: GeoJSON, LabelMe, COCO or SVG of the photo, or GeoJSON, "
    "GPX or a GeoPackage of the map"
)
"""The files of vectors that are read, as errors name them."""
EXPECTED_ON_MAP = "expected points, lines or polygons of the map: GeoJSON, GPX or a GeoPackage"
"""The files of vectors on a map, as errors name them."""
CORNER_PX = 0.5
"""LabelMe, COCO, SVG and QGIS count pixels from the photo's corner; here pixel centres are at whole
numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A point, a line or a polygon."""

    kind: str
    """`POINT`, `LINE` or `POLYGON`."""
    rings: tuple[Float64Array, ...]
    """Vertices (V, 2): columns and rows, or longitudes and latitudes. A polygon's first ring is its
    outline, and the others are holes; they are not closed."""
    where: str
    """The feature, for messages."""
    properties: Mapping[str, Any] = field(default_factory=dict)

    @property
    def vertices(self) -> Float64Array:
        """All vertices (V, 2)."""
        return np.concatenate(self.rings)


@dataclass(frozen=True, slots=True, eq=False)
class Vectors:
    """The shapes of a file."""

    path: Path
    shapes: tuple[Shape, ...]
    in_pixels: bool
    """Whether they were drawn in a photo rather than on a map."""
    size_px: tuple[int, int] | None = None
    """Width and height of their photo, if the file says so."""
    photo: str = ""
    """Name of their photo, if the file says so."""
    of_qgis: bool = False
    """Whether they were drawn in QGIS, in a photo."""

    def check_photo(self, photo: Path, width_px: int, height_px: int) -> None:
        """Raise `InputError` if the vectors' photo has another name or size.

        Vertices that all lie within one pixel are refused as well: they are shares of the width and
        height.
        """
        if self.photo and not is_name_of(self.photo, photo):
            raise InputError(
                f"{self.path} is drawn in {printable(self.photo)}, not in {photo}; give the photo "
                "in which it was drawn, or correct the name in the file if it is the same photo"
            )
        if self.size_px is not None and self.size_px != (width_px, height_px):
            width, height = self.size_px
            raise InputError(
                f"{self.path} is drawn in a photo of {width} x {height} px, and {photo} has "
                f"{width_px} x {height_px}; give the photo in which it was drawn"
            )
        vertices = np.concatenate([shape.vertices for shape in self.shapes])
        if len(vertices) > 1 and np.abs(vertices).max() <= 1.0 < min(width_px, height_px):
            raise InputError(
                f"{self.path} has coordinates from 0 to 1 only; expected columns and rows of "
                f"{photo}, which has {width_px} x {height_px} px: multiply them by its width and "
                "height"
            )
        for shape in self.shapes:
            column, row = shape.vertices.T
            off = ~in_picture(column, row, width_px, height_px, margin_px=1.0)
            if off.any():
                first = int(off.argmax())
                raise InputError(
                    f"{self.path}, {shape.where}: column {column[first]:g}, row {row[first]:g} is "
                    f"outside {photo}, which has {width_px} x {height_px} px; give the photo in "
                    "which it was drawn"
                )


def ring_of(given: Sequence[Sequence[float]], kind: str = LINE) -> Float64Array:
    """Return vertices (V, 2), without the last if it closes a polygon."""
    ring = np.array([one[:2] for one in given], dtype=np.float64).reshape(-1, 2)
    if not np.isfinite(ring).all():
        raise ValueError("a coordinate is not a number")
    is_closed = kind == POLYGON and len(ring) > 1 and np.array_equal(ring[0], ring[-1])
    return ring[:-1] if is_closed else ring


def box_ring(left: float, top: float, right: float, bottom: float) -> Float64Array:
    """Return the corners (4, 2) of a rectangle."""
    return np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
