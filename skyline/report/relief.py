"""Shaded relief, and what a map needs around it: degrees, a scale and true north."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LightSource, LinearSegmentedColormap, Normalize
from matplotlib.offsetbox import AnchoredText
from numpy.typing import ArrayLike

from skyline.arrays import BoolArray, Float64Array
from skyline.geodesy import Frame, degrees_in_words, in_turn
from skyline.report.relief_tiles import DARKEST, TINTS
from skyline.terrain.heightfield import HeightField

_MOST_SAMPLES = 900
_TINT = LinearSegmentedColormap.from_list("height", TINTS).with_extremes(bad="#e8eef5")
_NO_TERRAIN = "#eef0ee"
_EDGE_POINTS = 65


@dataclass(frozen=True, slots=True)
class Area:
    """A rectangle of the map, in metres of its frame."""

    west_m: float
    south_m: float
    east_m: float
    north_m: float

    @classmethod
    def around(
        cls, easting_m: ArrayLike, northing_m: ArrayLike, margin: float, least_m: float
    ) -> "Area":
        """Return the square around places, a share ``margin`` of its side free all round."""
        easting, northing = np.asarray(easting_m), np.asarray(northing_m)
        widest = max(float(np.ptp(easting)), float(np.ptp(northing)))
        half = max(widest / (1.0 - 2.0 * margin), least_m) / 2.0
        east = float(easting.min() + easting.max()) / 2.0
        north = float(northing.min() + northing.max()) / 2.0
        return cls(east - half, north - half, east + half, north + half)

    def within(self, terrain: HeightField | None) -> "Area":
        """Return the part of the area that a height field covers, if any, else all of it."""
        if terrain is None:
            return self
        west, south, east, north = terrain.bounds_m
        part = Area(
            max(west, self.west_m),
            max(south, self.south_m),
            min(east, self.east_m),
            min(north, self.north_m),
        )
        return part if part.west_m < part.east_m and part.south_m < part.north_m else self

    def holds(self, easting_m: ArrayLike, northing_m: ArrayLike) -> BoolArray:
        """Whether places lie in the area."""
        easting, northing = np.asarray(easting_m), np.asarray(northing_m)
        across = (self.west_m <= easting) & (easting <= self.east_m)
        return across & (self.south_m <= northing) & (northing <= self.north_m)

    @property
    def width_m(self) -> float:
        """From west to east."""
        return self.east_m - self.west_m

    @property
    def height_m(self) -> float:
        """From south to north."""
        return self.north_m - self.south_m

    @property
    def centre(self) -> dict[str, float]:
        """Easting and northing of the middle, by the names that `Frame` takes them by."""
        return {
            "easting_m": (self.west_m + self.east_m) / 2.0,
            "northing_m": (self.south_m + self.north_m) / 2.0,
        }


def draw_relief(axis: Axes, terrain: HeightField | None, area: Area) -> None:
    """Draw the terrain of an area, lit from the north-west and tinted by height.

    Without terrain the map stays plain and says so.
    """
    axis.set_facecolor(_NO_TERRAIN)
    axis.set(xlim=(area.west_m, area.east_m), ylim=(area.south_m, area.north_m), aspect="equal")
    crop = None if terrain is None else _crop(terrain, area)
    if terrain is None or crop is None:
        axis.add_artist(AnchoredText("no elevation data for relief", loc="lower right"))
        return
    heights, extent, step = crop
    low, high = np.nanpercentile(heights, [0.5, 99.5])
    tint = Normalize(low, max(high, low + 1.0))
    shade = LightSource(azdeg=315.0, altdeg=45.0).hillshade(
        np.nan_to_num(heights, nan=low),
        dx=terrain.spacing_east_m * step,
        dy=terrain.spacing_north_m * step,
    )
    light = (DARKEST + (1.0 - DARKEST) * shade)[..., np.newaxis]
    rgb = _TINT(tint(np.ma.masked_invalid(heights)))[..., :3]
    picture = np.where(np.isnan(heights)[..., np.newaxis], rgb, rgb * light)
    axis.imshow(picture, extent=extent, interpolation="bilinear", aspect="equal")


def _crop(
    terrain: HeightField, area: Area
) -> tuple[Float64Array, tuple[float, float, float, float], int] | None:
    """Return the heights in an area, where they lie (west, east, south, north), and their step."""
    top, left = (
        math.floor(at) - 1 for at in terrain.to_grid(easting_m=area.west_m, northing_m=area.north_m)
    )
    bottom, right = (
        math.ceil(at) + 2 for at in terrain.to_grid(easting_m=area.east_m, northing_m=area.south_m)
    )
    rows = slice(max(top, 0), min(bottom, terrain.rows))
    cols = slice(max(left, 0), min(right, terrain.cols))
    longest = max(rows.stop - rows.start, cols.stop - cols.start)
    step = max(1, math.ceil(longest / _MOST_SAMPLES))
    heights = terrain.heights_m[rows, cols][::step, ::step].astype(np.float64)
    if min(heights.shape, default=0) < 2 or np.isnan(heights).all():
        return None
    # A sample is the middle of its pixel.
    north, south = rows.start - step / 2.0, rows.start + (len(heights) - 0.5) * step
    west, east = cols.start - step / 2.0, cols.start + (heights.shape[1] - 0.5) * step
    (west_m, east_m), (north_m, south_m) = terrain.to_map([north, south], [west, east])
    return heights, (float(west_m), float(east_m), float(south_m), float(north_m)), step


def draw_bearings(axis: Axes, frame: Frame, area: Area) -> None:
    """Draw degrees along the borders and across the map, a scale bar and true north."""
    _draw_degrees(axis, frame, area)
    _draw_scale(axis, frame, area)
    _draw_north(axis, frame, area)


def _draw_degrees(axis: Axes, frame: Frame, area: Area) -> None:
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)
    easting = area.west_m + along * area.width_m
    northing = area.south_m + along * area.height_m
    lon, lat = frame.to_lonlat(*np.meshgrid(easting, northing))
    lon = in_turn(lon, float(lon[_EDGE_POINTS // 2, _EDGE_POINTS // 2]))
    lines: dict[str, Any] = {"colors": "black", "linewidths": 0.4, "alpha": 0.35}
    for degrees, place, edge, names, way in (
        (lon, easting, lon[0], "EW", axis.set_xticks),
        (lat, northing, lat[:, 0], "NS", axis.set_yticks),
    ):
        step = nice_length(float(np.ptp(edge)) / 2.5)
        levels = step * np.arange(math.ceil(edge.min() / step), math.floor(edge.max() / step) + 1)
        axis.contour(easting, northing, degrees, levels, **lines)
        order = np.argsort(edge)
        ticks = np.interp(levels, edge[order], place[order])
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        way(ticks, [degrees_in_words(level, names, decimals) for level in levels])
    axis.tick_params(axis="y", labelrotation=90.0)
    for label in axis.get_yticklabels():
        label.set_verticalalignment("center")


def _draw_scale(axis: Axes, frame: Frame, area: Area) -> None:
    """Draw a bar whose length is that on the ground, in the lower left."""
    scale = float(frame.scale(**area.centre))
    length_m = nice_length(0.28 * area.width_m / scale)
    west, south = area.west_m + 0.05 * area.width_m, area.south_m + 0.045 * area.height_m
    east = west + length_m * scale
    text = f"{length_m / 1000.0:g} km" if length_m >= 1000.0 else f"{length_m:g} m"
    for colour, width in (("white", 6.0), ("black", 2.5)):
        axis.plot(
            [west, east], [south, south], color=colour, linewidth=width, solid_capstyle="butt"
        )
    axis.annotate(
        text,
        ((west + east) / 2.0, south),
        xytext=(0, 5),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=9,
        bbox={"boxstyle": "round,pad=0.15", "fc": "white", "alpha": 0.7, "lw": 0},
    )


def _draw_north(axis: Axes, frame: Frame, area: Area) -> None:
    """Draw an arrow to true north in the upper left."""
    turn = -math.radians(float(frame.convergence_deg(**area.centre)))
    length = 0.075 * min(area.width_m, area.height_m)
    east = area.west_m + 0.06 * area.width_m
    north = area.north_m - 0.055 * area.height_m - length
    tip = east + length * math.sin(turn), north + length * math.cos(turn)
    arrow = {"arrowstyle": "-|>,head_width=0.35,head_length=0.8", "lw": 2.0, "color": "black"}
    axis.annotate("", xy=tip, xytext=(east, north), arrowprops={**arrow, "shrinkA": 0})
    axis.annotate(
        "N",
        tip,
        ha="center",
        va="bottom",
        fontsize=11,
        fontweight="bold",
        bbox={"boxstyle": "round,pad=0.1", "fc": "white", "alpha": 0.7, "lw": 0},
    )


def nice_length(length: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return float(
        max(factor for factor in (1.0, 2.0, 5.0) if factor * power <= length * (1.0 + 1e-9)) * power
    )
