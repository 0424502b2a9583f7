"""``skyline-bench stability``: every hard case, its error, its bound and a verdict."""

from collections.abc import Sequence

import numpy as np

from skyline_bench.cases.closed_forms import SceneCase
from skyline_bench.cases.frames import FRAME_CASES
from skyline_bench.cases.near import GRID_CASES, STEEP_CASES
from skyline_bench.cases.same import SAME_CASES, RefusalCase, RepeatCase, TurnCase
from skyline_bench.cases.wide import WIDE_CASES
from skyline_bench.measuring.record import Row
from skyline_bench.truth.agreement import RenderPath

HardCase = SceneCase | RepeatCase | TurnCase | RefusalCase
HARD_CASES: tuple[HardCase, ...] = (
    *GRID_CASES, *STEEP_CASES, *WIDE_CASES, *FRAME_CASES, *SAME_CASES,
)  # fmt: skip


def measure(
    path: RenderPath, quick: bool = False, cases: Sequence[HardCase] = HARD_CASES
) -> list[Row]:
    """Return a row for each hard case that a path promises something for.

    ``error_px`` is the greatest error and ``bound_px`` what is allowed in that column; where a
    column is over its bound, they are those of the column that is furthest over. ``quick`` takes
    the first two viewpoints of each scene only.
    """
    rows: list[Row] = []
    for case in cases:
        if path.name in case.paths:
            agreement = case.agreement(path, quick)
            error, bound = agreement.error_px, agreement.bound_px
            over = error > bound
            score = np.where(over, error - bound, -np.inf) if over.any() else error
            worst = np.unravel_index(np.argmax(score), score.shape)
            rows.append(
                {
                    "case": case.name,
                    "path": path.name,
                    "error_px": float(error[worst]),
                    "bound_px": float(bound[worst]),
                    "flags_agree": bool(agreement.flags_agree.all()),
                    "ok": agreement.holds,
                    "what": case.breaks,
                }
            )
    return rows
