"""One query and what was found for it, as reports and exports take it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.matching.ranking import Candidate
from skyline.photo.query import QuerySkyline


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """One query and what was found for it.

    Attributes
    ----------
    name : str
        What the user calls the query: its file.
    candidates : sequence of Candidate
        Best first.
    is_answered : bool
        Whether the best candidate is given as the answer.
    photo : (H, W, 3) uint8, optional
        RGB, of the query's size; None for a trace or a mask.
    done : sequence of str
        What was done to find it, a sentence each.
    within_m : float, optional
        How near the answer is sure to be.
    """

    name: str
    query: QuerySkyline
    candidates: Sequence[Candidate]
    seconds: float
    is_answered: bool = True
    photo: NDArray[np.uint8] | None = None
    done: Sequence[str] = ()
    within_m: float | None = None
