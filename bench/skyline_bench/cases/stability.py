"""``skyline-bench stability``: every hard case, its error, its bound and a verdict."""

from collections.abc import Sequence
from typing import Protocol, TypedDict

import numpy as np

from skyline_bench.cases.frames import FRAME_CASES
from skyline_bench.cases.near import GRID_CASES, STEEP_CASES
from skyline_bench.cases.same import SAME_CASES
from skyline_bench.cases.wide import WIDE_CASES
from skyline_bench.truth.agreement import Agreement, RenderPath


class HardCase(Protocol):
    """One way in which a renderer could break."""

    @property
    def name(self) -> str:
        """A few words, unique."""
        ...

    @property
    def breaks(self) -> str:
        """What could break, one sentence."""
        ...

    @property
    def paths(self) -> tuple[str, ...]:
        """Names of the paths that promise something here."""
        ...

    def agreement(self, path: RenderPath, quick: bool) -> Agreement:
        """Render along a path and compare; ``quick`` takes a few viewpoints only."""
        ...


class Row(TypedDict):
    """One case along one path.

    ``error_px`` is the greatest error and ``bound_px`` what is allowed in that column; where a
    column is over its bound, they are those of the column that is furthest over.
    """

    case: str
    path: str
    error_px: float
    bound_px: float
    flags_agree: bool
    ok: bool
    what: str


HARD_CASES: tuple[HardCase, ...] = (
    *GRID_CASES,
    *STEEP_CASES,
    *WIDE_CASES,
    *FRAME_CASES,
    *SAME_CASES,
)


def measure(
    path: RenderPath, quick: bool = False, cases: Sequence[HardCase] = HARD_CASES
) -> list[Row]:
    """Run the hard cases that a path promises something for.

    Parameters
    ----------
    quick : bool
        Take the first two viewpoints of each scene only.

    Returns
    -------
    list of Row, one a case, in order
    """
    return [_row(case, path, quick) for case in cases if path.name in case.paths]


def _row(case: HardCase, path: RenderPath, quick: bool) -> Row:
    agreement = case.agreement(path, quick)
    error, bound = agreement.error_px, agreement.bound_px
    over = error > bound
    score = np.where(over, error - bound, -np.inf) if over.any() else error
    worst = np.unravel_index(np.argmax(score), score.shape)
    return Row(
        case=case.name,
        path=path.name,
        error_px=float(error[worst]),
        bound_px=float(bound[worst]),
        flags_agree=bool(agreement.flags_agree.all()),
        ok=agreement.holds,
        what=case.breaks,
    )
