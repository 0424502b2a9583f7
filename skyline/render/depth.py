"""The paper's rasterizer: perspective depth images, and the skyline read from each (section 3).

Per heading the height field is drawn as a grid of triangles into a W x W image of inverse depth,
and the skyline is, per column from the top, the first pixel whose depth is not infinite. It is
quantized: within half a pixel of the exact skyline, about 0.3 px rms.
"""

from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray
from pyrr import matrix44

from skyline.arrays import Float32Array
from skyline.camera import DEFAULT_WIDTH, HEADINGS, check_width, pixel_size, rotation
from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.render.context import acquire_context
from skyline.render.rims import RimColumns, RimFinder
from skyline.render.shaders import compile_program
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import FLAG_HOLE, FLAG_NO_DATA, FLAG_OUT_OF_IMAGE, FLAG_TRUNCATED, Views

TILE_CELLS = 64
"""Cells along a side of the tiles that are drawn or skipped as a whole."""

_HOLE_HEIGHT_M = -1e30
"""Stands for NaN in the texture: not every driver lets a shader see a NaN."""

_VIEWPOINTS_A_READ = 64

QUANTIZATION_PX = 0.5 + 2.0 / 256.0
"""Bound on the skyline's error: half a pixel, and the 1/256 px grid that vertices snap to."""


@dataclass(frozen=True, slots=True)
class _Eye:
    """One eye, subtracted in float64 so that nothing absolute reaches the GPU."""

    cell: tuple[int, int]
    fraction: tuple[float, float]
    elevation_m: tuple[float, float]
    near_m: float
    far_m: float


class DepthRenderer:
    """Renders depth images and skylines of one height field.

    Parameters
    ----------
    width : int
        Columns and rows W of a depth image.
    curvature : Curvature, optional
        Defaults to the Earth's with k = 0.13.

    Raises
    ------
    InputError
        A width out of range, or a field larger than one texture of this OpenGL.
    ContextError
        No OpenGL context can be made.
    """

    def __init__(
        self,
        field: HeightField,
        width: int = DEFAULT_WIDTH,
        curvature: Curvature | None = None,
    ) -> None:
        self.field = field
        self.width = check_width(width)
        self.curvature = curvature or Curvature()
        self._context = acquire_context()
        ctx = self._context.ctx
        _check_size(field, width, int(ctx.info["GL_MAX_TEXTURE_SIZE"]))
        self._rims = RimFinder(field, self.curvature)
        holes = {"HOLES": "", "HOLE_HEIGHT_M": f"{_HOLE_HEIGHT_M:.1e}"} if field.has_holes else {}
        self._terrain = compile_program(
            ctx, "terrain.vert", "depth.frag", {"TILE": str(TILE_CELLS), **holes}
        )
        self._skyline = compile_program(ctx, "fullscreen.vert", "depth_skyline.frag")
        heights = np.nan_to_num(field.heights_m.astype(np.float32), nan=_HOLE_HEIGHT_M)
        self._heights = ctx.texture((field.cols, field.rows), 1, heights, dtype="f4")
        self._heights.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._depth = ctx.texture((width, width), 1, dtype="f4")
        self._depth.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._depth_target = ctx.framebuffer([self._depth])
        self._rows = ctx.texture((width, len(HEADINGS) * _VIEWPOINTS_A_READ), 3, dtype="f4")
        self._rows_target = ctx.framebuffer([self._rows])
        self._tiles = _tile_origins(field)
        self._tile_buffer = ctx.buffer(reserve=self._tiles.nbytes)
        self._indices = ctx.buffer(_tile_triangles())
        self._mesh = ctx.vertex_array(
            self._terrain, [(self._tile_buffer, "2i/i", "tile_origin")], self._indices
        )
        self._scan = ctx.vertex_array(self._skyline, [])

    @property
    def description(self) -> str:
        """Name of this rasterizer and of the OpenGL renderer under it, for records."""
        return f"depth {self.width} px; {self._context.renderer}"

    def render(self, viewpoints: Viewpoints) -> Views:
        """Render the skylines of N viewpoints, 4 N views: the four headings of each in turn."""
        parts = [Views.empty(self.width)]
        for start in range(0, len(viewpoints), _VIEWPOINTS_A_READ):
            parts.append(self._render_batch(viewpoints[start : start + _VIEWPOINTS_A_READ]))
        return Views.concatenate(parts)

    def depth_images(self, viewpoints: Viewpoints, index: int) -> Float32Array:
        """Return forward depth in metres of one viewpoint, (4, W, W), top row first, inf = sky."""
        images = np.empty((len(HEADINGS), self.width, self.width), dtype=np.float32)
        eye = self._eye(viewpoints, index)
        for heading in HEADINGS:
            self._draw(eye, heading)
            inverse = np.frombuffer(self._depth.read(), dtype=np.float32)
            with np.errstate(divide="ignore"):
                images[heading] = 1.0 / inverse.reshape(self.width, self.width)[::-1]
        return images

    def release(self) -> None:
        """Free what this renderer holds on the GPU; the context stays for others."""
        # A framebuffer must not be bound after its release.
        self._context.ctx.detect_framebuffer(0).use()
        for held in (
            self._scan,
            self._mesh,
            self._indices,
            self._tile_buffer,
            self._rows_target,
            self._rows,
            self._depth_target,
            self._depth,
            self._heights,
            self._skyline,
            self._terrain,
        ):
            held.release()

    def __enter__(self) -> "DepthRenderer":
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def _render_batch(self, viewpoints: Viewpoints) -> Views:
        for index in range(len(viewpoints)):
            eye = self._eye(viewpoints, index)
            for heading in HEADINGS:
                self._draw(eye, heading)
                self._scan_columns(len(HEADINGS) * index + heading)
        count = len(HEADINGS) * len(viewpoints)
        viewport = (0, 0, self.width, count)
        pixels = np.frombuffer(
            self._rows_target.read(viewport, components=3, dtype="f4"), dtype=np.float32
        ).reshape(count, self.width, 3)
        return self._views(viewpoints, pixels)

    def _views(self, viewpoints: Viewpoints, pixels: Float32Array) -> Views:
        headings = np.tile(np.array(HEADINGS, dtype=np.uint8), len(viewpoints))
        row = pixels[..., 2]
        seen = row >= 0.0
        tan = np.where(seen, pixels[..., 0], np.float32(np.nan))
        depth = np.where(seen, pixels[..., 1], np.float32(np.nan))
        rims = [
            self._rims.columns(viewpoints, index // len(HEADINGS), int(heading), self.width)
            for index, heading in enumerate(headings)
        ]
        return Views(
            np.repeat(viewpoints.easting_m, len(HEADINGS)),
            np.repeat(viewpoints.northing_m, len(HEADINGS)),
            np.repeat(viewpoints.eye_elevation_m, len(HEADINGS)),
            headings,
            tan,
            depth,
            _flags(row, tan, rims),
        )

    def _eye(self, viewpoints: Viewpoints, index: int) -> _Eye:
        easting, northing = viewpoints.easting_m[index], viewpoints.northing_m[index]
        elevation = viewpoints.eye_elevation_m[index]
        row, col = self.field.to_grid(easting, northing)
        cell_row, cell_col = int(np.floor(row)), int(np.floor(col))
        high = float(np.float32(elevation))
        return _Eye(
            (cell_col, cell_row),
            (float(col) - cell_col, float(row) - cell_row),
            (high, float(elevation) - high),
            _near_m(self.field, viewpoints, index),
            1.1 * self.field.reach_m(easting, northing) + self.field.spacing_m,
        )

    def _draw(self, eye: _Eye, heading: int) -> None:
        """Draw one depth image into the inverse-depth texture."""
        ctx, program = self._context.ctx, self._terrain
        tiles = _tiles_in_view(self._tiles, eye, self.field, heading)
        program["field_size"] = (self.field.cols, self.field.rows)
        program["spacing_m"] = (self.field.spacing_east_m, self.field.spacing_north_m)
        program["eye_cell"] = eye.cell
        program["eye_fraction"] = eye.fraction
        program["eye_elevation_m"] = eye.elevation_m
        program["drop_per_m2"] = self.curvature.drop_per_m2
        program["camera"] = tuple(_camera_matrix(heading, eye).ravel())
        program["heights_m"] = 0
        self._tile_buffer.write(tiles.tobytes())
        self._heights.use(0)
        self._depth_target.use()
        self._depth_target.clear()
        ctx.enable_only(moderngl.BLEND)
        ctx.blend_func = moderngl.ONE, moderngl.ONE
        ctx.blend_equation = moderngl.MAX, moderngl.MAX
        self._mesh.render(moderngl.TRIANGLES, instances=len(tiles))
        ctx.blend_equation = moderngl.FUNC_ADD, moderngl.FUNC_ADD
        ctx.enable_only(moderngl.NOTHING)

    def _scan_columns(self, row: int) -> None:
        """Extract the skyline of the image just drawn into one row of the result."""
        self._skyline["inverse_depth"] = 0
        self._skyline["size"] = self.width
        self._depth.use(0)
        self._rows_target.use()
        self._context.ctx.viewport = (0, row, self.width, 1)
        self._scan.render(moderngl.TRIANGLES, vertices=3)


def _flags(row: Float32Array, tan: Float32Array, rims: list[RimColumns]) -> NDArray[np.uint8]:
    """Return the flags of (N, W) columns from their covered rows, skylines and rims."""
    width = row.shape[1]
    border = np.stack([rim.border_tan for rim in rims])
    meets_data = np.stack([rim.meets_data for rim in rims])
    over_hole = np.stack([rim.over_hole for rim in rims])
    # A border as high as the skyline may be, given its quantization, may be what it shows.
    truncated = border >= np.nan_to_num(tan, nan=np.inf) - QUANTIZATION_PX * pixel_size(width)
    out_of_image = (row == width - 1) | ((row < 0.0) & meets_data)
    flags = (
        truncated * FLAG_TRUNCATED
        + over_hole * FLAG_HOLE
        + ((row < 0.0) & ~meets_data) * FLAG_NO_DATA
        + out_of_image * FLAG_OUT_OF_IMAGE
    )
    return np.asarray(flags, dtype=np.uint8)


def _check_size(field: HeightField, width: int, largest: int) -> None:
    if max(field.rows, field.cols, width) > largest:
        raise InputError(
            f"a DEM of {field.cols} x {field.rows} samples at width {width} does not fit this "
            f"OpenGL's textures of at most {largest}; cut the DEM to the area (--bounds)"
        )


def _camera_matrix(heading: int, eye: _Eye) -> NDArray[np.float64]:
    """Return east, up, south -> clip in pyrr's row-vector form, which is GL's memory layout."""
    to_camera = np.eye(4)
    to_camera[:3, :3] = rotation(heading).T
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    view = matrix44.multiply(matrix44.multiply(mirror, to_camera), mirror)
    projection = matrix44.create_perspective_projection(90.0, 1.0, eye.near_m, eye.far_m)
    return np.asarray(matrix44.multiply(view, projection), dtype=np.float64)


def _near_m(field: HeightField, viewpoints: Viewpoints, index: int) -> float:
    """Return a near plane in front of which no part of the surface can come into view.

    Within one cell around the eye the surface is no nearer than the eye's clearance over it
    times the cosine of its steepest slope; beyond, no nearer than a cell. A point nearer than
    the plane and inside a 90 degree view lies within sqrt(3) of the plane's distance.
    """
    easting, northing = viewpoints.easting_m[index], viewpoints.northing_m[index]
    row, col = field.to_grid(easting, northing)
    top, left = max(int(row) - 1, 0), max(int(col) - 1, 0)
    around = field.heights_m[top : top + 4, left : left + 4].astype(np.float64)
    steps = np.concatenate([np.diff(around, axis=0).ravel(), np.diff(around, axis=1).ravel()])
    steepest = np.hypot(*(2 * [np.nanmax(np.abs(steps), initial=0.0) / field.spacing_m]))
    clearance = float(viewpoints.eye_elevation_m[index] - field.height_at(easting, northing))
    nearest = min(clearance / np.hypot(1.0, steepest), field.spacing_m)
    return float(max(nearest / 2.0, 1e-6 * field.spacing_m))


def _tile_origins(field: HeightField) -> NDArray[np.int32]:
    """Return (T, 2) column and row of every tile's north-west sample."""
    rows = np.arange(0, max(field.rows - 1, 1), TILE_CELLS, dtype=np.int32)
    cols = np.arange(0, max(field.cols - 1, 1), TILE_CELLS, dtype=np.int32)
    return np.stack([grid.ravel() for grid in np.meshgrid(cols, rows)], axis=1)


def _tile_triangles() -> NDArray[np.uint32]:
    """Return the vertex ids of a tile's triangles, split from north-west to south-east."""
    stride = TILE_CELLS + 1
    row, col = np.mgrid[:TILE_CELLS, :TILE_CELLS].astype(np.uint32)
    north_west = row * stride + col
    north_east, south_west = north_west + 1, north_west + stride
    south_east = south_west + 1
    corners = [north_west, north_east, south_east, north_west, south_east, south_west]
    return np.stack(corners, axis=-1).ravel()


def _tiles_in_view(
    tiles: NDArray[np.int32], eye: _Eye, field: HeightField, heading: int
) -> NDArray[np.int32]:
    """Return the tiles that reach into the 90 degree wedge of a heading."""
    ends = np.stack([tiles, tiles + TILE_CELLS], axis=1).astype(np.float64)
    east = (ends[..., 0] - eye.cell[0] - eye.fraction[0]) * field.spacing_east_m
    north = -(ends[..., 1] - eye.cell[1] - eye.fraction[1]) * field.spacing_north_m
    turn = rotation(heading)
    right = turn[0, 0] * east + turn[0, 2] * north
    forward = turn[2, 0] * east + turn[2, 2] * north
    nearest_aside = np.where(
        np.sign(right[:, 0]) * np.sign(right[:, 1]) > 0.0, np.abs(right).min(axis=1), 0.0
    )
    # A cell's margin keeps rounding on the safe side.
    in_view = forward.max(axis=1) + field.spacing_m > nearest_aside
    return np.ascontiguousarray(tiles[in_view])
