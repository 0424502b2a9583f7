"""The paper's figures of views, on the terrain at hand: Figures 1, 2 and 4."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from skyline.arrays import Float64Array
from skyline.camera import DEFAULT_WIDTH, HEADINGS, columns_u, pixel_size
from skyline.errors import InputError
from skyline.paper.planning.reprojection import IDENTITY
from skyline.paper.planning.warp_fit import WarpFit
from skyline.planning.uniform import MapBounds
from skyline.render.depth import DepthRenderer
from skyline.render.horizon import HorizonRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline.views import Views
from skyline_bench.figures.canvas import new_figure

ONE, OTHER, WARPED = "#0072B2", "#D55E00", "#009E73"
"""Colours of a view's skyline, another's, and the first one warped."""
_SKY = "#e3ecf6"
_HEADING_NAMES = ("north", "east", "south", "west")
_IN_IMAGE = 0.95
"""Skylines that leave the middle of a square image are not drawn."""
_PAPERS_PX = 26.0
"""Plain distance of the skylines in the paper's Figure 4."""
_ALIKE_PX = 6.0
_OVERLAP = 0.85
"""Share of a skyline's columns that an affine map must leave within the other's."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Pairs of views whose eyes are a given distance apart, looking the same way.

    Attributes
    ----------
    one, other : Views
        Four views a pair of eyes, by pair, then heading.
    apart_m : float
    """

    one: Views
    other: Views
    apart_m: float

    def distance_px(self) -> Float64Array:
        """Return mean vertical distances between the two skylines of each pair of views (4 N).

        NaN where either of them is not wholly in the middle of a square image.
        """
        tan = np.stack([self.one.elevation_tan, self.other.elevation_tan]).astype(np.float64)
        drawn = (np.abs(tan) < _IN_IMAGE).all(axis=(0, 2))
        mean = np.abs(tan[0] - tan[1]).mean(axis=1) / pixel_size(self.one.width)
        return np.where(drawn, mean, np.nan)


def draw_pairs(
    terrain: HeightField, bounds_m: MapBounds, apart_m: float, count: int, seed: int = 0
) -> Pairs:
    """Render views at places drawn evenly from an area, and at others so far from them.

    Raises
    ------
    InputError
        The area has hardly any surface.
    """
    generator = np.random.default_rng(seed)
    west, south, east, north = bounds_m
    place = generator.uniform((west, south), (east, north), (4 * count, 2))
    turn = generator.uniform(0.0, 2.0 * np.pi, len(place))
    there = place + apart_m * np.stack([np.sin(turn), np.cos(turn)], axis=1)
    stands = np.isfinite(terrain.height_at(*place.T)) & np.isfinite(terrain.height_at(*there.T))
    place, there = place[stands][:count], there[stands][:count]
    if not len(place):
        raise InputError("no two places on the surface were found; choose an area less of holes")
    with HorizonRenderer(terrain) as renderer:
        one, other = (renderer.render(stand_on(terrain, *eyes.T)) for eyes in (place, there))
    return Pairs(one, other, apart_m)


def figure_1(terrain: HeightField, pairs: Pairs) -> tuple[Figure, str]:
    """Draw the two views of a pair whose skylines differ most, and say what is drawn."""
    distance = pairs.distance_px()
    row = _best(distance)
    one, other = pairs.one[row : row + 1], pairs.other[row : row + 1]
    figure = new_figure(11.0, 3.9)
    first, second, both = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.15))
    images = [_depth_image(terrain, views) for views in (one, other)]
    norm = _norm(images)
    low, high = _frame_px([one, other])
    for axis, image, views, colour, name in (
        (first, images[0], one, ONE, "view A"),
        (second, images[1], other, OTHER, f"view B, {pairs.apart_m:g} m away"),
    ):
        _draw_depth(axis, image, views, norm, colour)
        axis.set_ylim(high, low)
        axis.set_title(f"{name}, looking {_HEADING_NAMES[int(views.heading[0])]}", fontsize=10)
    _draw_bar(figure, norm, [first, second])
    for views, colour, name in ((one, ONE, "A"), (other, OTHER, "B")):
        both.plot(*_curve_deg(views), color=colour, linewidth=1.6, label=f"skyline of view {name}")
    _label_angles(both)
    return figure, (
        f"Two views {pairs.apart_m:g} m apart whose skylines differ most: {distance[row]:.0f} px "
        f"on average at W = {one.width}, {_median(distance):.1f} px is the median of the "
        f"{np.isfinite(distance).sum()} pairs looked at."
    )


def figure_2(terrain: HeightField, views: Views) -> tuple[Figure, str]:
    """Draw a depth image and the skyline found in it: of some views, the one with most depths."""
    inside = (np.abs(views.elevation_tan) < _IN_IMAGE).all(axis=1)
    spread = np.where(inside, np.log(views.depth_m).std(axis=1), np.nan)
    row = _best(spread)
    view = views[row : row + 1]
    image = _depth_image(terrain, view)
    figure = new_figure(9.6, 3.9)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.2))
    norm = _norm([image])
    _draw_depth(left, image, view, norm, OTHER)
    left.set_ylim(*_frame_px([view])[::-1])
    left.set_title(f"depth image, looking {_HEADING_NAMES[int(view.heading[0])]}", fontsize=10)
    _draw_bar(figure, norm, [left])
    azimuth, elevation = _curve_deg(view)
    right.plot(azimuth, elevation, color="#999999", linewidth=0.8)
    right.scatter(azimuth, elevation, c=view.depth_m[0], norm=norm, cmap="viridis_r", s=6, zorder=3)
    right.set_title("its skyline, coloured by depth", fontsize=10)
    _label_angles(right)
    return figure, (
        "A depth image and its skyline: in each column, from the top, the first pixel that has a "
        f"depth. Eye {_where(terrain, view)}."
    )


def figure_4(pairs: Pairs) -> tuple[Figure, str]:
    """Draw a pair of skylines before and after the affine map that aligns them best.

    The pair is the one whose plain distance is nearest to that of the paper's example.
    """
    plain = pairs.distance_px()
    row = _best(-np.abs(plain - _PAPERS_PX))
    alike = np.flatnonzero(np.abs(plain - plain[row]) <= _ALIKE_PX)
    affine, aligned = _aligned(pairs, alike)
    at = int(np.flatnonzero(alike == row)[0])
    one, other = (views.elevation_tan[row].astype(np.float64) for views in (pairs.one, pairs.other))
    u, pixel = columns_u(len(one)), pixel_size(len(one))
    warped = affine[at] @ np.stack([u, one, np.ones_like(u)])
    figure = new_figure(9.6, 3.6)
    left, right = figure.subplots(1, 2, sharey=True, sharex=True)
    left.plot(u / pixel, one / pixel, color=ONE, linewidth=1.6, label="skyline of view A")
    right.plot(*warped / pixel, color=WARPED, linewidth=1.6, label="A after the affine map")
    for axis in (left, right):
        axis.plot(u / pixel, other / pixel, color=OTHER, linewidth=1.6, label="skyline of view B")
        axis.set_xlabel("column from the middle (px)")
        axis.set_xlim(u[0] / pixel, u[-1] / pixel)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=9, loc="best")
    left.set_ylabel("up from the horizon (px)")
    left.set_title(f"plain distance {plain[row]:.1f} px", fontsize=10)
    right.set_title(f"affine distance {aligned[at]:.1f} px", fontsize=10)
    return figure, (
        f"Two skylines {pairs.apart_m:g} m apart, {plain[row]:.1f} px from one another and "
        f"{aligned[at]:.1f} px after the affine map that aligns them best. Of {len(alike)} pairs "
        f"as far from one another (within {_ALIKE_PX:g} px), the median affine distance is "
        f"{_median(aligned):.1f} px; the paper's example has 26 and 3.6 px."
    )


def _aligned(pairs: Pairs, rows: NDArray[np.intp]) -> tuple[Float64Array, Float64Array]:
    """Return the best affine maps (N, 2, 3) from one skyline to the other, and distances (N)."""
    starts = np.broadcast_to(IDENTITY, (len(rows), 1, 2, 3))
    distance, affine = WarpFit(rounds=20, min_share=_OVERLAP).distances_px(
        pairs.one.elevation_tan[rows], pairs.other.elevation_tan[rows], starts, pairs.one.width
    )
    return affine, distance


def _best(values: Float64Array) -> int:
    if np.isnan(values).all():
        raise InputError(
            "no view of this area fits into an image of 90 degrees; choose another area"
        )
    return int(np.nanargmax(values))


def _median(values: Float64Array) -> float:
    return float(np.median(values[np.isfinite(values)]))


def _depth_image(terrain: HeightField, view: Views) -> NDArray[np.float32]:
    """Return the depth image (W, W) of one view, NaN for sky."""
    eye = Viewpoints(view.easting_m, view.northing_m, view.eye_elevation_m)
    with DepthRenderer(terrain, DEFAULT_WIDTH) as renderer:
        image = renderer.depth_images(eye, 0)[HEADINGS.index(int(view.heading[0]))]
    return np.where(np.isfinite(image), image, np.float32(np.nan)).astype(np.float32)


def _norm(images: list[NDArray[np.float32]]) -> LogNorm:
    depths = np.concatenate([image[np.isfinite(image)] for image in images])
    return LogNorm(*np.percentile(depths, [1.0, 99.5]))


def _row_px(view: Views) -> Float64Array:
    tan = view.elevation_tan[0].astype(np.float64)
    return np.asarray((1.0 - tan) * view.width / 2.0 - 0.5)


def _frame_px(views: list[Views]) -> tuple[float, float]:
    """Return the first and last image row to show: the skylines, with room around them."""
    rows = np.concatenate([_row_px(view) for view in views])
    room = 0.15 * max(float(np.ptp(rows)), views[0].width / 3.0)
    return max(-0.5, rows.min() - room), min(views[0].width - 0.5, rows.max() + 1.6 * room)


def _draw_depth(
    axis: Axes, image: NDArray[np.float32], view: Views, norm: LogNorm, colour: str
) -> None:
    axis.set_facecolor(_SKY)
    axis.imshow(image, norm=norm, cmap="viridis_r", interpolation="nearest", aspect="auto")
    axis.plot(np.arange(view.width), _row_px(view), color="white", linewidth=2.6)
    axis.plot(np.arange(view.width), _row_px(view), color=colour, linewidth=1.4)
    axis.set(xlabel="column (px)", ylabel="row (px)")


def _draw_bar(figure: Figure, norm: LogNorm, axes: list[Axes]) -> None:
    bar = figure.colorbar(ScalarMappable(norm, "viridis_r"), ax=axes, pad=0.01)
    ticks = [
        tick
        for tick in (10, 30, 100, 300, 1e3, 3e3, 1e4, 3e4, 1e5)
        if (norm.vmin or 0.0) <= tick <= (norm.vmax or np.inf)
    ]
    bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
    bar.minorticks_off()
    bar.set_label("forward depth (m)")


def _curve_deg(view: Views) -> tuple[Float64Array, Float64Array]:
    """Return azimuths from the optical axis and elevations of a view's skyline."""
    return np.degrees(np.arctan(columns_u(view.width))), view.elevation_deg()[0]


def _label_angles(axis: Axes) -> None:
    axis.set(
        xlim=(-45.0, 45.0),
        xticks=np.arange(-45, 46, 15),
        xlabel="azimuth from the optical axis (degrees)",
        ylabel="elevation (degrees)",
    )
    axis.grid(alpha=0.3)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=9, loc="best")


def _where(terrain: HeightField, view: Views) -> str:
    lon, lat = terrain.frame.to_lonlat(view.easting_m, view.northing_m)
    return f"at {lat[0]:.4f}, {lon[0]:.4f}, {view.eye_elevation_m[0]:.0f} m"
