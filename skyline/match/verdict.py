"""The verdict on a match: how sure, or why refused.

All reasons for having no answer are here, in the order in which they are checked:

1. `too_little`, before the search: the photo shows too little skyline.
2. `Verdict.of_search`, `Verdict.of_joint_search` and `Verdict.of_fit`, after a search of one photo,
   a search of several, and a fit without a search. A heading at a known place is judged by
   `refusal_of`, with the doubts that `skyline.orientation.orienter` has.

A pose is refused for lack of confidence before it is refused for its field of view. If the photo
may have another projection, the refusal says that as well, since it may be the cause.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from skyline.geodesy.bounds import distance_in_words
from skyline.match.config import MatchConfig
from skyline.match.other_projection import OtherProjection
from skyline.match.rays import FOV_RANGE_DEG, Rays
from skyline.match.solver import TEMPERATURE
from skyline.photo.skyline import PhotoSkyline
from skyline.pose.pose import RIGHT_WITHIN_M, ROUGHLY_WITHIN_M, SAME_VIEW_DEG, Pose


@dataclass(frozen=True, slots=True)
class _Limits:
    """Limits beyond which there is no answer, or a hint is given."""

    min_visible_deg: float = 14.0
    """Least width of a skyline. Screening compares rises over 2 degrees, and a pose has seven
    unknowns: below 14 degrees there are fewer rises than unknowns."""
    near_slope_m: float = 150.0
    """Skylines whose harmonic mean distance is less than this are not enough for half of the
    photos: wrong slopes fit as well (docs/accuracy.md)."""
    at_bound_share: float = 1e-3
    """A field of view counts as at an end of the searched range if its distance from the end is
    less than this share of the range: a fit held at a bound may differ from it by rounding."""
    unexpected_lens_sds: float = 2.0
    """Fields of view less likely than this many standard deviations are called unexpected."""
    least_of_fit: float = 0.7
    """Least share of right poses among those that fit like a given one. The share is learned from
    the best poses of searches; a pose that a person gives is right more often."""


_LIMITS = _Limits()


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the best pose is the answer, and how sure."""

    refusal: str | None = None
    """Why the pose is not the answer; None if it is."""
    within_m: float | None = None
    """Distance within which the answer is sure to be right, 200 or 1000 m. None without an answer.
    """

    @classmethod
    def of_search(
        cls,
        candidates: Sequence[Pose],
        other: OtherProjection | None,
        config: MatchConfig,
        skyline: PhotoSkyline,
        rays: Rays,
    ) -> "Verdict":
        """Return the verdict on a photo's candidates, best first.

        ``other`` is the likeliest other projection of the photo, if any is known.
        """
        if not candidates:
            return cls("no place fits")
        doubts = [_lack_of_confidence(candidates, config)]
        best = candidates[0]
        unjudged = None
        if best.confidence is None and config.min_confidence > 0.0:
            unjudged = (
                "the matcher estimates no confidence, so the best place is not judged; look at its "
                "skyline in a report, or use the full matcher"
            )
        refusal = refusal_of(best, skyline, rays, doubts=doubts, ambiguity=unjudged, other=other)
        return cls._on(best, refusal, config)

    @classmethod
    def of_joint_search(
        cls,
        candidates: Sequence[Sequence[Pose]],
        others: Iterable[tuple[str, OtherProjection | None]],
        config: MatchConfig,
    ) -> "Verdict":
        """Return the verdict on the common places of the photos that agree.

        ``candidates`` has the poses of each photo at these places, best first, and ``others`` the
        photo's name and its likeliest other projection; they are computed only if nothing else
        speaks against the places.
        """
        if len(candidates) < 2:
            return cls("fewer than two photos agree on a place")
        best = candidates[0][0]
        bent = (
            f"{name or 'a photo'}: {other.in_words}"
            for name, other in others
            if other is not None and other.is_likely
        )
        refusal = _lack_of_confidence(candidates[0], config) or next(bent, None)
        return cls._on(best, refusal, config)

    @classmethod
    def of_fit(cls, fitted: Pose | None, answer: Pose | None, config: MatchConfig) -> "Verdict":
        """Return the verdict on a fit that reached no candidate.

        The fit has failed if the answer of the search fits better, or if poses that fit as badly
        are seldom right. The confidence of ``fitted`` comes from the models named
        `skyline.match.confidence.FITTED`.
        """
        if fitted is None:
            return cls("nothing near this pose fits")
        if answer is not None and answer.cost <= fitted.cost:
            away = distance_in_words(answer.distance_m(fitted))
            turn_deg = answer.turn_deg(fitted)
            if turn_deg > SAME_VIEW_DEG:
                away += f" and {turn_deg:.0f} degrees of heading"
            return cls(f"{fitted.residual_in_words}; {answer.name}, {away} away, fits better")
        sure = fitted.confidence_1km or 0.0
        least = min(_LIMITS.least_of_fit, config.min_confidence)
        if sure >= least:
            return cls()
        return cls(
            f"{fitted.residual_in_words}; of poses that fit like this {100.0 * sure:.0f} % are "
            f"right, and {100.0 * least:.0f} % are needed"
        )

    @classmethod
    def _on(cls, best: Pose, refusal: str | None, config: MatchConfig) -> "Verdict":
        """Return the verdict on a pose: the answer, unless refused."""
        return cls(refusal, None if refusal else _sure_within_m(best, config))


def too_little(skyline: PhotoSkyline) -> str | None:
    """Return the refusal of a photo with too little skyline, or None."""
    widest_deg = FOV_RANGE_DEG[1] if skyline.fov_deg is None else skyline.fov_deg
    if skyline.lens is not None and skyline.lens.most_fov_deg is not None:
        widest_deg = skyline.lens.most_fov_deg
    visible_deg = skyline.with_fov(widest_deg).visible_deg()
    if visible_deg >= _LIMITS.min_visible_deg:
        return None
    return (
        f"{visible_deg:.1f} degrees of skyline are visible, {_LIMITS.min_visible_deg:g} are "
        "needed; correct the skyline by a trace or a mask, or check the field of view"
    )


def refusal_of(
    best: Pose,
    skyline: PhotoSkyline,
    rays: Rays,
    *,
    doubts: Sequence[str | None] = (),
    ambiguity: str | None = None,
    other: OtherProjection | None = None,
) -> str | None:
    """Return why the best pose is refused; None if it is trusted.

    Parameters
    ----------
    best : Pose
    skyline : PhotoSkyline
        The photo's skyline, with the field of view that was expected.
    rays : Rays
        Its rays, with the fields of view that were searched.
    doubts : sequence of str or None
        What speaks against the pose. The first that is not None counts, with a hint if the pose's
        field of view is far from the one expected.
    ambiguity : str, optional
        What speaks against the pose if nothing else does.
    other : OtherProjection, optional
        Another projection of the photo, which is named beside any other reason if it is likely.
    """
    doubt = next((one for one in doubts if one is not None), None)
    if doubt is None:
        refusal = _fov_at_bound(best, rays) or ambiguity
    else:
        refusal = doubt + _fov_hint(best, skyline, rays)
    if other is None or not other.is_likely:
        return refusal
    return other.in_words if refusal is None else f"{refusal}; {other.in_words}"


def candidate_reached(candidates: Sequence[Pose], start: Pose, fitted: Pose | None) -> Pose | None:
    """Return the candidate to which a fit has led, or None.

    The fit leads to the nearest candidate that is the same answer as its pose, or back to the
    candidate that it started from, whichever fits better. A pose that fits better than both
    replaces the nearest candidate, and gets its rank and its confidences, which belong to the
    answer. A pose that also fits better than the best candidate can replace only that one: any
    other answer that fits so well is one that the search did not know.

    Costs can be compared, since a fit ends with the rays and the prior of the search. The pose
    fits better than a candidate if the odds are e to 1 or more.
    """

    def nearest(pose: Pose) -> Pose | None:
        alike = filter(pose.is_same_answer, candidates)
        return min(alike, key=pose.distance_m, default=None)

    left = nearest(start)
    if fitted is None:
        return left
    near = nearest(fitted)
    as_good = [one for one in (near, left) if one and one.cost < fitted.cost + TEMPERATURE]
    if as_good:
        return min(as_good, key=lambda one: one.cost)
    if near is None or (near is not candidates[0] and fitted.cost < candidates[0].cost):
        return None
    return replace(
        fitted,
        rank=near.rank,
        confidence=near.confidence,
        confidence_1km=near.confidence_1km,
    )


def _sure_within_m(best: Pose, config: MatchConfig) -> float | None:
    """Return the distance within which a pose is surely right.

    It is 200 or 1000 m, or None. An answer within 200 m may leave half the doubt that an answer
    within 1 km may leave, and the pose's radius may not exceed 200 m: a wrong answer is worse than
    a vague one.
    """
    doubt = 1 - config.min_confidence
    if best.confidence is None or best.confidence_1km is None:
        return None
    if best.confidence >= 1.0 - 0.5 * doubt and (best.radius_m or 0.0) <= RIGHT_WITHIN_M:
        return RIGHT_WITHIN_M
    return ROUGHLY_WITHIN_M if best.confidence_1km >= 1.0 - doubt else None


def confidence_in_words(sure: float) -> str:
    """Return a confidence in words, rounded down: 0.796 is less than 0.80."""
    return f"{math.floor(100.0 * sure) / 100.0:.2f}"


def _lack_of_confidence(candidates: Sequence[Pose], config: MatchConfig) -> str | None:
    """Return the refusal of a best candidate that is unsure, or None."""
    best = candidates[0]
    if best.confidence is None or _sure_within_m(best, config) is not None:
        return None
    sure = confidence_in_words(best.confidence_1km or 0.0)
    return (
        f"the best place has a confidence of {sure} within 1 km, and {config.min_confidence:.2f} "
        "is needed" + _slope_hint(candidates)
    )


def _slope_hint(candidates: Sequence[Pose]) -> str:
    """Return a hint if most candidates have a near slope; else empty."""
    distances_m = [one.skyline_m for one in candidates if one.skyline_m is not None]
    near = [distance for distance in distances_m if distance < _LIMITS.near_slope_m]
    if len(near) < max(2, len(candidates) // 2 + 1):
        return ""
    return (
        f"; the skyline is a slope {min(near):.0f} to {max(near):.0f} m away, and {len(near)} "
        "places have a slope like it: a photo that shows farther ridges says more"
    )


def _fov_hint(best: Pose, skyline: PhotoSkyline, rays: Rays) -> str:
    """Return a hint if a field of view is unexpected; else empty."""
    expected_deg = skyline.fov_deg
    if expected_deg is None:
        return ""
    if rays.lens.deviations(rays.log_scale(best.fov_deg)) < _LIMITS.unexpected_lens_sds:
        return ""
    return (
        f"; the best pose has a field of view of {best.fov_deg:.1f} degrees, and "
        f"{expected_deg:.1f} was expected: check that"
    )


def _fov_at_bound(best: Pose, rays: Rays) -> str | None:
    """Return the refusal of a field of view at a bound."""
    low_deg, high_deg = rays.fov_bounds_deg
    near_deg = _LIMITS.at_bound_share * (high_deg - low_deg)
    if low_deg == high_deg or low_deg + near_deg < best.fov_deg < high_deg - near_deg:
        return None
    return (
        f"the best place needs a field of view of {best.fov_deg:.1f} degrees, and {low_deg:.1f} to "
        f"{high_deg:.1f} were searched; give another one (--fov-deg)"
    )
