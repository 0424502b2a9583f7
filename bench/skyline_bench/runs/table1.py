"""The paper's Table 1: strategies compared on the simulation of section 5.1.

What is compared is (A), the viewpoints rendered, corners included, and (B), the overlap: all
inclusions in tolerance areas less the locations covered. No strategy can do with fewer viewpoints
than the locations to cover over the mean area of its views; ``bound`` is that number.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from skyline.errors import InputError
from skyline.paper.planning.strategies import STRATEGIES
from skyline_bench.truth.simulation import TABLE_1, Run, Simulation, simulate

SEEDS = 10


def measure(seeds: int = SEEDS) -> list[dict[str, Any]]:
    """Run the strategies on the three rows, each with seeds 0, 1, ...

    Return for each row and strategy: ``row``, ``strategy``, means over seeds of ``A``, ``B``,
    ``mean_area`` (of the views rendered), ``seconds`` (processor time) and ``coverage`` (reached),
    standard deviations ``A_std``, ``B_std``, ``mean_area_std``, ``seconds_std``, and ``bound``,
    ``asked * 10000 / mean_area``.
    """
    if seeds < 1:
        raise InputError(f"seeds is {seeds}; expected at least 1")
    rows = []
    for number, row in enumerate(TABLE_1, start=1):
        simulation = Simulation(row)
        for name, strategy in STRATEGIES.items():
            runs = [simulate(simulation, strategy, seed) for seed in range(seeds)]
            measured = _summary(runs)
            bound = row.coverage * simulation.grid.valid.size / measured["mean_area"]
            rows.append({"row": number, "strategy": name, **measured, "bound": bound})
    return rows


def _summary(runs: Sequence[Run]) -> dict[str, float]:
    figures: dict[str, list[float]] = {
        "A": [len(run.coverage.viewpoints) for run in runs],
        "B": [run.coverage.overlap for run in runs],
        "mean_area": [
            np.count_nonzero(run.coverage.areas) / len(run.coverage.areas) for run in runs
        ],
        "seconds": [run.seconds for run in runs],
    }
    summary = {name: float(np.mean(values)) for name, values in figures.items()}
    summary |= {f"{name}_std": float(np.std(values)) for name, values in figures.items()}
    summary["coverage"] = float(np.mean([run.coverage.fraction() for run in runs]))
    return summary


def conclusions(rows: Iterable[dict[str, Any]]) -> dict[str, bool]:
    """Return which of the paper's conclusions (section 5.1) hold for its five strategies."""
    by_key = {(row["row"], row["strategy"]): row for row in rows}
    names = np.array(list(STRATEGIES))
    a, b, seconds = (
        np.array([[by_key[row, name][figure] for name in names] for row in (1, 2, 3)])
        for figure in ("A", "B", "seconds")
    )
    holds = {
        "affine needs fewer renderings than non-affine": a[1:].max(axis=0) < a[0],
        "affine overlaps more than non-affine": b[1:].min(axis=0) > b[0],
        "more peaks, more renderings": a[2] > a[1],
        "lpov is best for two peaks": names[a[2].argmin()] == "lpov",
        "lpov overlaps least with the affine model": names[b[1:].argmin(axis=1)] == "lpov",
        "sov overlaps most": names[b.argmax(axis=1)] == "sov",
        "rov costs most": names[seconds.sum(axis=0).argmax()] == "rov",
        "hov costs least": names[seconds.sum(axis=0).argmin()] == "hov",
    }
    return {said: bool(np.all(each)) for said, each in holds.items()}
