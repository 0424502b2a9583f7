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

PAPER = {
    "rov": ((240, 1545), (81, 6664), (239, 9028)),
    "arov": ((286, 1636), (80, 5824), (217, 6991)),
    "hov": ((324, 1210), (98, 6723), (252, 7226)),
    "sov": ((275, 1941), (100, 10043), (245, 9148)),
    "lpov": ((325, 1515), (86, 5489), (191, 5943)),
}
"""(A) and (B) of the paper's Table 1, row by row."""


def measure(seeds: int = SEEDS) -> list[dict[str, Any]]:
    """Run the strategies on the three rows, each with seeds 0, 1, ...

    Returns
    -------
    list of dict
        One for each row and strategy: ``row``, ``strategy``, means over seeds of ``A``, ``B``,
        ``mean_area`` (of the views rendered), ``seconds`` (processor time) and ``coverage``
        (reached), standard deviations ``A_std``, ``B_std``, ``mean_area_std``, ``seconds_std``,
        and ``bound``, ``asked * 10000 / mean_area``.
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

    def column(row: int, figure: str) -> dict[str, float]:
        return {name: by_key[row, name][figure] for name in PAPER}

    a_1, a_2, a_3 = (column(row, "A") for row in (1, 2, 3))
    b_1, b_2, b_3 = (column(row, "B") for row in (1, 2, 3))
    seconds = {name: sum(column(row, "seconds")[name] for row in (1, 2, 3)) for name in PAPER}
    return {
        "affine needs fewer renderings than non-affine": all(
            max(a_2[name], a_3[name]) < a_1[name] for name in PAPER
        ),
        "affine overlaps more than non-affine": all(
            min(b_2[name], b_3[name]) > b_1[name] for name in PAPER
        ),
        "more peaks, more renderings": all(a_3[name] > a_2[name] for name in PAPER),
        "lpov is best for two peaks": min(a_3, key=lambda name: a_3[name]) == "lpov",
        "lpov overlaps least with the affine model": all(
            min(b, key=lambda name: b[name]) == "lpov" for b in (b_2, b_3)
        ),
        "sov overlaps most": all(
            max(b, key=lambda name: b[name]) == "sov" for b in (b_1, b_2, b_3)
        ),
        "rov costs most": max(seconds, key=lambda name: seconds[name]) == "rov",
        "hov costs least": min(seconds, key=lambda name: seconds[name]) == "hov",
    }
