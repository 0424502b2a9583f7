"""``skyline-bench stability``: every hard case, its error, its bound and a verdict."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from skyline.cli.terminal import Terminal
from skyline.errors import OffMapError, SkylineError
from skyline.skylines import Views
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench import options
from skyline_bench.measuring import Row
from skyline_bench.records import write_record
from skyline_bench.truth import closed_forms as forms
from skyline_bench.truth.agreement import (
    DEPTH,
    HORIZON,
    Agreement,
    RenderPath,
    SkylineScene,
    SkylineTruth,
)
from skyline_bench.truth.scenes import GRID_CASES, STEEP_CASES, WIDE_CASES


@dataclass(frozen=True, slots=True)
class SameCase:
    """The same request, or the same terrain turned, or a request refused."""

    name: str
    breaks: str
    agreement: Callable[[RenderPath, bool], Agreement]  # Along a path, and whether quick
    paths: tuple[str, ...] = ("horizon", "depth")


def _repeated(parts: Sequence[int], path: RenderPath, quick: bool) -> Agreement:
    """Compare a batch with the same batch cut into parts.

    A column with other bytes is wrong by inf.
    """
    field = forms.rough_field(17)
    scene = SkylineScene(field, forms.eyes_anywhere(field, 40, np.tile([0.0, 2.0], 20)), 160)
    cuts = [0, *parts[: 2 if quick else None], len(scene.viewpoints)]
    with path.factory(scene.field, scene.width, scene.curvature) as renderer:
        once = renderer.render(scene.viewpoints)
        again = Views.concatenate(
            [renderer.render(scene.viewpoints[start:stop]) for start, stop in pairwise(cuts)]
        )
    both = (once.v, again.v), (once.depth_m, again.depth_m)
    bits = ((one.view(np.uint32), other.view(np.uint32)) for one, other in both)
    same = np.logical_and(*(one == other for one, other in bits))
    zero = np.zeros(same.shape)
    return Agreement(np.where(same, zero, np.inf), zero, once.flags == again.flags)


Turn = tuple[tuple[int, int], tuple[int, int]]
"""A symmetry of the square grid: the matrix that turns steps along rows and columns."""

HALF_TURN = (-1, 0), (0, -1)
TRANSPOSITION = (0, 1), (1, 0)
QUARTER_TURN = (0, -1), (1, 0)
"""Anticlockwise: what was east is north."""
MIRROR = (1, 0), (0, -1)
"""East and west change places."""
_WAYS = np.array([(-1, 0), (0, 1), (1, 0), (0, -1)])
"""Steps along rows and columns of north, east, south and west."""


def _turned(
    stood: Callable[[], SkylineScene], turn: Turn, path: RenderPath, quick: bool
) -> Agreement:
    """Compare renderings of terrain and of its turned copy.

    Each may be off by the path's bound. A half turn and a transposition keep the cells' diagonals;
    a quarter turn and a mirror do not, so these take terrain whose cells are flat (height = a(row)
    + b(col)).
    """
    scene = stood().quick() if quick else stood()
    turned = turned_scene(scene, turn)
    expected = turned_views(path.render(scene), turn)
    agreement = path.agreement(turned, path.render(turned), SkylineTruth(expected))
    return replace(agreement, bound_px=2.0 * agreement.bound_px)


def turned_scene(scene: SkylineScene, turn: Turn) -> SkylineScene:
    """Turn a field and the eyes on it.

    Its north-west sample lands where a sample was.
    """
    field = scene.field
    eyes = scene.viewpoints
    spacings_m = (field.spacing_east_m, field.spacing_north_m)
    heights = field.heights_m
    if turn[0][0] == 0:
        spacings_m = spacings_m[::-1]
        heights = heights.T
    signs = np.sum(turn, axis=1)
    heights = heights[:: signs[0], :: signs[1]]
    turned = HeightField(heights, field.west_m, field.north_m, *spacings_m, field.frame)
    place = np.array(turn) @ field.to_grid(easting_m=eyes.easting_m, northing_m=eyes.northing_m)
    place += np.where(signs < 0, np.array(heights.shape) - 1, 0)[:, np.newaxis]
    easting, northing = turned.to_map(*place)
    moved = replace(eyes, easting_m=easting, northing_m=northing)
    return replace(scene, field=turned, viewpoints=moved)


def turned_views(views: Views, turn: Turn) -> Views:
    """Return the views that the turned terrain should give.

    A viewpoint has four headings.
    """
    order = [int(np.flatnonzero((way == _WAYS).all(axis=1))[0]) for way in _WAYS @ turn]
    rows = (np.arange(0, len(views), 4)[:, np.newaxis] + order).ravel()
    # A reflection lets left and right change places.
    ahead = slice(None, None, round(np.linalg.det(turn)))
    return replace(
        views,
        v=views.v[rows, ahead].astype(np.float64),
        depth_m=views.depth_m[rows, ahead].astype(np.float64),
        flags=views.flags[rows, ahead],
    )


def _split_terrain() -> SkylineScene:
    """Stand on terrain whose cells are bent along their diagonals, with holes."""
    heights = forms.rough_heights(80, 112, seed=18)
    heights[20:26, 30:50] = np.nan
    field = forms.field_of(heights, 32.0, 24.0)
    return SkylineScene(field, _dyadic_eyes(field))


def _flat_celled() -> SkylineScene:
    """Stand on terrain of flat cells: height = a(row) + b(col)."""
    a, b = forms.rough_heights(2, 160, 600.0, seed=19)
    # Whole metres add up exactly in 32 bits, so no cell is bent by rounding.
    field = forms.field_of(np.round(a[:80, np.newaxis]) + np.round(b[:112]), 32.0, 24.0)
    return SkylineScene(field, _dyadic_eyes(field))


def _dyadic_eyes(field: HeightField) -> Viewpoints:
    row = np.array([40.0, 33.25, 50.625, 61.0])
    col = np.array([56.0, 71.5, 20.625, 90.375])
    return forms.eyes_at(field, row, col, [2.0, 0.0, 30.0, 2.0])


def _refused(row: float, col: float, words: str, _path: RenderPath, _quick: bool) -> Agreement:
    """Try to stand where no eye can.

    It is wrong by inf unless refused in the expected words.
    """
    heights = forms.rough_heights(32, 32)
    heights[10:20, 10:20] = np.nan
    error_px = np.full((1, 1), np.inf)
    try:
        forms.eyes_at(forms.field_of(heights), row, col, 2.0)
    except OffMapError as error:
        error_px[words in str(error)] = 0.0
    return Agreement(error_px, np.zeros((1, 1)), np.ones((1, 1), dtype=bool))


SAME_CASES = (
    *(
        SameCase(name, breaks, partial(_repeated, parts))
        for name, breaks, parts in (
            ("the same batch twice", "the order in which lanes finish shows", ()),
            ("the same batch in parts",
             "what a column starts from depends on what was rendered beside it", (1, 9, 10, 33)),
        )
    ),
    *(
        SameCase(name, breaks, partial(_turned, stood, turn), forms.HORIZON_ONLY)
        for name, breaks, stood, turn in (
            ("half turn", "headings differ in more than a sign", _split_terrain, HALF_TURN),
            ("transposition", "rows and columns are marched by different code", _split_terrain,
             TRANSPOSITION),
            ("quarter turn", "headings differ in more than a turn", _flat_celled, QUARTER_TURN),
            ("mirror", "left and right are not treated alike", _flat_celled, MIRROR),
        )
    ),
    *(
        SameCase(name, breaks, partial(_refused, *place, words))
        for name, breaks, place, words in (
            ("eye in a void", "an eye at NaN renders something", (15.0, 15.5), "on a hole"),
            ("eye off the map", "an eye beyond the border wraps", (-0.5, 3.0), "off the map"),
        )
    ),
)  # fmt: skip


HardCase = forms.SceneCase | SameCase
HARD_CASES: tuple[HardCase, ...] = (
    *GRID_CASES, *STEEP_CASES, *WIDE_CASES, *forms.FRAME_CASES, *SAME_CASES,
)  # fmt: skip


def measure(path: RenderPath, case: HardCase, quick: bool = False) -> Row:
    """Return the row of a hard case along a path.

    ``error_px`` is the greatest error and ``bound_px`` what is allowed in that column. Where
    columns are over their bounds, both are of the column that is furthest over. ``quick`` takes the
    first two viewpoints of each scene only.
    """
    agreement = case.agreement(path, quick)
    error = agreement.error_px
    bound = agreement.bound_px
    over = error > bound
    score = np.where(over, error - bound, -np.inf) if over.any() else error
    worst = np.unravel_index(np.argmax(score), score.shape)
    return {
        "case": case.name,
        "path": path.name,
        "n": error.size,
        "error_px": float(error[worst]),
        "bound_px": float(bound[worst]),
        "flags_agree": bool(agreement.flags_agree.all()),
        "ok": agreement.holds,
        "what": case.breaks,
    }


def stability(record: options.Record = None, quick: options.Quick = False) -> None:
    """Hard cases of rendering: the error of each, and its bound.

    Each is rendered by all renderers that have a bound for it. The exit code is 1 if a case fails.
    n is the number of columns that are compared.
    """
    rows: list[Row] = []
    asked = [
        (path, case) for path in (HORIZON, DEPTH) for case in HARD_CASES if path.name in case.paths
    ]
    with Terminal().progress("cases") as progress:
        for path, case in asked:
            progress(len(rows), len(asked))
            rows.append(measure(path, case, quick))
    verdicts = [{**row, "verdict": "holds" if row["ok"] else "FAILS"} for row in rows]
    options.print_rows(verdicts, "case path n error_px bound_px verdict")
    write_record(record, rows)
    failed = [f"{row['case']} ({row['path']})" for row in rows if not row["ok"]]
    if failed:
        raise SkylineError(f"{len(failed)} of {len(rows)} cases fail: {', '.join(failed)}")
