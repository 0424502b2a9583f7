r"""Confidence: the probability that a pose is right, and the reason why a low one is refused.

A pose is right if it lies within 200 m of the truth, or roughly right within 1 km, and looks the
same way, within 30 degrees.

It is a logistic model of figures that a match gives and of their products, learned from synthetic
queries on terrain for which no result is reported (``python -m skyline_training confidence``, which
also draws the reliability diagram):

.. math::

    P = \frac{1}{1 + \exp(-(b + \sum_f w_f u_f + \sum_{f \le g} w_{fg} u_f u_g))}, \quad
    u_f = (x_f - m_f) / s_f

Such a form has the odds between two normal distributions of the figures, of right poses and of
wrong ones, each with its own covariance. The :math:`u_f` are held within 4. Models of fits without
a search and of headings have no products.

The figures describe how well the best pose fits, its margin over all other answers, how unusual its
camera is, and how much skyline there was to fit: a fit to too little of a skyline is never trusted.
The camera's tilt is not a figure, since synthetic queries tilt less than photos do.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources

import numpy as np

from skyline.arrays import BoolArray, Float64Array
from skyline.camera import level
from skyline.errors import InputError
from skyline.geodesy import distance_in_words
from skyline.match.rays import FOV_RANGE_DEG, Rays
from skyline.match.solver import TEMPERATURE
from skyline.photo.skyline import PhotoSkyline
from skyline.pose import (
    DISTANCES_M,
    RIGHT_WITHIN_M,
    ROUGHLY_WITHIN_M,
    SAME_VIEW_DEG,
    Pose,
    Poses,
)

_MAX_MARGIN = 60.0
"""Cap of margins. Models learned with caps of up to 1,000 are no better, since queries from other
regions can reach a margin of 124."""
_LEARNED_EXTENT_M = 8_500.0
"""Greatest distance in the smallest areas that the models learned from, squares of 6 km. A narrower
search meets fewer rivals, as the square of its extent; its odds are divided by the same factor."""
_MIN_MARGIN = 1e-3
_LEAST_WEIGHT = 1e-9
"""Least likelihood, as a share of the best pose's: odds are no greater than its inverse."""
_MOST_VISIBLE_DEG = 90.0
"""Cap of the visible skyline: the model is learned from photos, and a panorama counts as a wide
one."""
_MOST_LENS_DEVIATIONS = 4.0
_MOST_DEVIATIONS = 4.0
"""Cap of each figure's distance from its mean, in standard deviations: few examples lie beyond, and
a product grows with the square."""
_LENS_SD_RANGE = 0.03, 0.3
"""Standard deviations of a lens's scale that the models learned from: a field of view that is known
within 5 %, and one that is not known."""
_MIN_VISIBLE_DEG = 14.0
"""Least width of a skyline for an answer. Screening compares rises over 2 degrees, and a pose has
seven unknowns: below 14 degrees there are fewer rises than unknowns."""
_NEAR_SLOPE_M = 150.0
"""Skylines nearer than this, by their harmonic mean distance, do not suffice in half of the
photos: wrong slopes fit as well (docs/accuracy.md)."""
_AT_BOUND_SHARE = 1e-3
"""A field of view counts as at an end of the searched range if its distance from the end is less
than this share of the range: a fit held at a bound may differ from it by rounding."""
_LEAST_OF_FIT = 0.75
"""Least share of right ones among poses that fit like a given one. The share is that of the best
poses of searches; a pose that a person gives is right more often."""
FITTED = "fitted"
"""Stage of poses that were fitted without a search. Its models, of `pose_figures` alone and without
products, are learned from the best poses of searches. A pose set by hand can be unlike all of
these, where products mislead: a residual of 1.4 degrees would be trusted."""
ORIENTED = "oriented, 1 degree"
"""Name of the model of headings at a known place, in ``orientation.json``."""


@dataclass(frozen=True, slots=True)
class MatchConfig:
    """Settings of a match.

    Attributes
    ----------
    refine : bool
        Whether the full matcher refines the retrieved poses by rendering.
    min_confidence : float
        The best place is the answer if it is right within 1 km with at least this probability, 0 to
        1. The answer is stated to 200 m if the probability of an error above 200 m is at
        most half of what is allowed for 1 km: with the default, if it is right with a probability
        of 0.9. Of the 255 queries of terrain held out from learning that reached 0.8 within 1 km,
        245 were right; docs/accuracy.md says how hard those are.
    fov_sd_share : float
        Standard deviation of a given field of view, as a share of it, 0 to 1.

    Raises
    ------
    InputError
        A value is out of its range.
    """

    refine: bool = True
    min_confidence: float = 0.8
    fov_sd_share: float = 0.025

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_confidence <= 1.0:
            raise InputError(
                f"least confidence is {self.min_confidence}; expected 0 (always answer) to 1"
            )
        if not 0.0 <= self.fov_sd_share < 1.0:
            raise InputError(f"fov_sd_share is {self.fov_sd_share}; expected a share from 0 to 1")


@dataclass(frozen=True, slots=True)
class Logistic:
    """A logistic model of F figures and their products."""

    names: Sequence[str]
    mean: Sequence[float]
    scale: Sequence[float]
    """``names``, ``mean``, ``scale``: F each."""
    weight: Sequence[float]
    """In the order of `terms`; F alone for a model without products."""
    bias: float

    def terms(self, figures: Mapping[str, Float64Array]) -> Float64Array:
        """Return the terms (M, F (F + 3) / 2) of figures (M,) by name: figures, then products.

        Figures are in standard deviations from their means. A missing one counts as its mean.
        """
        count = len(next(iter(figures.values())))
        unit = np.zeros((count, len(self.names)))
        for column, (name, mean, scale) in enumerate(
            zip(self.names, self.mean, self.scale, strict=True)
        ):
            unit[:, column] = (figures.get(name, mean) - mean) / scale
        unit = np.clip(unit, -_MOST_DEVIATIONS, _MOST_DEVIATIONS)
        first, second = np.triu_indices(len(self.names))
        return np.hstack([unit, unit[:, first] * unit[:, second]])

    def probability(self, figures: Mapping[str, Float64Array]) -> Float64Array:
        """Return probabilities (M,) from figures (M,) by name; see `terms`."""
        logit = self.bias + self.terms(figures)[:, : len(self.weight)] @ np.array(self.weight)
        return np.asarray(1.0 / (1.0 + np.exp(-np.clip(logit, -50.0, 50.0))))


def refined_figures(poses: Poses, found: Poses, query: Rays) -> dict[str, Float64Array]:
    """Return the figures (M,) of refined poses by name, with those of the best retrieved pose.

    The skyline of another region can be bent to fit some place well, but seldom resembles that
    place in retrieval; so the retrieval counts too. Rivals are more than 1 km away. In a
    narrow search no retrieved pose lies so far away, and rivals are more than 200 m away. If all
    retrieved poses are one place, there is no rival, and the odds are even.
    """
    retrieved, best = retrieved_figures(found, query), int(np.argmin(found.cost))
    widest_m = found.distances_m().max(initial=0.0)
    margin = log_odds = np.zeros(len(poses))
    if widest_m > ROUGHLY_WITHIN_M:
        margin, log_odds = poses.figures().far_margin, _log_odds(poses, ROUGHLY_WITHIN_M)
    elif widest_m > RIGHT_WITHIN_M:
        margin, log_odds = poses.figures().margin, _log_odds(poses, RIGHT_WITHIN_M)
    if widest_m > RIGHT_WITHIN_M:
        log_odds = log_odds - 2.0 * np.log(max(1.0, _LEARNED_EXTENT_M / widest_m))
    return pose_figures(poses, query) | {
        "log_odds": log_odds,
        "log_far_margin": _log_margin(margin),
        "retrieved_log_margin": np.full(len(poses), retrieved["log_margin"][best]),
        "retrieved_log_far_margin": np.full(len(poses), retrieved["log_far_margin"][best]),
    }


def oriented_figures(poses: Poses, query: Rays, moved_m: Float64Array) -> dict[str, Float64Array]:
    """Return the figures (M,) of poses at a known place, one for each heading, by name.

    The margin is over the best other heading; ``moved_m`` (M,) is how far the poses lie from the
    known place.
    """
    margin = poses.rival_margin(0.0, 0.0)
    figures = pose_figures(poses, query)
    # The place is known, and the model has seen no unknown field of view.
    del figures["log_position_sd"], figures["log_lens_sd"]
    return figures | {
        "margin": _margin(margin),
        "log_margin": _log_margin(margin),
        "log_heading_sd": np.log(np.maximum(poses.figures().angle_sd_deg[:, 0], 1e-2)),
        "log_moved": np.log(np.maximum(moved_m, 1.0)),
    }


def pose_figures(poses: Poses, query: Rays) -> dict[str, Float64Array]:
    """Return the figures (M,) of fitted poses by name, without any search; see `FITTED`."""
    fits = poses.figures()
    trace_m2 = np.trace(fits.covariance_m2, axis1=1, axis2=2)
    lens_off = np.abs(query.log_scale(poses.fov_deg)) / query.log_scale_sd
    figures = {
        "log_residual": np.log(np.maximum(fits.residual_deg, 1e-3)),
        "inlier_share": fits.terrain_share,
        "log_columns": np.log(np.maximum(fits.effective_columns, 1.0)),
        "log_position_sd": 0.5 * np.log(np.maximum(trace_m2, 1e-2)),
        "log_height_sd": np.log(np.maximum(fits.height_sd_m, 1e-2)),
        "lens_deviations": np.minimum(lens_off, _MOST_LENS_DEVIATIONS),
        "roll_deg": np.abs(poses.roll_deg),
    }
    return figures | _warp_figure(poses, query) | _query_figures(query, len(poses))


def _warp_figure(poses: Poses, query: Rays) -> dict[str, Float64Array]:
    """Return the rms (M,) of how poses warp the image, in standard deviations, by its name.

    It is the distortion of a lens, or the wander of a panorama; see `Rays.warp_sd`. A lens
    without distortion has no such figure.
    """
    if not len(query.warp_sd):
        return {}
    warp = poses.wander if poses.distortion is None else poses.distortion[:, np.newaxis]
    if warp is None:
        return {}
    rms = np.sqrt(np.mean((warp / query.warp_sd) ** 2, axis=1))
    return {"warp_deviations": np.minimum(rms, _MOST_LENS_DEVIATIONS)}


def _log_odds(poses: Poses, within_m: float) -> Float64Array:
    """Return the log odds (M,) of the poses near each one that look its way, against all others."""
    weight = _weights(poses)
    own = poses.are_same(within_m, SAME_VIEW_DEG) @ weight
    odds = (own + _LEAST_WEIGHT) / (weight.sum() - own + _LEAST_WEIGHT)
    return np.asarray(np.log(odds))


def _weights(poses: Poses) -> Float64Array:
    """Return the likelihoods (M,) of poses, as shares of the best one's."""
    return np.asarray(np.exp((poses.cost.min() - poses.cost) / TEMPERATURE))


def retrieved_figures(found: Poses, query: Rays) -> dict[str, Float64Array]:
    """Return the figures (M,) of retrieved poses by name."""
    margin = _margin_or(found, RIGHT_WITHIN_M, np.zeros(len(found)))
    far_margin = _margin_or(found, ROUGHLY_WITHIN_M, margin)
    return {
        "cost": found.cost,
        "margin": _margin(margin),
        "log_margin": _log_margin(margin),
        "log_far_margin": _log_margin(far_margin),
    } | _query_figures(query, len(found))


def model_name(stage: str, within_m: float) -> str:
    """Return the name of the model of a stage, refined, retrieved or fitted, for a distance."""
    return f"{stage}, {within_m:g} m"


def models(file: str = "confidence.json") -> dict[str, Logistic]:
    """Return the learned models of a packaged file by name; see `model_name`, `ORIENTED`."""
    text = resources.files(__package__).joinpath(file).read_text(encoding="utf-8")
    return {name: Logistic(**model) for name, model in json.loads(text)["models"].items()}


def shared_probabilities(
    learned: Mapping[str, Logistic], poses: Poses, figures: Mapping[str, Float64Array]
) -> tuple[Float64Array, Float64Array]:
    """Return the probabilities (M,) that refined poses are right within 200 m, and within 1 km.

    The models were learned from best poses, and hold for the best one alone. All poses within the
    distance that look the same way share the best pose's probability, and all other poses share
    the rest. Shares follow the costs, and the shares of neighbouring poses add up. An infinite
    cost has no share.
    """
    best = int(np.argmin(poses.cost))
    of_best = {name: values[best : best + 1] for name, values in figures.items()}
    weight = _weights(poses)
    near, roughly = (
        _shares(poses.are_same(within_m, SAME_VIEW_DEG), weight, best, float(sure[0]))
        for within_m, sure in zip(
            DISTANCES_M, probabilities(learned, "refined", of_best), strict=True
        )
    )
    return near, np.maximum(near, roughly)


def _shares(is_near: BoolArray, weight: Float64Array, best: int, sure: float) -> Float64Array:
    """Return each pose's part of a probability by the weights (M,) of the poses near it (M, M).

    No other answer gets more of the probability for its weight than the best one does.
    """
    own, others = weight * is_near[best], weight * ~is_near[best]
    worth = sure / own.sum()
    rest = (1.0 - sure) / max(others.sum(), np.finfo(float).tiny)
    return np.asarray(is_near @ own * worth + is_near @ others * min(worth, rest))


def probabilities(
    learned: Mapping[str, Logistic], stage: str, figures: Mapping[str, Float64Array]
) -> tuple[Float64Array, Float64Array]:
    """Return the probabilities (M,) that poses are right within 200 m, and within 1 km."""
    near, roughly = (
        learned[model_name(stage, within_m)].probability(figures) for within_m in DISTANCES_M
    )
    return near, np.maximum(near, roughly)


def _margin_or(found: Poses, least_m: float, otherwise: Float64Array) -> Float64Array:
    """Return the margin (M,) of each pose over rivals, or ``otherwise`` (M,) without any."""
    has_rivals = (found.distances_m() > least_m).any(axis=1)
    return np.where(has_rivals, found.rival_margin(least_m), otherwise)


def _query_figures(query: Rays, count: int) -> dict[str, Float64Array]:
    """Return the figures of the width and of the relief of the query's skyline, and of its lens."""
    azimuth, y = level(query.u, query.v, 0.0, 0.0, query.projection)
    # Relief is the deviation from a line: a pitch and a roll can explain the line.
    trend = np.polynomial.Polynomial.fit(azimuth, y, 1, w=np.sqrt(query.weight))
    relief = np.sqrt(np.average((y - trend(azimuth)) ** 2, weights=query.weight))
    visible_deg = np.degrees(np.ptp(azimuth))
    return {
        "log_relief": np.full(count, np.log(max(np.degrees(relief), 1e-2))),
        "log_visible": np.full(count, np.log(np.clip(visible_deg, 1.0, _MOST_VISIBLE_DEG))),
        "log_lens_sd": np.full(count, np.log(np.clip(query.log_scale_sd, *_LENS_SD_RANGE))),
    }


def _margin(margin: Float64Array) -> Float64Array:
    return np.asarray(np.clip(margin, -_MAX_MARGIN, _MAX_MARGIN))


def _log_margin(margin: Float64Array) -> Float64Array:
    return np.asarray(np.log(np.clip(margin, _MIN_MARGIN, _MAX_MARGIN)))


def too_little(query: PhotoSkyline) -> str | None:
    """Return the refusal of a query that shows too little skyline; None if it shows enough."""
    widest_deg = FOV_RANGE_DEG[1] if query.fov_deg is None else query.fov_deg
    if query.lens is not None and query.lens.most_fov_deg is not None:
        widest_deg = query.lens.most_fov_deg
    visible_deg = query.with_fov(widest_deg).visible_deg()
    if visible_deg >= _MIN_VISIBLE_DEG:
        return None
    return (
        f"{visible_deg:.1f} degrees of skyline are visible, {_MIN_VISIBLE_DEG:g} are needed; "
        "correct the skyline by a trace or a mask, or check the field of view"
    )


def refusal_of(
    candidates: Sequence[Pose], config: MatchConfig, query: PhotoSkyline, rays: Rays
) -> str | None:
    """Return why the best candidate of a search is not the answer; None if it is the answer."""
    refusal = unsure(candidates, config)
    if refusal is None:
        return at_bound(candidates[0], rays)
    return refusal + fov_hint(candidates[0], query, rays) if candidates else refusal


def fov_hint(pose: Pose, query: PhotoSkyline, rays: Rays) -> str:
    """Return a hint if a pose's field of view is far from the one expected; empty if it is not."""
    if query.fov_deg is None or abs(pose.fov_deg - query.fov_deg) < 2.0 * rays.fov_sd_deg:
        return ""
    return (
        f"; the best pose has a field of view of {pose.fov_deg:.1f} degrees, and "
        f"{query.fov_deg:.1f} was expected: check that"
    )


def unsure(candidates: Sequence[Pose], config: MatchConfig) -> str | None:
    """Return the refusal of a best candidate that is not sure enough; None if it is."""
    if not candidates:
        return "no place fits"
    best, least = candidates[0], config.min_confidence
    if best.confidence is None or sure_within_m(best, config) is not None:
        return None
    return (
        f"the best place has confidence {best.confidence:.2f}, within 1 km "
        f"{best.confidence_1km:.2f}; {least:.2f} is needed" + _of_a_slope(candidates)
    )


def _of_a_slope(candidates: Sequence[Pose]) -> str:
    """Return a hint if the skyline is a near slope that several candidates show; empty if not."""
    distances_m = [one.skyline_m for one in candidates if one.skyline_m is not None]
    near = [distance for distance in distances_m if distance < _NEAR_SLOPE_M]
    if len(near) < max(2, len(candidates) // 2 + 1):
        return ""
    return (
        f"; the skyline is a slope {min(near):.0f} to {max(near):.0f} m away, and {len(near)} "
        "places have a slope like it: a photo that shows farther ridges says more"
    )


def found_again(candidates: Sequence[Pose], start: Pose, fitted: Pose | None) -> Pose | None:
    """Return the candidate of a search to which a fit has led; None if it led elsewhere.

    The fit leads to the nearest candidate of the same answer, or back to the one that it started
    from, whichever fits better. A pose that fits better than both replaces the nearest candidate:
    it gets the rank and the confidences, which are of the answer. But where a pose fits better than
    all candidates, only the best one's answer can be its own; the search did not know of others.

    Scores compare, since a fit ends with the query and the prior of the search. Of two poses of one
    answer neither fits better if their odds are less than e to 1.
    """

    def nearest(pose: Pose) -> Pose | None:
        alike = filter(pose.is_same_answer, candidates)
        return min(alike, key=pose.distance_m, default=None)

    left = nearest(start)
    if fitted is None:
        return left
    near = nearest(fitted)
    standing = [one for one in (near, left) if one and one.cost < fitted.cost + TEMPERATURE]
    if standing:
        return min(standing, key=lambda one: one.cost)
    if near is None or (near is not candidates[0] and fitted.cost < candidates[0].cost):
        return None
    return replace(
        fitted,
        rank=near.rank,
        confidence=near.confidence,
        confidence_1km=near.confidence_1km,
    )


def misfit(fitted: Pose, config: MatchConfig, answer: Pose | None = None) -> str | None:
    """Return why a fit away from a search's candidates has failed; None if it has not.

    It has failed where the answer of the search fits better, and where poses that fit as badly are
    seldom right. The confidence of ``fitted`` is that of its stage, `FITTED`.
    """
    if answer is not None and answer.cost <= fitted.cost:
        away, turn_deg = distance_in_words(answer.distance_m(fitted)), answer.turn_deg(fitted)
        if turn_deg > SAME_VIEW_DEG:
            away += f" and {turn_deg:.0f} degrees of heading"
        return f"{fitted.residual_in_words}; {answer.name}, {away} away, fits better"
    sure, least = fitted.confidence_1km or 0.0, min(_LEAST_OF_FIT, config.min_confidence)
    if sure >= least:
        return None
    return (
        f"{fitted.residual_in_words}; of poses that fit like this {100.0 * sure:.0f} % are right, "
        f"and {100.0 * least:.0f} % are needed"
    )


def sure_within_m(candidate: Pose, config: MatchConfig) -> float | None:
    """Return the distance within which a candidate is sure enough to be right, 200 or 1000 m.

    None if it is sure within neither. An answer within 200 m may leave half the doubt that an
    answer within 1 km may leave, and the candidate's radius may not exceed 200 m: a wrong answer is
    worse than a vague one.
    """
    near, roughly, doubt = candidate.confidence, candidate.confidence_1km, 1 - config.min_confidence
    if near is None or roughly is None:
        return None
    if near >= 1.0 - 0.5 * doubt and (candidate.radius_m or 0.0) <= RIGHT_WITHIN_M:
        return RIGHT_WITHIN_M
    return ROUGHLY_WITHIN_M if roughly >= 1.0 - doubt else None


def at_bound(best: Pose, rays: Rays) -> str | None:
    """Return the refusal of a field of view that is the least or greatest searched; else None."""
    low_deg, high_deg = rays.fov_bounds_deg
    near_deg = _AT_BOUND_SHARE * (high_deg - low_deg)
    if low_deg == high_deg or low_deg + near_deg < best.fov_deg < high_deg - near_deg:
        return None
    return (
        f"the best place needs a field of view of {best.fov_deg:.1f} degrees, and {low_deg:.1f} to "
        f"{high_deg:.1f} were searched; give another one (--fov-deg)"
    )
