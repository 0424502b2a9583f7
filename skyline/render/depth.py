"""The paper's rasterizer: depth images, and their skylines (section 3).

For each heading the height field is drawn as a grid of triangles into a W x W image of inverse
depth. The skyline of a column is its first pixel from the top with a finite depth. It is quantized:
within half a pixel of the exact skyline, about 0.3 px rms.
"""

import math

import moderngl
import numpy as np
from numpy.typing import NDArray
from pyrr import matrix44

from skyline.arrays import Float32Array, Float64Array
from skyline.errors import InputError
from skyline.geodesy.earth import Curvature
from skyline.render.context import Renderer, compile_shaders, in_context
from skyline.skylines import (
    DEFAULT_WIDTH,
    FLAG_OUT_OF_IMAGE,
    HEADINGS,
    Views,
    check_width,
    columns_u,
    raised_to_dip,
    rotation,
)
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, in_four_views

TILE_CELLS = 64
"""Cells along a side of the tiles that are drawn or skipped as a whole."""

_HOLE_HEIGHT_M = -1e30
"""Height that marks a hole in the texture, since some drivers do not pass NaN to shaders."""

QUANTIZATION_PX = 0.5 + 2.0 / 256.0
"""Bound on the skyline's error: half a pixel, plus the 1/256 px grid to which vertices snap."""


class DepthRenderer(Renderer):
    """Renders depth images and skylines of one height field.

    ``width`` is the number W of columns and of rows of a depth image. Raises `InputError` if it is
    out of range or the field is larger than one texture of this OpenGL, and `ContextError` if no
    OpenGL context can be made.
    """

    @in_context
    def __init__(
        self,
        field: HeightField,
        width: int = DEFAULT_WIDTH,
        curvature: Curvature | None = None,
    ) -> None:
        super().__init__(f"depth {width} px")
        self.field = field
        self.width = check_width(width)
        self.curvature = field.frame.curvature_or(curvature)
        ctx = self._context.ctx
        largest = int(ctx.info["GL_MAX_TEXTURE_SIZE"])
        if max(field.rows, field.cols, width) > largest:
            raise InputError(
                f"a DEM of {field.cols} x {field.rows} samples at width {width} does not fit this "
                f"OpenGL's textures of at most {largest}; cut the DEM to the area (`rio clip`)"
            )
        holes = {"HOLES": "", "HOLE_HEIGHT_M": f"{_HOLE_HEIGHT_M:.1e}"} if field.has_holes else {}
        self._terrain = compile_shaders(
            ctx, "terrain.vert", "depth.frag", defines={"TILE": str(TILE_CELLS), **holes}
        )
        heights = np.nan_to_num(field.heights_m.astype(np.float32), nan=_HOLE_HEIGHT_M)
        self._heights = ctx.texture((field.cols, field.rows), 1, heights, dtype="f4")
        self._heights.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._depth = ctx.texture((width, width), 1, dtype="f4")
        self._depth.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._depth_target = ctx.framebuffer([self._depth])
        self._tiles = _tile_origins(field)
        self._tile_buffer = ctx.buffer(reserve=self._tiles.nbytes)
        self._indices = ctx.buffer(_tile_triangles())
        self._mesh = ctx.vertex_array(
            self._terrain, [(self._tile_buffer, "2i/i", "tile_origin")], self._indices
        )

    def render(self, viewpoints: Viewpoints) -> Views:
        """Render N viewpoints to their four headings, as 4 N views.

        The four views of a viewpoint follow one another. Columns have the flag `FLAG_OUT_OF_IMAGE`,
        and the one that `raised_to_dip` sets.
        """
        eyes, headings = in_four_views(viewpoints)
        v, depth_m = np.empty((2, len(eyes), self.width), dtype=np.float32)
        flags = np.zeros(v.shape, dtype=np.uint8)
        for index in range(len(viewpoints)):
            images = self.depth_images(viewpoints, index)
            # A pixel is covered when its centre is below the skyline, so the skyline lies between
            # that centre and the next one up: the pixel's top edge is the unbiased ordinate.
            top = np.isfinite(images).argmax(axis=1)
            depth = np.take_along_axis(images, top[:, np.newaxis], axis=1)[:, 0]
            is_seen = np.isfinite(depth)
            rows = slice(len(HEADINGS) * index, len(HEADINGS) * (index + 1))
            ordinate = np.float32(2.0) * (self.width - top).astype(np.float32) / self.width - 1.0
            v[rows] = np.where(is_seen, ordinate, np.nan)
            depth_m[rows] = np.where(is_seen, depth, np.nan)
            flags[rows] = np.where(top == 0, FLAG_OUT_OF_IMAGE, 0)
        position = eyes.easting_m, eyes.northing_m, eyes.eye_elevation_m
        views = Views(*position, headings, v, depth_m, flags)
        lowest_m = self.field.height_range_m[0]
        return raised_to_dip(views, columns_u(self.width), lowest_m, self.curvature)

    @in_context
    def depth_images(self, viewpoints: Viewpoints, index: int) -> Float32Array:
        """Return one viewpoint's forward depths in metres, (4, W, W).

        Depths of the sky are inf. The top row comes first. The eye is subtracted in float64, so
        that nothing absolute reaches the GPU.
        """
        images = np.empty((len(HEADINGS), self.width, self.width), dtype=np.float32)
        field = self.field
        position = {
            "easting_m": viewpoints.easting_m[index],
            "northing_m": viewpoints.northing_m[index],
        }
        row, col = (float(number) for number in field.to_grid(**position))
        self._stand(row, col, float(viewpoints.eye_elevation_m[index]))
        near_m = _near_m(field, viewpoints, index)
        far_m = 1.1 * field.reach_m(**position) + field.spacing_m
        for heading in HEADINGS:
            self._terrain["camera"] = tuple(_camera_matrix(heading, near_m, far_m).ravel())
            self._draw(_tiles_in_view(self._tiles, (col, row), field, heading))
            inverse = np.frombuffer(self._depth.read(), dtype=np.float32)
            with np.errstate(divide="ignore"):
                images[heading] = 1.0 / inverse.reshape(self.width, self.width)[::-1]
        return images

    def _stand(self, row: float, col: float, elevation_m: float) -> None:
        """Set the shader's uniforms of the field and of an eye."""
        field = self.field
        program = self._terrain
        cell_row = math.floor(row)
        cell_col = math.floor(col)
        high_m = float(np.float32(elevation_m))
        program["field_size"] = (field.cols, field.rows)
        program["spacing_m"] = (field.spacing_east_m, field.spacing_north_m)
        program["eye_cell"] = (cell_col, cell_row)
        program["eye_fraction"] = (col - cell_col, row - cell_row)
        program["eye_elevation_m"] = (high_m, elevation_m - high_m)
        program["drop_per_m2"] = self.curvature.drop_per_m2
        program["heights_m"] = 0

    def _draw(self, tiles: NDArray[np.int32]) -> None:
        """Draw the inverse depth of tiles; the greatest of a pixel stays."""
        ctx = self._context.ctx
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


def _camera_matrix(heading: int, near_m: float, far_m: float) -> Float64Array:
    """Return the matrix from east, up, south to clip coordinates.

    It has pyrr's row-vector form, which is GL's memory layout.
    """
    view = np.eye(4)
    mirror = np.diag([1.0, 1.0, -1.0])
    view[:3, :3] = mirror @ rotation(heading).T @ mirror
    projection = matrix44.create_perspective_projection(90.0, 1.0, near_m, far_m)
    return np.asarray(view @ projection, dtype=np.float64)


def _near_m(field: HeightField, viewpoints: Viewpoints, index: int) -> float:
    """Return the distance of a near plane, in metres.

    The plane lies in front of all visible parts of the surface. Within one cell around the eye, the
    surface is no nearer than the eye's clearance over it times the cosine of its steepest slope.
    Beyond, it is no nearer than a cell. A point nearer than the plane and inside a view of 90
    degrees lies within sqrt(3) times the plane's distance, so the plane stands at half of the least
    distance.
    """
    easting_m = viewpoints.easting_m[index]
    northing_m = viewpoints.northing_m[index]
    row, col = field.to_grid(easting_m=easting_m, northing_m=northing_m)
    top = max(int(row) - 1, 0)
    left = max(int(col) - 1, 0)
    around = field.part(slice(top, top + 4), slice(left, left + 4)).astype(np.float64)
    steps = np.concatenate([np.diff(around, axis=0).ravel(), np.diff(around, axis=1).ravel()])
    steepest = np.hypot(*(2 * [np.nanmax(np.abs(steps), initial=0.0) / field.spacing_m]))
    ground_m = field.height_at(easting_m=easting_m, northing_m=northing_m)
    clearance_m = float(viewpoints.eye_elevation_m[index] - ground_m)
    nearest_m = min(clearance_m / np.hypot(1.0, steepest), field.spacing_m)
    return float(max(nearest_m / 2.0, 1e-6 * field.spacing_m))


def _tile_origins(field: HeightField) -> NDArray[np.int32]:
    """Return (T, 2) column and row of every tile's north-west sample."""
    rows = np.arange(0, max(field.rows - 1, 1), TILE_CELLS, dtype=np.int32)
    cols = np.arange(0, max(field.cols - 1, 1), TILE_CELLS, dtype=np.int32)
    return np.stack([grid.ravel() for grid in np.meshgrid(cols, rows)], axis=1)


def _tile_triangles() -> NDArray[np.uint32]:
    """Return the vertex ids of a tile's triangles.

    Cells are split from north-west to south-east.
    """
    stride = TILE_CELLS + 1
    row, col = np.mgrid[:TILE_CELLS, :TILE_CELLS].astype(np.uint32)
    north_west = row * stride + col
    north_east = north_west + 1
    south_west = north_west + stride
    south_east = south_west + 1
    corners = [north_west, north_east, south_east, north_west, south_east, south_west]
    return np.stack(corners, axis=-1).ravel()


def _tiles_in_view(
    tiles: NDArray[np.int32], eye: tuple[float, float], field: HeightField, heading: int
) -> NDArray[np.int32]:
    """Return the tiles that reach into a heading's view of 90 degrees.

    ``eye`` is its column and row.
    """
    ends = np.stack([tiles, tiles + TILE_CELLS], axis=1).astype(np.float64)
    east = (ends[..., 0] - eye[0]) * field.spacing_east_m
    north = -(ends[..., 1] - eye[1]) * field.spacing_north_m
    turn = rotation(heading)
    right = turn[0, 0] * east + turn[0, 2] * north
    forward = turn[2, 0] * east + turn[2, 2] * north
    nearest_aside = np.where(
        np.sign(right[:, 0]) * np.sign(right[:, 1]) > 0.0, np.abs(right).min(axis=1), 0.0
    )
    # A cell's margin keeps rounding on the safe side.
    in_view = forward.max(axis=1) + field.spacing_m > nearest_aside
    return np.ascontiguousarray(tiles[in_view])
