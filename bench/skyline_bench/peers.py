"""Peers to measure against: Embree's rays, and GRASS's r.horizon.

Embree's scene is the exact surface, so that all renderers share one physics. Curvature depends on
the eye and a ray tracer's scene does not, so the samples are dropped around the DEM's middle c
instead. That drop and the one around an eye e differ at p by a constant and 2 k (p - e).(e - c), k
being the drop per square metre: a shear. It keeps straight edges straight and moves the ordinate of
a column with ground direction g (metres over the ground per metre of depth) by 2 k g.(e - c) at any
depth. The rays are tilted by that much; nothing is approximated. Embree needs ``embreex``, the
optional extra ``peers``. One call to it runs on one thread and lets others run, so the viewpoints
are shared out among as many threads as there are cores.

r.horizon (`grass` on the path) takes one place at a time. It puts the eye on the ground of the
nearest sample, has no curvature in metric frames, counts its azimuths from true north and has no
angles below zero. So its map is the height field, and it is compared with skylines from that
sample, on a flat Earth, cut off at zero.
"""

import re
import shutil
import subprocess
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.errors import SkylineError
from skyline.geodesy.earth import Curvature
from skyline.skylines import FLAG_NO_DATA, HEADINGS, Views, columns_u
from skyline.terrain.heightfield import HeightField
from skyline.terrain.triangles import Triangles
from skyline.terrain.viewpoints import Viewpoints, in_four_views
from skyline_bench.geotiff import write_geotiff
from skyline_bench.measuring import core_count, over_cores
from skyline_bench.truth.oracle import directions_at

_SCRIPT = """set -e
r.in.gdal input={dem} output=dem --quiet
g.region raster=dem
for place in {places}; do
  r.horizon -dc elevation=dem step={step} coordinates=$place
  date +"took %s.%N"
done
"""


def has_embree() -> bool:
    """Return whether ``embreex`` can be imported."""
    return find_spec("embreex") is not None


def has_grass() -> bool:
    """Return whether ``grass`` can be run."""
    return shutil.which("grass") is not None


class EmbreePeer:
    """Skylines of one height field by Embree's rays.

    A view has ``width`` columns W.
    """

    def __init__(self, field: HeightField, width: int) -> None:
        self.field = field
        self.width = width
        self.curvature = Curvature()
        # On a sample, so that the samples' own offsets are short numbers in float32.
        easting, northing = field.to_map(field.rows // 2, field.cols // 2)
        self._middle_m = np.array([float(easting), float(northing)])
        self._datum_m = float(np.mean(field.height_range_m))
        # East, up, north of the middle, curved.
        easting, northing = field.to_map(*np.indices((field.rows, field.cols)))
        east = easting - self._middle_m[0]
        north = northing - self._middle_m[1]
        heights = np.nan_to_num(field.heights_m, nan=self._datum_m).astype(np.float64)
        up = heights - self._datum_m - self.curvature.drop_per_m2 * (east**2 + north**2)
        vertices = np.stack([east, up, north], axis=-1).astype(np.float32).reshape(-1, 3)
        self._scene = _scene(vertices, _triangles(field))
        self._directions = np.stack([directions_at(turn, columns_u(width)) for turn in HEADINGS])

    def render(self, viewpoints: Viewpoints, depth: int) -> Views:
        """Find the skylines of N viewpoints in all four headings.

        The skyline of a column is the middle of its last bracket, which is as wide as after
        ``depth`` bisections of the field of view.

        Of the 4 N views depth is NaN throughout, and `FLAG_NO_DATA` is the only flag.
        """
        share = max(-(-len(viewpoints) // core_count()), 1)
        # Of the paper's field of view, in which v is from -1 to 1.
        find = partial(self._skylines, bracket=2.0 / 2.0**depth)
        parts = over_cores(find, viewpoints, min(share, 8))
        tan = np.concatenate([np.zeros((0, self.width)), *parts])
        eyes, heading = in_four_views(viewpoints)
        place = eyes.easting_m, eyes.northing_m, eyes.eye_elevation_m
        flags = np.where(np.isnan(tan), FLAG_NO_DATA, 0).astype(np.uint8)
        return Views(*place, heading, tan, np.full_like(tan, np.nan), flags)

    def _skylines(self, viewpoints: Viewpoints, bracket: float) -> Float64Array:
        """Return the ordinates v (4 N, W) of a few viewpoints' views."""
        offset = np.stack([viewpoints.easting_m, viewpoints.northing_m], axis=1) - self._middle_m
        drop_m = self.curvature.drop_per_m2 * np.square(offset).sum(axis=1)
        up = viewpoints.eye_elevation_m - self._datum_m - drop_m
        eyes = np.stack([offset[:, 0], up, offset[:, 1]], axis=1).astype(np.float32)
        apart = np.einsum("hwk,nk->nhw", self._directions, offset)
        views = len(HEADINGS) * len(viewpoints)
        ground = self._directions.reshape(-1, 2).astype(np.float32)
        rays = _Rays(
            self._scene,
            np.repeat(eyes, len(HEADINGS) * self.width, axis=0),
            np.tile(ground, (len(viewpoints), 1)),
        )
        # The true ordinates less those in the scene.
        shear_tan = 2.0 * self.curvature.drop_per_m2 * apart.reshape(views, self.width)
        columns = np.arange(shear_tan.size).reshape(shear_tan.shape)
        return np.asarray(_from_neighbours(rays, columns, bracket) + shear_tan)


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Everything about M = views * W columns except the ordinate."""

    scene: Any
    eyes: Float32Array  # (M, 3); east, up, north of each column's eye in the scene
    ground: Float32Array  # (M, 2); each column's ground direction

    def blocked(self, columns: Int64Array, tan: Float64Array) -> BoolArray:
        """Return whether the terrain blocks a ray at ordinate ``tan``."""
        directions = np.empty((len(columns), 3), dtype=np.float32)
        directions[:, 0::2] = self.ground[columns]
        directions[:, 1] = tan
        hit = self.scene.run(self.eyes[columns], directions, query="OCCLUDED")
        return np.asarray(hit == 0)


def _from_neighbours(rays: _Rays, columns: Int64Array, bracket: float) -> Float64Array:
    """Return the skyline of columns (views, W).

    The skyline at every stride starts from the coarser stride's.
    """
    tan = np.full(columns.shape, np.nan)
    stride = 64
    first = slice(0, None, stride)
    start = np.zeros(columns[:, first].shape)
    tan[:, first] = _around(rays, columns[:, first], start, start + 0.25, bracket)
    while stride > 1:
        half = stride // 2
        between = columns[:, half::stride]
        left = tan[:, 0::stride][:, : between.shape[1]]
        right = tan[:, stride::stride]
        right = np.concatenate([right, left[:, right.shape[1] :]], axis=1)
        guess = np.nan_to_num((left + right) / 2.0)
        # Of shares of the neighbours' difference from 1/4 to 1/128, about the fastest for Embree.
        step = np.maximum(bracket, 1.0 / 64.0 * np.nan_to_num(np.abs(left - right)))
        tan[:, half::stride] = _around(rays, between, guess, step, bracket)
        stride = half
    return tan


def _around(
    rays: _Rays, columns: Int64Array, guess: Float64Array, step: Float64Array, bracket: float
) -> Float64Array:
    """Return the skyline of columns, searched around guesses in growing steps.

    It has the shape of the columns, and is NaN where no ray hits anything.
    """
    shape = columns.shape
    columns = columns.ravel()
    guess = guess.ravel()
    step = step.ravel()
    rising = rays.blocked(columns, guess)
    stride = np.where(rising, step, -step)
    near = guess.copy()
    far = np.full(len(guess), np.nan)
    looking = np.arange(len(columns))
    while looking.size:
        probe = near[looking] + stride[looking]
        passed = rays.blocked(columns[looking], probe) != rising[looking]
        far[looking[passed]] = probe[passed]
        looking = looking[~passed]
        probe = probe[~passed]
        near[looking] = probe
        stride[looking] *= 2.0
        looking = looking[np.abs(probe) < 1e4]  # Below such a dip are no data.
    tan = np.full(len(guess), np.nan)
    found = np.flatnonzero(~np.isnan(far))
    low = np.minimum(near[found], far[found])
    high = np.maximum(near[found], far[found])
    wide = np.flatnonzero(high - low > bracket)
    while wide.size:
        middle = (low[wide] + high[wide]) / 2.0
        hit = rays.blocked(columns[found[wide]], middle)
        low[wide] = np.where(hit, middle, low[wide])
        high[wide] = np.where(hit, high[wide], middle)
        wide = wide[high[wide] - low[wide] > bracket]
    tan[found] = (low + high) / 2.0
    return tan.reshape(shape)


def _triangles(field: HeightField) -> NDArray[np.int32]:
    """Return the vertices of every triangle of the surface, (T, 3)."""
    triangles = Triangles.of(field.heights_m)
    corner = np.arange(field.rows * field.cols, dtype=np.int32).reshape(field.rows, field.cols)
    north_west = corner[:-1, :-1]
    south_east = corner[1:, 1:]
    there = triangles.north_east[1:-1, 1:-1], triangles.south_west[1:-1, 1:-1]
    halves = (north_west, corner[:-1, 1:], south_east), (north_west, south_east, corner[1:, :-1])
    return np.concatenate(
        [np.stack([one[k] for one in half], axis=1) for k, half in zip(there, halves, strict=True)]
    )


def _scene(vertices: Float32Array, triangles: NDArray[np.int32]) -> Any:
    """Build Embree's scene.

    Its robust mode is not used: it is a quarter slower, with the same errors.
    """
    from embreex.mesh_construction import TriangleMesh  # noqa: PLC0415  (an extra)
    from embreex.rtcore_scene import EmbreeScene  # noqa: PLC0415

    scene = EmbreeScene()
    TriangleMesh(scene, vertices, triangles)
    # The first call commits the scene, which must not happen in two threads at once.
    scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), query="OCCLUDED")
    return scene


def grass_horizons(
    field: HeightField, eyes: Viewpoints, step_deg: float
) -> tuple[Float64Array, Float64Array]:
    """Return r.horizon's elevation angles (N, A) and seconds (N - 1,).

    The field is without holes; heights of the eyes (N,) are not used. Each place but the first is
    timed.
    """
    with tempfile.TemporaryDirectory() as folder:
        dem = Path(folder, "dem.tif")
        script = Path(folder, "horizons.sh")
        # The samples are the centres of the raster's cells.
        step = field.spacing_east_m, field.spacing_north_m
        corner = field.west_m - 0.5 * step[0], field.north_m + 0.5 * step[1]
        write_geotiff(dem, field.heights_m.astype(np.float32), field.frame.wkt, corner, step)
        places = [f"{e},{n}" for e, n in zip(eyes.easting_m, eyes.northing_m, strict=True)]
        text = _SCRIPT.format(dem=dem, step=step_deg, places=" ".join(places))
        script.write_text(text, encoding="utf-8")
        begun = time.perf_counter()
        done = subprocess.run(
            ["grass", "--tmp-location", str(dem), "--exec", "sh", str(script)],
            capture_output=True,
            text=True,
            check=False,
        )
        taken = time.perf_counter() - begun
    angles = re.findall(r"^([\d.]+),(-?[\d.]+)$", done.stdout, re.MULTILINE)
    ends = np.array(re.findall(r"^took ([\d.]+)$", done.stdout, re.MULTILINE), dtype=np.float64)
    steps = round(360.0 / step_deg)
    if done.returncode or len(ends) != len(eyes) or len(angles) < len(eyes) * steps:
        stderr = " ".join(done.stderr.split())[-200:]
        raise SkylineError(f"r.horizon gave {len(angles)} angles in {taken:.0f} s: {stderr}")
    table = np.array(angles, dtype=np.float64).reshape(len(eyes), -1, 2)
    order = np.argsort(np.round(table[0, :, 0] % 360.0, 6), kind="stable")
    return table[:, order, 1][:, -steps:], np.diff(ends)
