"""Maps of a match: its candidates on the terrain."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke

from skyline.match.candidate import Candidate
from skyline.report.labels import unnamed_in_words
from skyline.report.peaks import Sighting
from skyline.report.relief import Area, draw_bearings, draw_relief
from skyline.report.shapes import Ellipse, view_wedge_m
from skyline.report.surroundings import Surroundings
from skyline.terrain.viewpoints import Viewpoints

BEST_COLOUR, OTHER_COLOUR = "#d1103d", "#1f5fbf"

_LEAST_SIDE_M = 2000.0
_MARGIN = 0.2
_WEDGE_SHARE = 0.16
_MOST_PEAKS = 12
_NEAR_BORDER = 0.2
"""Share of the map in which a label would run over its border, were it centred."""
_WIDTH_IN = 5.8
_HALO = [withStroke(linewidth=2.5, foreground="white")]


def overview_area(candidates: Sequence[Candidate], surroundings: Surroundings) -> Area:
    """Return the area that shows all candidates and what of the store lies around them."""
    places: Sequence[Candidate | Viewpoints] = candidates or [surroundings.viewpoints]
    easting = np.hstack([place.easting_m for place in places])
    northing = np.hstack([place.northing_m for place in places])
    area = Area.around(easting, northing, _MARGIN, 2.0 * _LEAST_SIDE_M)
    return area.within(surroundings.terrain)


def detail_area(candidate: Candidate, surroundings: Surroundings) -> Area:
    """Return the area a kilometre or so around one candidate, more where it is less certain."""
    ellipse = Ellipse.of(candidate)
    side_m = _LEAST_SIDE_M if ellipse is None else max(_LEAST_SIDE_M, 4.0 * ellipse.semi_major_m)
    area = Area.around([candidate.easting_m], [candidate.northing_m], _MARGIN, side_m)
    return area.within(surroundings.terrain)


def draw_match_map(
    candidates: Sequence[Candidate],
    surroundings: Surroundings,
    area: Area,
    sightings: Sequence[Sighting] = (),
) -> Figure:
    """Draw candidates, each with its rank, its view and its 95 % ellipse.

    Parameters
    ----------
    candidates : sequence of Candidate
        The first is drawn over the others and in another colour.
    sightings : sequence of Sighting
        Peaks that the first candidate sees.
    """
    figure = Figure(
        figsize=(_WIDTH_IN, _WIDTH_IN * area.height_m / area.width_m + 0.5), layout="constrained"
    )
    axis = figure.subplots()
    draw_relief(axis, surroundings.terrain, area)
    shown = _draw_viewpoints(axis, surroundings.viewpoints, area)
    reach_m = _WEDGE_SHARE * max(area.width_m, area.height_m)
    for index, candidate in reversed(list(enumerate(candidates))):
        _draw_candidate(axis, candidate, index == 0, reach_m)
    peaks = [peak for peak in sightings if area.holds(peak.easting_m, peak.northing_m)]
    _draw_peaks(axis, peaks[:_MOST_PEAKS], area)
    axis.autoscale(False)
    draw_bearings(axis, surroundings.frame, area)
    title = f"{shown} viewpoints of the store (dots)"
    title += unnamed_in_words(max(0, len(peaks) - _MOST_PEAKS), "; ")
    axis.set_title(title, fontsize=9, loc="left")
    return figure


def _draw_viewpoints(axis: Axes, viewpoints: Viewpoints, area: Area) -> int:
    """Draw the store's locations in an area; return how many there are."""
    easting, northing = np.unique(
        np.stack([viewpoints.easting_m, viewpoints.northing_m]), axis=1
    ).reshape(2, -1)
    inside = area.holds(easting, northing)
    axis.plot(easting[inside], northing[inside], ".", color="black", markersize=2.5, alpha=0.7)
    return int(inside.sum())


def _draw_candidate(axis: Axes, candidate: Candidate, is_first: bool, reach_m: float) -> None:
    colour = BEST_COLOUR if is_first else OTHER_COLOUR
    order = 4.0 if is_first else 3.0
    reach_m *= 1.0 if is_first else 0.6
    wedge = Polygon(view_wedge_m(candidate, reach_m), closed=True, zorder=order)
    wedge.set(facecolor=(colour, 0.22), edgecolor=(colour, 0.9), linewidth=1.2)
    axis.add_patch(wedge)
    ellipse = Ellipse.of(candidate)
    if ellipse is not None:
        outline = ellipse.outline_m()
        axis.plot(*outline.T, color="white", linewidth=3.0, zorder=order + 0.1)
        axis.plot(*outline.T, color=colour, linewidth=1.4, zorder=order + 0.2)
    axis.annotate(
        "×" if candidate.rank is None else str(candidate.rank),
        (candidate.easting_m, candidate.northing_m),
        ha="center",
        va="center",
        fontsize=9 if is_first else 8,
        fontweight="bold",
        color="white",
        zorder=order + 0.5,
        bbox={"boxstyle": "circle,pad=0.22", "fc": colour, "ec": "white", "lw": 1.0},
        annotation_clip=True,
    )


def _draw_peaks(axis: Axes, peaks: Sequence[Sighting], area: Area) -> None:
    for peak in peaks:
        across = (peak.easting_m - area.west_m) / area.width_m
        near_west, near_east = across < _NEAR_BORDER, across > 1.0 - _NEAR_BORDER
        side = "left" if near_west else "right" if near_east else "center"
        place = peak.easting_m, peak.northing_m
        axis.plot(*place, "^", color="black", markeredgecolor="white", markersize=7, zorder=5)
        axis.annotate(
            peak.label,
            place,
            xytext=(0, -6),
            textcoords="offset points",
            ha=side,
            va="top",
            fontsize=8,
            path_effects=_HALO,
            parse_math=False,
            annotation_clip=True,
            zorder=5,
        )
