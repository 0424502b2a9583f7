"""Elevation models, repaired and in metres.

A model is warped if its own map cannot be the frame.
"""

import logging
import math
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from skyline.angles import wrapped_deg
from skyline.arrays import Float32Array
from skyline.errors import InputError
from skyline.geodesy.bounds import degrees_in_words
from skyline.geodesy.crs import (
    is_metric,
    is_of_earth,
    is_unplaced,
    is_upright,
    off_area_deg,
    to_wgs84,
)
from skyline.geodesy.map_frame import Frame
from skyline.terrain.datums import UNNAMED
from skyline.terrain.grid import Grid
from skyline.terrain.lazy_heights import Blocks, LazyHeights
from skyline.terrain.provenance import DemOptions, Provenance
from skyline.terrain.repair import ABSURD_M, RepairRules, repair
from skyline.terrain.resampling import Warp, ground_spacing_m, square_spacing_m

if TYPE_CHECKING:
    from skyline.terrain.mosaic import Mosaic

FINEST_M = 0.01
"""Least spacing of samples. The finest models, of photos by drones, have a few centimetres; a grid
in degrees that is read as metres has less (a second of arc is 0.0003 degrees)."""

FAR_DEG = 10.0
"""A DEM farther than this from the area of its projected CRS has the coordinates of another CRS."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class WarpSource:
    """Repaired samples on their files' grid, and a metric grid's warp."""

    heights_m: Float32Array
    """(rows, cols) float32; NaN marks a hole."""
    warp: Warp

    @cached_property
    def bounds_m(self) -> Float32Array:
        """Bounds (2, R, C) of the heights in each metric block."""
        return self.warp.bounds_m(self.heights_m)

    def block(self, rows: slice, cols: slice) -> Float32Array:
        """Return a block of the metric grid."""
        return self.warp.block(self.heights_m, rows, cols)

    def in_memory(self) -> LazyHeights:
        """Return the metric heights, whose blocks are kept in memory."""
        target = self.warp.target
        return LazyHeights(Blocks.in_memory((target.rows, target.cols)), self.block, self.bounds_m)


@dataclass(frozen=True, slots=True, eq=False)
class MetricDem:
    """Samples on a metric grid, from which a height field is made."""

    heights_m: Float32Array | LazyHeights
    """(rows, cols) float32; NaN marks a hole."""
    grid: Grid
    frame: Frame
    provenance: Provenance
    source: WarpSource | None = None
    """The source of lazy heights; None where the heights need no warp."""


def metric_dem(mosaic: "Mosaic", options: DemOptions) -> MetricDem:
    """Repair a DEM's heights, and warp them if they need it.

    Heights are repaired on their files' own grid, and warped if its map cannot be the frame. Warns
    if a projected map is not used. Raises `InputError` if the DEM's middle is no place on its world
    or lies far off the area of its projected CRS, if its datum is not known, and as `repair` and
    `skyline.terrain.resampling.Warp`.
    """
    crs = mosaic.crs
    grid = mosaic.grid
    heights_m = mosaic.heights_m
    lon, lat, accuracy = _centre(mosaic)
    frame = _map_frame(mosaic)
    source = None
    rules = RepairRules() if is_of_earth(crs) else RepairRules(ground_m=(-ABSURD_M, ABSURD_M))
    is_unit_named = UNNAMED not in mosaic.conventions["height_unit"]
    if frame is not None:
        resampling = "none"
        _check_spacing(mosaic, max(grid.step_east, grid.step_north))
        counts = repair(
            heights_m,
            mosaic.source,
            max(grid.step_east, grid.step_north),
            rules,
            is_unit_named=is_unit_named,
        )
    else:
        frame = Frame.local(lon=float(wrapped_deg(lon)), lat=lat, world=crs)
        ground_spacing = ground_spacing_m(grid, crs, frame)
        _check_spacing(mosaic, max(ground_spacing))
        counts = repair(
            heights_m, mosaic.source, max(ground_spacing), rules, is_unit_named=is_unit_named
        )
        spacing_m = square_spacing_m(ground_spacing)
        resampling = (
            f"cubic, once, all summits kept, from {crs.name} ({ground_spacing[0]:.2f} x "
            f"{ground_spacing[1]:.2f} m at the centre) to {spacing_m:g} m in the local conformal "
            "frame"
        )
        source = WarpSource(heights_m, Warp(grid, crs, frame, spacing_m))
    provenance = Provenance(
        files=mosaic.files,
        resampling=resampling,
        **counts._asdict(),
        options=asdict(options),
        conventions={**mosaic.conventions, "to_wgs84": accuracy},
    )
    if source is None:
        return MetricDem(heights_m, grid, frame, provenance)
    return MetricDem(source.in_memory(), source.warp.target, frame, provenance, source)


def _check_spacing(mosaic: "Mosaic", spacing_m: float) -> None:
    """Raise `InputError` at a pole, and where the map has another unit."""
    if not math.isfinite(spacing_m):
        raise InputError(
            f"{mosaic.source} has a pole in its middle, where a degree of longitude has no length; "
            "warp it to a polar map (gdalwarp -t_srs EPSG:3413, in the south EPSG:3031)"
        )
    if spacing_m < FINEST_M:
        raise InputError(
            f"{mosaic.source} has samples {1000.0 * spacing_m:.2g} mm apart in {mosaic.crs.name}; "
            "its coordinates are of another unit, such as degrees: name the CRS that they are of "
            "(--crs for files that name none, else gdal_edit.py -a_srs)"
        )


def _centre(mosaic: "Mosaic") -> tuple[float, float, str]:
    """Return a DEM's middle in degrees, and its accuracy in words.

    Raises `InputError` if the middle is not a place on its world, if the datum is not known, or if
    the middle lies far off the area of a projected CRS. Degrees of a regional datum are places
    everywhere.
    """
    crs = mosaic.crs
    x, y = mosaic.grid.centre
    lon, lat, accuracy = to_wgs84(crs, x, y)
    if not (abs(lat) <= 90.0 and abs(lon) <= 540.0):
        raise InputError(
            f"{mosaic.source} has its middle at {x:.9g}, {y:.9g}, which is not a place in "
            f"{crs.name}; check its georeference and its coordinate reference system"
        )
    if is_unplaced(crs, accuracy):
        raise InputError(
            f"{mosaic.source} is in {crs.name}, and PROJ does not know how its datum lies to WGS "
            "84: its places would be some 100 m off; name the CRS by its code (gdal_edit.py -a_srs "
            "EPSG:..., --crs for files that name none), or give the datum's shift by +towgs84"
        )
    if crs.is_projected and off_area_deg(crs, lon, lat) > FAR_DEG:
        raise InputError(
            f"{mosaic.source} has its middle at {degrees_in_words(lat, 'NS', 2)}, "
            f"{degrees_in_words(lon, 'EW', 2)}, far off the area for which {crs.name} is made; "
            "correct its coordinate reference system (gdal_edit.py -a_srs), or the signs and the "
            "order of its coordinates, or, if it lies there, warp it (gdalwarp -t_srs EPSG:4326)"
        )
    return lon, lat, accuracy


def _map_frame(mosaic: "Mosaic") -> Frame | None:
    """Return the frame of a DEM's map; None if it needs warping.

    A warning says why, unless the map is in degrees or in feet.
    """
    crs = mosaic.crs
    if not crs.is_projected:
        return None
    if not is_upright(crs):
        why = f"the axes of {crs.name} point {' and '.join(a.direction for a in crs.axis_info)}"
    elif not is_metric(crs):
        return None
    else:
        frame = Frame.from_crs(crs)
        wrong = frame.untrue_in_words(mosaic.grid.box)
        if not wrong:
            return frame
        why = f"{wrong} in this DEM"
    _log.warning("%s: %s; the DEM is warped to the local conformal frame", mosaic.source, why)
    return None
