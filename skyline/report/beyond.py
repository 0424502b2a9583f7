"""What is said of skylines that terrain past the elevation model's edge may make."""

from collections.abc import Sequence

from skyline.matching.ranking import Candidate

_WORTH_SAYING = 0.1
"""Part of a skyline below which nothing is said."""


def beyond_said(candidates: Sequence[Candidate]) -> str | None:
    """Return how much of the skyline at the first candidate may be of terrain the model lacks."""
    return beyond_in_words(candidates[0].beyond_share if candidates else None)


def beyond_in_words(share: float | None) -> str | None:
    """Return the same of a share of the skyline; None where it is not known, or small."""
    if share is None or share < _WORTH_SAYING:
        return None
    return (
        f"{100.0 * share:.0f} % of the skyline may be of terrain beyond the elevation model's "
        "edge; a model that reaches farther may give another answer"
    )
