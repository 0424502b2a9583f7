"""When a match is no answer, and how near an answer is sure to be."""

from collections.abc import Sequence

from skyline.match.matchers import MIN_VISIBLE_DEG, MatchConfig
from skyline.match.query_rays import QueryRays
from skyline.match.ranking import DISTANCES_M, Candidate
from skyline.match.records import apart_in_words
from skyline.photo.query import QuerySkyline

DISAGREES = "the photo does not fit where the others were taken"

_AT_BOUND_SHARE = 1e-3
"""Of the range searched: a fit is held to its bound but for rounding."""


def too_little(query: QuerySkyline, config: MatchConfig) -> str | None:
    """Say why a query shows too little of a skyline to be matched, if so."""
    widest_deg = config.fov_range_deg[1] if query.fov_deg is None else query.fov_deg
    if query.lens is not None and query.lens.most_deg is not None:
        widest_deg = query.lens.most_deg
    visible_deg = query.visible_deg(widest_deg)
    if visible_deg >= MIN_VISIBLE_DEG:
        return None
    return (
        f"{visible_deg:.1f} degrees of skyline are visible, {MIN_VISIBLE_DEG:g} are needed; "
        "correct the skyline by a trace or a mask, or check the field of view"
    )


def unsure(candidates: Sequence[Candidate], config: MatchConfig) -> str | None:
    """Say why candidates are no answer, if so."""
    if not candidates:
        return "no place fits"
    best, least = candidates[0], config.min_confidence
    if best.confidence is None or sure_within_m(best, config) is not None:
        return None
    return (
        f"the best place has confidence {best.confidence:.2f}, within 1 km "
        f"{best.confidence_1km:.2f}; {least:.2f} is needed"
    )


def misfit(fitted: Candidate, config: MatchConfig) -> str | None:
    """Say why a fit has failed, if so: no search would stand by its pose, though it had no rival.

    The confidence of ``fitted`` is what a search would give it if nothing else fitted.
    """
    if sure_within_m(fitted, config) is not None:
        return None
    return (
        f"{apart_in_words(fitted)}; even if nothing else fitted, the confidence would be "
        f"{fitted.confidence:.2f}, within 1 km {fitted.confidence_1km:.2f}, and "
        f"{config.min_confidence:.2f} is needed"
    )


def lens_in_doubt(candidates: Sequence[Candidate], query: QuerySkyline, rays: QueryRays) -> str:
    """Say that the best candidate needs another lens than the query's; empty where it does not."""
    if not candidates or query.fov_deg is None:
        return ""
    found_deg = candidates[0].fov_deg
    if abs(found_deg - query.fov_deg) < 2.0 * rays.fov_sd_deg:
        return ""
    return (
        f"; it has a field of view of {found_deg:.1f} degrees, and {query.fov_deg:.1f} was given: "
        "check that"
    )


def sure_within_m(candidate: Candidate, config: MatchConfig) -> float | None:
    """Return the distance within which a candidate is sure enough to be right; None where none.

    The nearer distance takes half the doubt that the farther one may leave: saying it wrongly is
    worse than saying less.
    """
    doubt = 1.0 - config.min_confidence
    sure = (candidate.confidence, 1.0 - 0.5 * doubt), (candidate.confidence_1km, 1.0 - doubt)
    for within_m, (confidence, least) in zip(DISTANCES_M, sure, strict=True):
        if confidence is not None and confidence >= least:
            return within_m
    return None


def at_bound(candidates: Sequence[Candidate], rays: QueryRays) -> str | None:
    """Say that the field of view of the best candidate is the least or greatest searched, if so."""
    low_deg, high_deg = rays.fov_bounds_deg
    found_deg, near_deg = candidates[0].fov_deg, _AT_BOUND_SHARE * (high_deg - low_deg)
    if low_deg == high_deg or low_deg + near_deg < found_deg < high_deg - near_deg:
        return None
    return (
        f"the best place needs a field of view of {found_deg:.1f} degrees, and {low_deg:.1f} to "
        f"{high_deg:.1f} were searched; give another one (--fov-deg)"
    )
