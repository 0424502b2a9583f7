"""The registry of matchers: each is one class, which says what it can, and one line here."""

from collections.abc import Mapping
from types import MappingProxyType

from skyline.errors import InputError
from skyline.matching.correlation import CorrelationMatcher
from skyline.matching.full import FullMatcher
from skyline.matching.ranker import Ranker
from skyline.paper.matcher import PaperMatcher

FULL = "full"

MATCHERS: Mapping[str, type[Ranker]] = MappingProxyType(
    {FULL: FullMatcher, "paper": PaperMatcher, "correlation": CorrelationMatcher}
)
"""Matchers by the name the command line gives them: ours, the paper's, the plain baseline."""


def check_narrows(matcher: Ranker) -> None:
    """Raise `InputError` for a matcher that cannot narrow its search."""
    if not matcher.narrows:
        able = " and ".join(name for name, one in MATCHERS.items() if one.narrows)
        raise InputError(f"only the {able} matcher can narrow its search; leave it wide")
