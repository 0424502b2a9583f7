"""The paper's Figure 6, on the terrain at hand: what a planner chose, and a query answered."""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from skyline.camera import HEADINGS
from skyline.errors import InputError
from skyline.matching import Candidate
from skyline.photo import QuerySkyline, extract_skyline
from skyline.pipeline import FULL, render_views
from skyline.render.depth import DepthRenderer
from skyline.report.maps import BEST_COLOUR
from skyline.report.overlay import Overlay
from skyline.report.projection import Panorama
from skyline.report.relief import Area, draw_bearings, draw_relief
from skyline.store import open_store
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.figures.canvas import new_figure
from skyline_bench.queries.photographs import draw_photo
from skyline_bench.queries.synthetic import SyntheticQuery
from skyline_bench.stores.reference import ReferenceStore
from skyline_bench.trials.matchers import open_matcher
from skyline_bench.trials.trials import errors

TRUE_COLOUR = "#0072B2"
_HEADING_NAMES = ("north", "east", "south", "west")
_DETAIL_M = 1600.0
_PANEL_SQUARE_IN = 12.0
_ROOM = 0.05
"""Share of a photograph's height that stays free above and below the skyline."""


def draw_viewpoints(
    terrain: HeightField, bounds_m: tuple[float, float, float, float], store: ReferenceStore
) -> tuple[Figure, str]:
    """Draw where a store has renderings, a map for each heading, and say what is drawn."""
    with open_store(store.path) as opened:
        headings, eyes = opened.locations().heading, opened.eyes()
    area = Area(*bounds_m)
    shape = area.height_m / area.width_m
    width = float(np.sqrt(_PANEL_SQUARE_IN / shape))
    figure = new_figure(len(HEADINGS) * width + 0.6, width * shape + 0.5)
    counts = []
    for heading, axis in zip(HEADINGS, figure.subplots(1, len(HEADINGS), sharey=True), strict=True):
        mine = headings == heading
        counts.append(int(np.count_nonzero(mine)))
        draw_relief(axis, terrain, area)
        _dot(axis, eyes[mine], 2.6)
        draw_bearings(axis, terrain.frame, area)
        axis.set_title(f"{_HEADING_NAMES[heading]}, {counts[-1]} renderings", fontsize=10)
    return figure, (
        f"Where {store.name} has renderings, by the heading they look along: "
        f"{', '.join(map(str, counts))} of {store.renderings}."
    )


@dataclass(frozen=True, slots=True, eq=False)
class WorkedQuery:
    """A photograph drawn of a query, and where it was put.

    Attributes
    ----------
    query : SyntheticQuery
        Its truth.
    photo : (H, W, 3) uint8
        RGB.
    found : QuerySkyline
        What the extraction found in the photograph.
    candidates : tuple of Candidate
        Best first.
    store : ReferenceStore
    """

    query: SyntheticQuery
    photo: NDArray[np.uint8]
    found: QuerySkyline
    candidates: tuple[Candidate, ...]
    store: ReferenceStore


def fits_landscape(query: SyntheticQuery) -> bool:
    """Whether a query's skyline is wholly inside the photograph that `work_query` draws."""
    shown = np.arange(query.skyline.height_px)[_landscape(query)]
    row = query.row_px
    room = _ROOM * len(shown)
    return bool(((row > shown[0] + room) & (row < shown[-1] - room)).all())


def _landscape(query: SyntheticQuery) -> slice:
    """Return the middle rows of a query's picture that make it two thirds as high as wide."""
    height = min(query.skyline.height_px, round(query.skyline.width_px / 1.5))
    # As many rows are left out above as below, so that the optical axis stays in the middle.
    top = (query.skyline.height_px - height) // 2
    return slice(top, query.skyline.height_px - top)


def work_query(
    terrain: HeightField,
    store: ReferenceStore,
    query: SyntheticQuery,
    seed: int,
    matcher: str = FULL,
) -> WorkedQuery:
    """Draw a landscape photograph of a query, find the skyline in it, and match that.

    ``matcher`` is a name of `skyline_bench.trials.matchers.WHAT` that can search the store.

    Raises
    ------
    InputError
        No skyline is found in the photograph.
    """
    with DepthRenderer(terrain, 2 * query.skyline.width_px) as renderer:
        photo = draw_photo(renderer, query, seed)[_landscape(query)]
    found = extract_skyline(photo).with_fov(query.given_fov_deg)
    with open_matcher(matcher, store.path, terrain) as opened:
        return WorkedQuery(query, photo, found, opened.match(found).candidates, store)


def draw_worked_query(
    terrain: HeightField, bounds_m: tuple[float, float, float, float], worked: WorkedQuery
) -> tuple[Figure, str]:
    """Draw a worked query: the photograph with both skylines, and where on the map it is.

    Raises
    ------
    InputError
        Nothing was found.
    """
    if not worked.candidates:
        raise InputError("the worked query has no candidate; there is nothing to draw")
    best, truth = worked.candidates[0], worked.query.truth
    picture = _overlay(terrain, worked)
    shape = picture.shape[0] / picture.shape[1]
    area = Area(*bounds_m)
    height = 5.6
    across = height / shape, height * area.width_m / area.height_m, 3.6
    figure = new_figure(sum(across) + 0.8, height + 0.5)
    left, middle, right = figure.subplots(1, 3, width_ratios=across)
    left.imshow(picture)
    left.set_axis_off()
    error_m, turn_deg = errors(best, truth)
    with open_store(worked.store.path) as opened:
        eyes = opened.eyes()
    detail = Area.around(
        [truth.easting_m, best.easting_m], [truth.northing_m, best.northing_m], 0.2, _DETAIL_M
    ).within(terrain)
    for axis, shown, arrow in ((middle, area, 0.11), (right, detail, 0.18)):
        draw_relief(axis, terrain, shown)
        _dot(axis, eyes, 2.0)
        for place, heading_deg, colour, marker, label in (
            (
                (truth.easting_m, truth.northing_m), truth.heading_deg, TRUE_COLOUR, "o",
                "taken here",
            ),
            (
                (best.easting_m, best.northing_m), best.grid_heading_deg, BEST_COLOUR, "X",
                "found here",
            ),
        ):  # fmt: skip
            _draw_place(axis, place, heading_deg, colour, marker, label, arrow * shown.width_m)
        draw_bearings(axis, terrain.frame, shown)
    right.legend(loc="upper right", fontsize=9, framealpha=0.9)
    middle.set_title(f"{worked.store.name}, {worked.store.rows} {worked.store.holds}", fontsize=10)
    right.set_title(f"{error_m:.0f} m off, heading {turn_deg:.1f}° off", fontsize=10)
    sure = "" if best.confidence is None else f", confidence {100.0 * best.confidence:.0f} %"
    return figure, (
        "A drawn photograph, the skyline found in it, the skyline rendered at the answer, and "
        f"both places on the map (dots: viewpoints of {worked.store.name}). The answer is "
        f"{error_m:.0f} m and {turn_deg:.1f} degrees off{sure}."
    )


def _overlay(terrain: HeightField, worked: WorkedQuery) -> NDArray[np.uint8]:
    best = worked.candidates[0]
    panorama = None
    if best.eye_elevation_m is not None:
        eye = Viewpoints(
            *(np.array([x]) for x in (best.easting_m, best.northing_m, best.eye_elevation_m))
        )
        panorama = Panorama.of(render_views(terrain, eye))
    drawn = Overlay(worked.found, worked.photo, best, panorama).jpeg()
    with Image.open(io.BytesIO(drawn)) as picture:
        return np.asarray(picture.convert("RGB"))


def _dot(axis: Axes, eyes: Viewpoints, size: float) -> None:
    axis.plot(
        eyes.easting_m,
        eyes.northing_m,
        ".",
        color="black",
        markeredgewidth=0.0,
        markersize=1.8 * size,
    )


def _draw_place(
    axis: Axes,
    place: Sequence[float],
    heading_deg: float,
    colour: str,
    marker: str,
    label: str,
    arrow_m: float,
) -> None:
    turn = np.radians(heading_deg)
    axis.annotate(
        "",
        xytext=(place[0], place[1]),
        xy=(place[0] + arrow_m * np.sin(turn), place[1] + arrow_m * np.cos(turn)),
        arrowprops={"arrowstyle": "->", "color": colour, "lw": 1.8},
    )
    axis.plot(
        place[0], place[1], marker, color=colour, markeredgecolor="white", markersize=10,
        linestyle="none", label=label, zorder=5,
    )  # fmt: skip
