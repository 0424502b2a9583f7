"""Height fields: metric grids of heights, which all renderers share.

Each cell between four samples is two triangles, split along the diagonal that joins its north-west
and south-east samples. A triangle with a hole (NaN) among its samples is not part of the surface.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import (
    BoolArray,
    Float64Array,
    FloatArray,
    Int64Array,
    by_dimensions,
    refuse_text,
)
from skyline.errors import InputError, some_of
from skyline.geodesy.bounds import Bounds
from skyline.geodesy.map_frame import Frame
from skyline.notebooks import facts_html
from skyline.terrain.grid import Grid
from skyline.terrain.lazy_heights import LazyHeights
from skyline.terrain.metric_dem import FINEST_M, MetricDem
from skyline.terrain.provenance import Provenance

Ground = Callable[[Float64Array, Float64Array], Float64Array]
"""Returns the heights in metres at eastings and northings, NaN off the map and on holes."""


@dataclass(frozen=True, eq=False)
class HeightField:
    """A metric grid of terrain heights.

    Attributes
    ----------
    heights_m : (rows, cols) float32 or float64, read-only
        Metres above the DEM's datum at the samples; row 0 is the northernmost, column 0 the
        westernmost; NaN marks a hole. Masked samples of a given array become holes.
    west_m : float
        Easting of the samples of column 0 (pixel centres).
    north_m : float
        Northing of the samples of row 0 (pixel centres).
    spacing_east_m : float
        Distance between neighbouring samples of a row.
    spacing_north_m : float
        Distance between neighbouring samples of a column.
    frame : Frame
        The map frame, whose angles are true here (`skyline.geodesy.map_frame.Frame.untrue_deg`).
    provenance : Provenance
        The files, and the treatment of their samples.
    """

    heights_m: FloatArray
    west_m: float
    north_m: float
    spacing_east_m: float
    spacing_north_m: float
    frame: Frame
    provenance: Provenance = field(default_factory=Provenance)

    def __post_init__(self) -> None:
        names = "west_m", "north_m", "spacing_east_m", "spacing_north_m"
        refuse_text(**{name: getattr(self, name) for name in names})
        if isinstance(self.heights_m, LazyHeights):
            # `__getattr__` makes the attribute when someone wants all heights.
            object.__setattr__(self, "_lazy", self.__dict__.pop("heights_m"))
        else:
            self._take_heights()
        if wrong := self.frame.untrue_in_words(self.bounds_m):
            raise InputError(f"{wrong} in this DEM; read it with read_dem, which warps it")

    def _take_heights(self) -> None:
        """Check the array of heights, and make it the field's own."""
        heights = np.asanyarray(self.heights_m)
        if heights.ndim != 2 or heights.size == 0:
            raise InputError(
                f"heights have shape {heights.shape}; expected a non-empty (rows, cols) grid"
            )
        if heights.dtype.kind not in "fiub":
            raise InputError(f"heights are {heights.dtype} numbers; expected real ones, in metres")
        if heights.dtype not in (np.float32, np.float64):
            heights = heights.astype(np.float32)
        heights = np.ma.filled(heights, np.nan)
        if np.isinf([np.fmin.reduce(heights, axis=None), np.fmax.reduce(heights, axis=None)]).any():
            raise InputError("heights hold infinite values; mark holes with NaN")
        spacing = self.spacing_east_m, self.spacing_north_m
        if not all(FINEST_M <= one < np.inf for one in spacing):
            raise InputError(
                f"sample spacing is {spacing[0]} x {spacing[1]} m; expected a centimetre or more. "
                "A grid in degrees needs a CRS in degrees, such as EPSG:4326, and is read by "
                "read_dem: make a DataArray of it"
            )
        if not np.isfinite([self.west_m, self.north_m]).all():
            raise InputError(
                f"the first sample is at {self.west_m}, {self.north_m}; expected easting and "
                "northing in metres"
            )
        # A private copy, so that the digest stays true. A frozen array is taken over as it is: a
        # large DEM must not need twice its memory.
        if heights.flags.writeable or not (heights.flags.owndata and heights.flags.c_contiguous):
            heights = np.array(heights, order="C")
            heights.setflags(write=False)
        object.__setattr__(self, "heights_m", heights)

    def __getattr__(self, name: str) -> Any:
        """Return all heights if they are lazy."""
        lazy = self.__dict__.get("_lazy")
        if name != "heights_m" or lazy is None:
            raise AttributeError(f"{type(self).__name__} has no attribute {name}")
        object.__setattr__(self, "heights_m", lazy.whole())
        return self.heights_m

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: all heights, wherever they are kept."""
        state = {name: value for name, value in self.__dict__.items() if name != "_lazy"}
        return state | {"heights_m": self.heights_m}

    def __repr__(self) -> str:
        samples, spacing, *others = self._facts().values()
        files = [Path(file).name for file in self.provenance.files]
        others += [some_of(files, 1)] if files else []
        return f"HeightField({', '.join([f'{samples} samples', f'{spacing} apart', *others])})"

    def _repr_html_(self) -> str:
        facts = self._facts() | {"W, S, E, N": ", ".join(f"{v:.4f}" for v in self.box_deg)}
        with suppress(InputError):
            facts["heights"] = "{:.0f} to {:.0f} m".format(*self.height_range_m)
        if self.provenance.files:
            facts["files"] = ", ".join(self.provenance.files)
        return facts_html(facts)

    def _facts(self) -> dict[str, str]:
        return {
            "samples": f"{self.cols} x {self.rows}",
            "spacing": f"{self.spacing_east_m:g} x {self.spacing_north_m:g} m",
            "frame": self.frame.name,
        }

    @property
    def _lazy_heights(self) -> LazyHeights | None:
        lazy: LazyHeights | None = self.__dict__.get("_lazy")
        return lazy

    @property
    def rows(self) -> int:
        """Number of samples from north to south."""
        return int((self._lazy_heights or self.heights_m).shape[0])

    @property
    def cols(self) -> int:
        """Number of samples from west to east."""
        return int((self._lazy_heights or self.heights_m).shape[1])

    @property
    def _grid(self) -> Grid:
        spacing_m = self.spacing_east_m, self.spacing_north_m
        return Grid(self.west_m, self.north_m, *spacing_m, self.rows, self.cols)

    def part(self, rows: slice, cols: slice) -> FloatArray:
        """Return a part of the heights.

        Heights that are made when they are needed are made for this part only.
        """
        lazy = self._lazy_heights
        within = slice(*rows.indices(self.rows)[:2]), slice(*cols.indices(self.cols)[:2])
        return self.heights_m[within] if lazy is None else lazy.part(*within)

    def samples_at(self, row: Int64Array, col: Int64Array) -> FloatArray:
        """Return the heights at rows and columns, which broadcast.

        Heights that are made when they are needed are made around these only.
        """
        lazy = self._lazy_heights
        return self.heights_m[row, col] if lazy is None else lazy.at(row, col)

    def highest_m(self, rows: slice, cols: slice) -> float:
        """Return a bound above the heights of a part.

        It is -inf where there is no height.
        """
        lazy = self._lazy_heights
        if lazy is not None:
            return lazy.highest_m(rows, cols)
        return float(np.fmax.reduce(self.heights_m[rows, cols], axis=None, initial=-np.inf))

    @property
    def height_sd_m(self) -> float:
        """Standard deviation of the heights' errors, estimated from the spacing.

        It is 1.2 m times the root of the spacing in metres. Heights differed from finer models by
        6.1 m at 20 m (Davos) and by 9.4 m at 70 m (California).
        """
        return 1.2 * math.sqrt(self.spacing_m)

    @property
    def spacing_m(self) -> float:
        """The finer of the two sample spacings."""
        return min(self.spacing_east_m, self.spacing_north_m)

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """West, south, east, north of the outermost samples, metres."""
        return self._grid.box

    @property
    def box_deg(self) -> Bounds:
        """West, south, east, north in degrees; W > E across the antimeridian."""
        west, south, east, north = self.bounds_m
        return self.frame.box_deg(easting_m=[west, east], northing_m=[south, north])

    def reach_m(self, *, easting_m: float, northing_m: float) -> float:
        """Return the distance from a position to the farthest corner, metres."""
        west, south, east, north = self.bounds_m
        return math.hypot(
            max(easting_m - west, east - easting_m), max(northing_m - south, north - northing_m)
        )

    @cached_property
    def has_holes(self) -> bool:
        """Whether any sample is a hole."""
        return bool(np.isnan(self.heights_m.min()))

    @cached_property
    def height_range_m(self) -> tuple[float, float]:
        """Lowest and highest sample; raises `InputError` without any."""
        lazy = self._lazy_heights
        if lazy is not None:
            lowest, highest = lazy.range_m()
        else:
            lowest = float(np.fmin.reduce(self.heights_m, axis=None, initial=np.inf))
            highest = float(np.fmax.reduce(self.heights_m, axis=None, initial=-np.inf))
        if lowest > highest:
            raise InputError("the DEM holds no heights at all: every sample is a hole")
        return lowest, highest

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the samples, their grid and their frame, hexadecimal."""
        lazy = self._lazy_heights
        if lazy is None:
            return self._digest()
        if lazy.digest:
            return lazy.digest
        digest = self._digest()
        lazy.note_digest(digest)
        return digest

    def _digest(self) -> str:
        sha = hashlib.sha256(self.frame.wkt.encode())
        grid = (self.west_m, self.north_m, self.spacing_east_m, self.spacing_north_m)
        sha.update(np.array(grid, dtype="<f8").tobytes())
        heights_m = self.heights_m
        sha.update(np.array(heights_m.shape, dtype="<i8").tobytes())
        sha.update(str(heights_m.dtype).encode())
        sha.update(heights_m.data)
        return sha.hexdigest()

    def to_grid(
        self, *, easting_m: ArrayLike, northing_m: ArrayLike
    ) -> tuple[Float64Array, Float64Array]:
        """Return fractional (row, column) of map coordinates; samples are at whole numbers."""
        refuse_text(easting_m=easting_m, northing_m=northing_m)
        return self._grid.index(*by_dimensions(easting_m, northing_m))

    def to_map(self, row: ArrayLike, col: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Return easting and northing in metres of fractional rows and columns."""
        refuse_text(row=row, col=col)
        return self._grid.at(row, col)

    def height_at(
        self,
        *,
        easting_m: ArrayLike | None = None,
        northing_m: ArrayLike | None = None,
        lon: ArrayLike | None = None,
        lat: ArrayLike | None = None,
    ) -> Float64Array:
        """Return the surface's height; NaN off the map and over holes.

        Parameters
        ----------
        easting_m, northing_m : array_like, metres in `frame`, broadcast together
        lon, lat : array_like, degrees (WGS 84), broadcast together
            Instead of ``easting_m`` and ``northing_m``.

        Returns
        -------
        float64 array of the broadcast shape, metres above the datum

        Raises
        ------
        InputError
            Both pairs of coordinates are given, or only half of one.
        """
        if lon is not None and lat is not None and easting_m is None and northing_m is None:
            easting_m, northing_m = self.frame.from_lonlat(
                *np.broadcast_arrays(*by_dimensions(lon, lat))
            )
        elif easting_m is None or northing_m is None or not (lon is None and lat is None):
            given = {"easting_m": easting_m, "northing_m": northing_m, "lon": lon, "lat": lat}
            names = [name for name, value in given.items() if value is not None]
            raise InputError(
                f"a place is given by {', '.join(names) or 'nothing'}; expected easting_m and "
                "northing_m (metres of the frame), or lon and lat (degrees, WGS 84)"
            )
        row, col = np.broadcast_arrays(*self.to_grid(easting_m=easting_m, northing_m=northing_m))
        inside, corners, south, east = self.triangles(row, col)
        weights = [1.0 - np.maximum(east, south), np.abs(east - south), np.minimum(east, south)]
        # A corner of no weight may be a hole.
        first, third, last = (
            np.where(weight > 0.0, weight * corner, 0.0)
            for weight, corner in zip(weights, corners, strict=True)
        )
        return np.where(inside, first + third + last, np.nan)

    def triangles(
        self, row: Float64Array, col: Float64Array
    ) -> tuple[BoolArray, tuple[Float64Array, ...], Float64Array, Float64Array]:
        """Return the triangles at fractional rows and columns.

        The result has four parts: a mask of the positions on the map; the heights at each
        triangle's north-west corner, at the corner beside the diagonal, and at the south-east
        corner; and each position's distance south, then east, of the north-west corner, in samples.
        """
        inside = (row >= 0.0) & (row <= self.rows - 1) & (col >= 0.0) & (col <= self.cols - 1)
        row = np.where(inside, row, 0.0)
        col = np.where(inside, col, 0.0)
        top = np.minimum(row.astype(np.int64), max(self.rows - 2, 0))
        left = np.minimum(col.astype(np.int64), max(self.cols - 2, 0))
        bottom = np.minimum(top + 1, self.rows - 1)
        right = np.minimum(left + 1, self.cols - 1)
        south = row - top
        east = col - left
        is_north_east = east >= south
        beside = np.where(is_north_east, top, bottom), np.where(is_north_east, right, left)
        corners = tuple(
            self.samples_at(*at).astype(np.float64) for at in ((top, left), beside, (bottom, right))
        )
        return inside, corners, south, east


def field_of(dem: MetricDem) -> HeightField:
    """Return the height field of metric samples, which are not copied."""
    if not isinstance(dem.heights_m, LazyHeights):
        dem.heights_m.setflags(write=False)
    return HeightField(
        heights_m=cast("FloatArray", dem.heights_m),
        west_m=dem.grid.west,
        north_m=dem.grid.north,
        spacing_east_m=dem.grid.step_east,
        spacing_north_m=dem.grid.step_north,
        frame=dem.frame,
        provenance=dem.provenance,
    )


def dem_of(field: HeightField) -> MetricDem:
    """Return a height field's metric samples; the inverse of `field_of`."""
    return MetricDem(field.heights_m, field._grid, field.frame, field.provenance)


def heights_along(
    field: HeightField,
    easting_m: float,
    northing_m: float,
    azimuth_rad: Float64Array,
    distance_m: Float64Array,
) -> Float64Array:
    """Return the surface's heights (K, D) along level rays from a position.

    The rays have grid azimuths (K,); the distances are (D,) or (K, D), metres. NaN as in
    `HeightField.height_at`.
    """
    across = azimuth_rad[:, np.newaxis]
    return field.height_at(
        easting_m=easting_m + distance_m * np.sin(across),
        northing_m=northing_m + distance_m * np.cos(across),
    )


def ground_of(field: HeightField) -> Ground:
    """Return a field's heights as a `Ground`."""
    return lambda easting, northing: field.height_at(easting_m=easting, northing_m=northing)


def ground_slope(ground: Ground, easting_m: Float64Array, northing_m: Float64Array) -> Float64Array:
    """Return the ground's rise (M, 2) per metre eastwards and northwards.

    It is the mean over 15 m on either side, and 0 beside unknown ground.
    """
    reach_m = 15.0
    position = easting_m + 1j * northing_m
    around = np.concatenate([position + reach_m * turn for turn in (1.0, -1.0, 1.0j, -1.0j)])
    east, west, north, south = ground(around.real, around.imag).reshape(4, -1)
    return np.nan_to_num(np.stack([east - west, north - south], axis=1) / (2.0 * reach_m))
