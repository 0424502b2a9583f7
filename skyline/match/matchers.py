"""The matchers by name: each is one class, which says what it can do, and one line here."""

from collections.abc import Mapping
from pkgutil import resolve_name
from types import MappingProxyType
from typing import cast

from skyline.errors import InputError, named
from skyline.match.ranker import Ranker

FULL = "full"

MATCHERS: Mapping[str, str] = MappingProxyType(
    {
        FULL: "skyline.match.full:FullMatcher",
        "paper": "skyline.paper.matcher:PaperMatcher",
        "correlation": "skyline.match.correlation:CorrelationMatcher",
    }
)
"""Where the class of each matcher is: ours, the paper's, the plain baseline. A class is imported
when it is asked for, so that a matcher may stand above the matching that it is made of."""


def matcher_class(name: str) -> type[Ranker]:
    """Return the matcher of a name; raises `InputError` for a name that is not known."""
    return cast(type[Ranker], resolve_name(named("matcher", name, MATCHERS)))


def check_narrows(matcher: Ranker) -> None:
    """Raise `InputError` for a matcher that cannot narrow its search."""
    if not matcher.narrows:
        raise InputError(f"only the {FULL} matcher can narrow its search; leave it wide")
