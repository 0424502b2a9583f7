"""Drawings of a folder's records: a page of tables, and some diagrams."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skyline.errors import InputError
from skyline.files.disk import write_whole
from skyline_bench.measuring import Row
from skyline_bench.options import table_text
from skyline_bench.records import read_record
from skyline_bench.search.commands import AGAINST_EQUAL, COMPARISONS
from skyline_bench.search.trials import ALL, by_planner

PAGE = "figures.md"
"""The page of a folder of records."""
_WAYS = {
    "horizon": ("Skyline, four views", "crimson", "o"),
    "all round": ("Skyline, all the way round", "tab:green", "D"),
    "embree": ("Embree's rays", "tab:blue", "^"),
    "depth": ("depth images", "tab:gray", "s"),
    "grass": ("GRASS r.horizon", "tab:brown", "*"),
}
"""By path: label, colour and marker."""
_SHARES = "within_200m", "within_200m_low", "within_200m_high"
_SPEED = {"path", "ms_per_viewpoint", "rms_px"}
_FOUND = {"renderings", "planner", "group", "matcher", "queries", "search", *_SHARES}
"""Columns of the records that can be drawn as diagrams."""


def draw_folder(folder: Path, out: Path) -> list[Path]:
    """Draw a folder's records; return the files written, the page last.

    Other JSON files are ignored. Raises `InputError` for a folder without records, and if a file
    cannot be written.
    """
    records = dict(_records_in(folder))
    if not records:
        raise InputError(
            f"{folder} has no record of a benchmark; make one: skyline-bench COMMAND --json FILE"
        )
    files: list[Path] = []
    parts = ["# Records"]
    for name, record in records.items():
        parts += [f"## {name}", *_about(record)]
        figure = diagram_of(record["rows"])
        if figure is not None:
            files.append(save_diagram(figure, out / f"{name}.svg"))
            parts.append(f"![{name}](<{name}.svg>)")
        parts += [f"```text\n{text}\n```" for text in _tables(record)]
    write_whole(out / PAGE, "\n\n".join(parts) + "\n")
    return [*files, out / PAGE]


def _records_in(folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the records in a folder by the names of their files."""
    for path in sorted(folder.glob("*.json")):
        try:
            record = read_record(path)
        except InputError:
            continue
        if record["rows"]:
            yield path.stem, record


def _about(record: Mapping[str, Any]) -> Iterator[str]:
    """Yield how a record was measured, as far as it is known."""
    if command := record.get("command"):
        yield f"`{command}`"
    machine = record.get("machine") or {}
    words = [machine.get("date"), machine.get("processor"), machine.get("renderer")]
    if machine.get("cores"):
        words.insert(2, f"{machine['cores']} cores")
    if any(words):
        yield ", ".join(filter(None, words))


def _tables(record: Mapping[str, Any]) -> Iterator[str]:
    """Yield the tables of a record as its command prints them."""
    comparison = COMPARISONS.get(record["bench"])
    if comparison is None:
        yield table_text(record["rows"])
        return
    yield table_text(comparison.shown(record["rows"]), comparison.columns)
    if compared := record.get("summary", {}).get("against_equal"):
        yield table_text(compared, AGAINST_EQUAL)


def diagram_of(rows: Sequence[Row]) -> Figure | None:
    """Return the diagram of a record's rows; None where it has none."""
    columns = set().union(*rows)
    if columns >= _SPEED:
        return speed_diagram(rows)
    if columns >= _FOUND and len({row["renderings"] for row in rows}) > 1:
        return found_diagram({"": [(label, None, some) for label, some in _searched_alike(rows)]})
    return None


def _searched_alike(rows: Sequence[Row]) -> Iterator[tuple[str, list[Row]]]:
    """Yield rows that differ only in their stores, with what they share."""
    keys = ("matcher", "queries", "search")
    for alike in dict.fromkeys(tuple(row[key] for key in keys) for row in rows):
        some = [row for row in rows if tuple(row[key] for key in keys) == alike]
        yield " ".join(dict.fromkeys(word for word in alike if word != ALL)), some


def speed_diagram(rows: Sequence[Row]) -> Figure:
    """Return errors of skylines against milliseconds a viewpoint."""
    figure = Figure(figsize=(7.0, 4.4), layout="constrained")
    axis = figure.subplots()
    for path, (label, colour, marker) in _WAYS.items():
        mine = [row for row in rows if row["path"] == path and row.get("rms_px")]
        x = [row["ms_per_viewpoint"] for row in mine]
        y = [row["rms_px"] for row in mine]
        line = "-" if path in ("embree", "depth") else ""
        axis.plot(x, y, color=colour, marker=marker, label=label, linestyle=line)
    axis.set(xscale="log", yscale="log", xlabel="ms a viewpoint, all cores")
    axis.set_ylabel("rms error (px of 640 columns over 90°)")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="lower right")
    return figure


def found_diagram(
    panels: Mapping[str, Sequence[tuple[str, str | None, Sequence[Row]]]],
) -> Figure:
    """Return shares of queries found against renderings, uniform and adaptive.

    Each panel has a title and rows with a label and a colour; None takes the next colour.
    """
    figure = Figure(figsize=(4.0 * max(len(panels), 2), 4.2), layout="constrained")
    axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for axis, (title, some) in zip(axes, panels.items(), strict=True):
        for number, (label, colour, rows) in enumerate(some):
            _draw_found(axis, label, colour or f"C{number}", rows)
        axis.set(xscale="log", xlabel="renderings, or four a place", ylim=(0.0, 1.0))
        axis.set_title(title, fontsize=10)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.15))
    axes[0].set_ylabel("queries found within 200 m")
    return figure


def _draw_found(axis: Axes, label: str, colour: str, rows: Sequence[Row]) -> None:
    kinds = ("uniform", "o--"), ("adaptive", "D-")
    for some, (kind, style) in zip(by_planner(rows), kinds, strict=True):
        if not some:
            continue
        share, *ends = np.array([[row[key] for row in some] for key in _SHARES])
        x = [row["renderings"] for row in some]
        off = np.abs(np.array(ends) - share)
        about = f"{some[0]['n']} {some[0]['queries']} queries, {some[0]['km2']:,.0f} km²"
        axis.errorbar(
            x,
            share,
            off,
            fmt=style,
            color=colour,
            label=f"{label}, {kind}: {about}",
            capsize=2,
        )


def save_diagram(figure: Figure, path: Path) -> Path:
    """Write a diagram as SVG; return its path.

    Without dates and random names a picture changes only with its record.
    """
    with matplotlib.rc_context({"svg.hashsalt": "skyline", "svg.fonttype": "none"}):
        figure.savefig(path, metadata={"Date": None})
    return path
