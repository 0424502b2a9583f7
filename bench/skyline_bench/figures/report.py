"""What a person sees of uniform against adaptive: a page of tables and the paper's figures."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from skyline import __version__
from skyline.errors import InputError
from skyline.files import write_with_folders
from skyline.pipeline import FULL
from skyline.planning.uniform import map_bounds
from skyline.report.html import Page, Part, Picture, Section, Table, Text
from skyline.store.header import RENDERINGS
from skyline_bench.figures.small_png import encode_small_png
from skyline_bench.figures.stores import (
    draw_viewpoints,
    draw_worked_query,
    fits_landscape,
    work_query,
)
from skyline_bench.figures.tables import EQUAL, REACHED, STORES, in_megabytes, store_lines
from skyline_bench.figures.uniform_adaptive import draw_costs
from skyline_bench.figures.views import draw_pairs, figure_1, figure_2, figure_4
from skyline_bench.measuring.record import Row, machine, shown
from skyline_bench.queries.synthetic import SyntheticQuery
from skyline_bench.runs.cost_summary import UNIFORM, equal_rows, reached_rows
from skyline_bench.runs.uniform_adaptive import Measured, UniformAdaptive
from skyline_bench.trials.matchers import WHAT

_NEAR_M, _FAR_M = 30.0, 100.0
"""How far the views of Figure 1 and those of Figure 4 are apart."""
_PAIRS = 250
_COSTS_CAPTION = (
    "Mean position error over all queries against renderings (above) and against the bytes of a "
    "store (below); bars are 95 % bootstrap intervals over the queries. Grey: Table 2 of the "
    "paper, six photos of other terrain."
)

_STORES = (
    "All queries. A place counts as four renderings, planning as part of the build. From and to "
    "bound the mean's 95 % interval."
)
_REACHED = (
    "The cheapest adaptive store measured whose mean error is no worse than the finest uniform "
    "store's. Interpolated: between it and the next cheaper budget, on logarithmic axes."
)
_EQUAL = (
    "Adaptive stores, and what uniform ones would have at as many renderings (interpolated between "
    "them on logarithmic axes)."
)

Drawn = tuple[Figure, str]


def write_report(folder: Path, compared: UniformAdaptive) -> Path:
    """Write ``index.html`` and its pictures, as files beside it, into a folder; return the page.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    rows = compared.rows()
    reached = [in_megabytes(row) for row in reached_rows(rows)]
    costs = _kept(folder / "fig7-costs.png", draw_costs(rows), _COSTS_CAPTION)
    sections = [
        Section("Error against cost", [costs, _table(store_lines(rows), STORES, _STORES)]),
        Section(
            "What it comes to",
            [_table(reached, REACHED, _REACHED), _table(equal_rows(rows), EQUAL, _EQUAL)],
        ),
        *_groups(compared, rows),
        Section("What planners chose, and a query answered", _stores(folder, compared)),
        Section("Views of this terrain", _views(folder, compared)),
        Section("Where and when", [Table.of_facts({k: str(v) for k, v in machine().items()})]),
    ]
    west, south, east, north = map_bounds(compared.terrain, compared.bounds_deg)
    lead = (
        f"{len(compared.queries)} synthetic queries in {(east - west) / 1e3:.1f} x "
        f"{(north - south) / 1e3:.1f} km, bounds "
        f"{','.join(f'{degrees:.4f}' for degrees in compared.bounds_deg)}, seed {compared.seed}. "
        "Errors are metres from where a query was taken to the best candidate; a query without "
        "any counts as wrong by half of the area's diagonal."
    )
    page = Page("Uniform against adaptive stores", lead, sections, f"skyline {__version__}")
    path = folder / "index.html"
    page.write(path)
    return path


def _table(rows: Sequence[Row], columns: Mapping[str, str], caption: str) -> Table:
    lines = [[shown(row.get(key)) for key in columns] for row in rows]
    return Table(list(columns.values()), lines, caption)


def _groups(compared: UniformAdaptive, rows: Sequence[Row]) -> list[Section]:
    """Return the paper's Table 2, once a matcher."""
    stores = list(dict.fromkeys(str(row["store"]) for row in rows))
    parts: list[Part] = []
    for matcher, what in WHAT.items():
        mine = [row for row in rows if row["matcher"] == matcher]
        lines = []
        for group in compared.groups:
            of = {str(row["store"]): row for row in mine if row["group"] == group.name}
            if of:
                about = f"{group.name} ({group.from_m:.0f} to {group.to_m:.0f} m)"
                lines.append([about, *(shown(of[store]["mean_m"]) for store in stores)])
        if lines:
            parts.append(Table(["skyline", *stores], lines, f"{matcher}: {what}. Mean error, m."))
    return [Section("By how far the skyline is", parts)]


def _stores(folder: Path, compared: UniformAdaptive) -> list[Part]:
    """Return the maps of the largest adaptive store of each planner, and a worked query."""
    bounds_m = map_bounds(compared.terrain, compared.bounds_deg)
    planned = {
        one.planner: one.store
        for one in compared.measured
        if one.planner != UNIFORM and one.store.holds == RENDERINGS
    }
    parts: list[Part] = [
        _kept(
            folder / f"fig6-viewpoints-{planner}.png",
            *draw_viewpoints(compared.terrain, bounds_m, store),
        )
        for planner, store in planned.items()
    ]
    shown = _example(compared.measured)

    def draw() -> Drawn:
        query = compared.queries[_typical(shown, compared.queries)]
        worked = work_query(compared.terrain, shown.store, query, compared.seed, shown.matcher)
        return draw_worked_query(compared.terrain, bounds_m, worked)

    return parts + _drawn_or_why(folder / "fig6-query.png", draw)


def _example(measured: Sequence[Measured]) -> Measured:
    """Return the last store refined, or whatever comes last."""
    refined = [one for one in measured if one.matcher == FULL]
    return (refined or list(measured))[-1]


def _typical(measured: Measured, queries: Sequence[SyntheticQuery]) -> int:
    """Return the number of the query of median error: neither a good one nor a bad one.

    Of those whose skyline a landscape photograph shows whole.
    """
    shown = [trial for trial in measured.trials if fits_landscape(queries[trial.query])]
    if not shown:
        raise InputError("no query's skyline fits into a landscape photograph")
    return sorted(shown, key=lambda trial: trial.error_m)[(len(shown) - 1) // 2].query


def _views(folder: Path, compared: UniformAdaptive) -> list[Part]:
    """Return the paper's figures of views."""
    terrain, seed = compared.terrain, compared.seed
    bounds_m = map_bounds(terrain, compared.bounds_deg)
    near = draw_pairs(terrain, bounds_m, _NEAR_M, _PAIRS, seed)
    far = draw_pairs(terrain, bounds_m, _FAR_M, _PAIRS, seed)
    parts: list[Part] = []
    for name, draw in (
        ("fig1-30-m-apart.png", lambda: figure_1(terrain, near)),
        ("fig2-depth.png", lambda: figure_2(terrain, near.one)),
        ("fig4-affine.png", lambda: figure_4(far)),
    ):
        parts += _drawn_or_why(folder / name, draw)
    return parts


def _drawn_or_why(path: Path, draw: Callable[[], Drawn]) -> list[Part]:
    """Return a picture, kept, or why there is nothing to draw."""
    try:
        figure, caption = draw()
    except InputError as error:
        return [Text(f"{path.stem} is not drawn: {error}")]
    return [_kept(path, figure, caption)]


def _kept(path: Path, figure: Figure, caption: str) -> Picture:
    data = encode_small_png(figure)
    write_with_folders(path, data)
    return Picture(data, caption)
