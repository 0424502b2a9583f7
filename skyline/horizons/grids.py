"""Horizons and sky view factors at a DEM's samples, as DataArrays.

Azimuths are degrees from true north.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from skyline.arrays import BoolArray, Float32Array, Float64Array, IntArray, refuse_text
from skyline.errors import InputError, library
from skyline.files.cf import DEGREES, METRES, TRUE_NORTH
from skyline.geodesy.crs import lonlat_of, transformer
from skyline.geodesy.earth import Curvature
from skyline.horizons.horizon import rendered_steps, steps_a_turn
from skyline.horizons.local_horizons import azimuths_deg
from skyline.progress import Progress
from skyline.render.horizon import PanoramaRenderer
from skyline.sky.view_factor import sky_view_factor
from skyline.terrain.dem import Dem, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

if TYPE_CHECKING:
    from xarray import DataArray

GRID_STEP_DEG = 5.0
"""Step between azimuths that suffices for a sky view factor; `skyline-bench sky-view` measures the
errors of this and other steps."""
GRID_EYE_HEIGHT_M = 0.1
"""Height above ground: an eye on the ground that rounding does not put below it."""
_AT_ONCE = 4096
"""About as many eyes are rendered between two reports of progress."""

_Look = Callable[["_Eyes", IntArray, IntArray], Float32Array]
"""Returns what eyes of some rows and columns see, the samples' dimensions last."""


def sky_view_grid(
    dem: Dem,
    *,
    step_deg: float = GRID_STEP_DEG,
    eye_height_m: float = GRID_EYE_HEIGHT_M,
    curvature: Curvature | None = None,
    progress: Progress | None = None,
) -> DataArray:
    """Return the sky view factor at every sample of a DEM.

    It is the factor of a level surface, as `LocalHorizons.sky_view_factor` gives it for the same
    horizon.

    Parameters
    ----------
    dem : path, paths, DataArray or HeightField
        A DataArray gives a result on its own grid. If it is in Dask chunks, so is the result, and
        its chunks are computed when they are needed; the whole DEM is in memory, since a horizon
        may lie anywhere in it. Everything else gives a result on the grid of the height field that
        `read_dem` makes of it.
    step_deg : float
        Step between azimuths.
    eye_height_m : float
        Metres above ground.
    curvature : Curvature, optional
        Defaults to `Frame.curvature`: the Earth's with k = 0.13, or another world's.
    progress : callable, optional
        Called with the number of samples that are done, and of all; not for a DataArray in chunks,
        whose progress `dask.diagnostics.ProgressBar` shows.

    Returns
    -------
    xarray.DataArray
        (y, x) float32, 0 to 1; NaN where the DEM has no height, and at its outermost samples, whose
        horizon is known on one side only.

    Raises
    ------
    InputError
        Xarray is not installed, the step does not divide a full turn, the eye is below the ground,
        or as `read_dem`.
    ContextError
        No OpenGL context can be created.
    """
    eyes = _Eyes.of(dem, step_deg, eye_height_m, curvature)
    about = {"long_name": "sky view factor of a level surface", "units": "1"}
    return eyes.grid.labelled("sky_view_factor", _seen(eyes, _factors, (), progress), about)


def horizon_grid(
    dem: Dem,
    *,
    step_deg: float = GRID_STEP_DEG,
    eye_height_m: float = GRID_EYE_HEIGHT_M,
    curvature: Curvature | None = None,
    progress: Progress | None = None,
) -> DataArray:
    """Return the horizon at every sample of a DEM.

    Parameters and errors are as for `sky_view_grid`.

    Returns
    -------
    xarray.DataArray
        (azimuth_deg, y, x) float32: elevation angles of the horizon, degrees, by azimuth from true
        north; NaN where the DEM has no height or an azimuth meets no data. The horizons of 1000 x
        1000 samples take 290 MB at a step of 5 degrees.
    """
    eyes = _Eyes.of(dem, step_deg, eye_height_m, curvature)
    about = {"long_name": "elevation angle of the horizon", **DEGREES}
    data = _seen(eyes, _elevations, (eyes.steps,), progress)
    first = {"azimuth_deg": ("azimuth_deg", eyes.azimuth_deg, TRUE_NORTH)}
    return eyes.grid.labelled("elevation_deg", data, about, first)


def _seen(
    eyes: _Eyes, look: _Look, first: tuple[int, ...], progress: Progress | None
) -> Float32Array | Any:
    """Look from all samples block by block; return (*first, rows, columns)."""
    rows, cols = eyes.grid.shape
    if eyes.grid.chunks is not None:
        return _lazily_seen(eyes, look, first)
    seen = np.empty((*first, rows, cols), dtype=np.float32)
    every = np.arange(cols)
    step = max(_AT_ONCE // cols, 1)
    for start in range(0, rows, step):
        some = np.arange(start, min(start + step, rows))
        seen[..., some, :] = look(eyes, some, every)
        if progress is not None:
            progress((int(some[-1]) + 1) * cols, rows * cols)
    eyes.close()
    return seen


def _lazily_seen(eyes: _Eyes, look: _Look, first: tuple[int, ...]) -> Any:
    """Look from all samples when Dask computes; return its array."""
    dask = library("dask.array", "a DataArray in chunks", "'dask[array]'")
    down, across = eyes.grid.chunks or ((), ())
    rows = dask.arange(eyes.grid.shape[0], chunks=(down,))[:, np.newaxis]
    cols = dask.arange(eyes.grid.shape[1], chunks=(across,))[np.newaxis]
    options = {"new_axis": 0, "chunks": (first, down, across)} if first else {}
    return dask.map_blocks(
        _block, rows, cols, eyes=eyes, look=look, dtype=np.float32, meta=np.empty((), np.float32),
        **options,
    )  # fmt: skip


def _block(rows: IntArray, cols: IntArray, eyes: _Eyes, look: _Look) -> Float32Array:
    return look(eyes, rows.ravel(), cols.ravel())


def _elevations(eyes: _Eyes, rows: IntArray, cols: IntArray) -> Float32Array:
    """Return the horizons (A, rows, columns) of some samples, degrees."""
    elevation_deg, stands = eyes.look(rows, cols)
    seen = np.full((eyes.steps, *stands.shape), np.nan, dtype=np.float32)
    seen[:, stands] = elevation_deg.T
    return seen


def _factors(eyes: _Eyes, rows: IntArray, cols: IntArray) -> Float32Array:
    """Return the sky view factors (rows, columns) of some samples."""
    elevation_deg, stands = eyes.look(rows, cols)
    seen = np.full(stands.shape, np.nan, dtype=np.float32)
    seen[stands] = sky_view_factor(eyes.azimuth_deg, elevation_deg)
    return seen


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """The samples of a DEM as given, and DataArrays on them."""

    field: HeightField
    x: Float64Array
    """(columns,)"""
    y: Float64Array
    """(rows,)"""
    crs: CRS | None
    """Of x and y; None where they are samples of the field."""
    dims: tuple[str, str]
    coords: dict[str, Any]
    attrs: dict[str, Any]
    chunks: tuple[tuple[int, ...], tuple[int, ...]] | None = None
    """Dask's chunks; None where all is in memory."""

    @classmethod
    def of(cls, dem: Any) -> _Grid:
        """Return the grid of an array, or of any other DEM's field."""
        xarray = library("xarray", "a DataArray")
        field = read_dem(dem)
        if isinstance(dem, xarray.DataArray):
            return cls._of_array(dem, field)
        x_m, _ = field.to_map(0.0, np.arange(field.cols))
        _, y_m = field.to_map(np.arange(field.rows), 0.0)
        coords = {
            "y": ("y", y_m, {"standard_name": "projection_y_coordinate", **METRES}),
            "x": ("x", x_m, {"standard_name": "projection_x_coordinate", **METRES}),
            "spatial_ref": ((), 0, field.frame.crs.to_cf()),
        }
        return cls(field, x_m, y_m, None, ("y", "x"), coords, {"grid_mapping": "spatial_ref"})

    @classmethod
    def _of_array(cls, array: DataArray, field: HeightField) -> _Grid:
        from skyline.terrain.raster_tiles import array_tile, dims_of  # noqa: PLC0415  (slow)

        y, x = dims_of("the DataArray", array)
        crs = None if field.provenance.resampling == "none" else array_tile(array, None).crs
        coords = {name: one for name, one in array.coords.items() if {*one.dims} <= {y, x}}
        mapping = array.encoding.get("grid_mapping", array.attrs.get("grid_mapping"))
        chunks = None
        if array.chunks is not None:
            chunks = array.chunks[array.dims.index(y)], array.chunks[array.dims.index(x)]
        return cls(
            field,
            np.asarray(array[x].values, dtype=np.float64),
            np.asarray(array[y].values, dtype=np.float64),
            crs,
            (y, x),
            {str(name): one for name, one in coords.items()},
            {} if mapping is None else {"grid_mapping": mapping},
            chunks,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns."""
        return len(self.y), len(self.x)

    def position_m(self, rows: IntArray, cols: IntArray) -> tuple[Float64Array, Float64Array]:
        """Return samples' easting and northing (rows * columns,) in the field's frame."""
        y, x = (one.ravel() for one in np.meshgrid(self.y[rows], self.x[cols], indexing="ij"))
        if self.crs is None:
            # Rounding must not put the outermost samples off the map.
            return self.field.to_map(*map(np.rint, self.field.to_grid(easting_m=x, northing_m=y)))
        to_lonlat = transformer(self.crs, lonlat_of(self.crs))
        return self.field.frame.from_lonlat(*to_lonlat.transform(x, y))

    def labelled(
        self, name: str, data: Any, about: dict[str, str], first: dict[str, Any] | None = None
    ) -> DataArray:
        """Return data as an array with the grid's coordinates, ``first`` before them."""
        first = first or {}
        array: DataArray = library("xarray", "a DataArray").DataArray(
            data, {**first, **self.coords}, (*first, *self.dims), name, {**about, **self.attrs}
        )
        return array


class _Eyes:
    """Eyes on a grid's samples, and the renderer of their horizons.

    Any thread may look. Workers of Dask get a copy without the renderer, and make their own.
    """

    def __init__(
        self, grid: _Grid, steps: int, eye_height_m: float, curvature: Curvature | None
    ) -> None:
        self.grid = grid
        self.steps = steps
        self.azimuth_deg = azimuths_deg(steps)
        self._eye_height_m = eye_height_m
        self._curvature = curvature
        self._renderer: PanoramaRenderer | None = None
        self._making = Lock()

    @classmethod
    def of(
        cls, dem: Dem, step_deg: float, eye_height_m: float, curvature: Curvature | None
    ) -> _Eyes:
        """Return eyes on a DEM's samples; raises as `sky_view_grid`."""
        steps = steps_a_turn(step_deg)
        refuse_text(eye_height_m=eye_height_m)
        if not 0.0 <= eye_height_m < math.inf:
            raise InputError(f"the eye is {eye_height_m:g} m above ground; expected 0 or more")
        return cls(_Grid.of(dem), steps, eye_height_m, curvature)

    def look(self, rows: IntArray, cols: IntArray) -> tuple[Float32Array, BoolArray]:
        """Return horizons (N, A) in degrees, and where the eyes stand.

        The second result marks (rows, columns) with the N eyes.
        """
        field = self.grid.field
        easting_m, northing_m = self.grid.position_m(rows, cols)
        ground_m = field.height_at(easting_m=easting_m, northing_m=northing_m)
        stands = np.isfinite(ground_m)
        eyes = Viewpoints(
            easting_m=easting_m,
            northing_m=northing_m,
            eye_elevation_m=ground_m + self._eye_height_m,
        )[stands]
        with self._making:
            if self._renderer is None:
                self._renderer = PanoramaRenderer(
                    field, rendered_steps(self.steps), self._curvature
                )
        seen = self._renderer.render_from_north(eyes, self.steps)
        return seen.elevation_deg(), stands.reshape(len(rows), len(cols))

    def close(self) -> None:
        """Free the renderer's memory."""
        if self._renderer is not None:
            self._renderer.close()

    def __getstate__(self) -> tuple[Any, ...]:
        return self.grid, self.steps, self._eye_height_m, self._curvature

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.__init__(*state)  # type: ignore[misc]  # A copy is made like the original.
