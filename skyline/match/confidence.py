r"""Confidence: the probability that a pose is right.

A pose is right if it lies within 200 m of the truth, or roughly right within 1 km, and looks the
same way, within 30 degrees.

The confidence comes from a logistic model of figures of the match, learned from synthetic queries
on terrain for which no result is reported (``python -m skyline_training confidence``, which also
draws the reliability diagram):

.. math::

    P = \frac{1}{1 + \exp(-(b + \sum_f h_f(u_f)))}, \quad u_f = (x_f - m_f) / s_f

Each :math:`h_f` is piecewise linear and bends at the mean and one standard deviation to either
side; :math:`u_f` is clipped at 4. Where it is known which way a figure is better, :math:`h_f` is
monotonic: a better fit never lowers the confidence. Products of figures were tried, and mislead on
kinds of queries that were not learned from.

The figures describe how well the best pose fits, its odds against all other answers, its lead over
them in retrieval, how unusual its camera is, how far off the skyline is, and how much of it there
was to fit: a fit to too little of a skyline is never trusted.
The camera's tilt is not a figure, since synthetic queries tilt less than photos do.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np

from skyline.arrays import BoolArray, Float64Array
from skyline.camera.levelling import level
from skyline.match.likelihood import GREATEST_LOG_ODDS
from skyline.match.rays import Rays
from skyline.match.solver import TEMPERATURE
from skyline.pose.pose import DISTANCES_M, RIGHT_WITHIN_M, ROUGHLY_WITHIN_M, SAME_VIEW_DEG
from skyline.pose.poses import Poses

FITTED = "fitted"
"""Stage of poses that were fitted without a search. Its models have only `pose_figures`, and are
learned from the best poses of searches."""
ORIENTED = "oriented, 1 degree"
"""Name of the model of headings at a known place, in ``orientation.json``."""


BENDS = (-1.0, 0.0, 1.0)
"""Where the lines of `Logistic` bend, in standard deviations from a figure's mean."""
_MAY_LACK = frozenset({"warp_deviations"})
"""Figures that poses may lack: a lens whose distortion is not fitted has no warp."""


@dataclass(frozen=True, slots=True)
class _FigureLimits:
    """Limits at which figures are clipped.

    Few of the examples that were learned from lie beyond them.
    """

    deviations: float = 4.0
    """Greatest distance of a figure from its mean, in standard deviations."""
    min_margin: float = 1e-3
    """Smaller margins count as this before their logarithm is taken."""
    max_margin: float = 60.0
    """Greater margins count as this: photos from other regions can have great margins, too."""
    greatest_lead: float = 2.0
    """Greater leads in retrieval count as this, ahead or behind, in expected errors of a ray."""
    least_weight: float = 1e-9
    """Least likelihood, as a share of the best pose's: odds are no greater than its inverse."""
    camera_deviations: float = 4.0
    """Greatest deviation of a lens or a warp from the expected one, in its standard deviations."""
    max_visible_deg: float = 90.0
    """Wider skylines count as this: the models are learned from photos, and a panorama counts as a
    wide one."""
    log_scale_sd: tuple[float, float] = (0.03, 0.3)
    """Least and greatest standard deviation of a lens's scale: of a field of view that is known
    within 5 %, and of one that is not known."""
    extent_m: float = 8_500.0
    """Greatest distance in the smallest areas that were learned from, squares of 6 km. The number
    of rivals grows with the area that is searched, so the odds of a search that is n times narrower
    are divided by n squared."""


_LIMITS = _FigureLimits()


@dataclass(frozen=True, slots=True)
class Logistic:
    """A logistic model of F figures."""

    names: Sequence[str]
    mean: Sequence[float]
    scale: Sequence[float]
    """``names``, ``mean``, ``scale``: F each."""
    slope: Sequence[Sequence[float]]
    """F of S each. Log odds per standard deviation, between the `BENDS`."""
    bias: float

    def segments(self, figures: Mapping[str, Float64Array]) -> Float64Array:
        """Return how far figures (M,) reach into each segment (M, F, S).

        The parts are in standard deviations from the mean, and add up to the whole. A missing
        figure of `_MAY_LACK` counts as its mean. Raises `ValueError` for any other missing figure.
        """
        missing = [name for name in self.names if name not in figures and name not in _MAY_LACK]
        if missing:
            raise ValueError(f"the model needs the figures {', '.join(missing)}, which are missing")
        count = len(next(iter(figures.values())))
        unit = np.zeros((count, len(self.names)))
        for column, (name, mean, scale) in enumerate(
            zip(self.names, self.mean, self.scale, strict=True)
        ):
            unit[:, column] = (figures.get(name, mean) - mean) / scale
        ends = np.array([-_LIMITS.deviations, *BENDS, _LIMITS.deviations])
        held = np.clip(unit[:, :, np.newaxis], ends[:-1], ends[1:])
        return np.asarray(held - np.clip(0.0, ends[:-1], ends[1:]))

    def probability(self, figures: Mapping[str, Float64Array]) -> Float64Array:
        """Return probabilities (M,) from figures (M,) by name; see `segments`."""
        slope = np.reshape(self.slope, (len(self.names), len(BENDS) + 1))
        logit = self.bias + np.einsum("mfs,fs->m", self.segments(figures), slope)
        return np.asarray(
            1.0 / (1.0 + np.exp(-np.clip(logit, -GREATEST_LOG_ODDS, GREATEST_LOG_ODDS)))
        )


def refined_figures(poses: Poses, found: Poses, rays: Rays) -> dict[str, Float64Array]:
    """Return the figures (M,) of refined poses by name.

    Poses of infinite cost are no rivals. Rivals in the odds are more than 1 km away, or more than
    200 m in a search so narrow that no two of the retrieved poses ``found`` are 1 km apart. If all
    retrieved poses are one place, there is no rival, and the odds are even.

    The skyline of another region can be bent to fit some place well, but seldom resembles that
    place in retrieval. So it counts, too, how far the best pose's place led in retrieval.
    """
    best = poses[int(np.argmin(poses.cost))]
    widest_m = found.distances_m().max(initial=0.0)
    log_odds = np.zeros(len(poses))
    if widest_m > RIGHT_WITHIN_M:
        within_m = ROUGHLY_WITHIN_M if widest_m > ROUGHLY_WITHIN_M else RIGHT_WITHIN_M
        log_odds = _log_odds(poses, within_m)
        log_odds -= 2.0 * np.log(max(1.0, _LIMITS.extent_m / widest_m))
    return pose_figures(poses, rays) | {
        "log_skyline": np.log(np.maximum(poses.figures().skyline_m, 1.0)),
        "log_odds": log_odds,
        "lead": np.full(len(poses), _lead(best, found, RIGHT_WITHIN_M)),
        "far_lead": np.full(len(poses), _lead(best, found, ROUGHLY_WITHIN_M)),
    }


def oriented_figures(poses: Poses, rays: Rays, moved_m: Float64Array) -> dict[str, Float64Array]:
    """Return the figures (M,) of poses at a known place by name.

    There is one pose for each heading. The margin is over the best other heading; ``moved_m`` (M,)
    is how far the poses lie from the known place.
    """
    margin = poses.rival_margin(0.0, 0.0)
    figures = pose_figures(poses, rays)
    # The place is known, and the model has seen no unknown field of view.
    del figures["log_position_sd"], figures["log_lens_sd"]
    return figures | {
        "margin": _margin(margin),
        "log_margin": _log_margin(margin),
        "log_heading_sd": np.log(np.maximum(poses.figures().angle_sd_deg[:, 0], 1e-2)),
        "log_moved": np.log(np.maximum(moved_m, 1.0)),
    }


def pose_figures(poses: Poses, rays: Rays) -> dict[str, Float64Array]:
    """Return the figures (M,) of fitted poses by name.

    They need no search; see `FITTED`.
    """
    fits = poses.figures()
    trace_m2 = np.trace(fits.covariance_m2, axis1=1, axis2=2)
    lens_off = rays.lens.deviations(rays.log_scale(poses.fov_deg))
    figures = {
        "log_residual": np.log(np.maximum(fits.residual_deg, 1e-3)),
        "inlier_share": fits.terrain_share,
        "log_columns": np.log(np.maximum(fits.effective_columns, 1.0)),
        "log_position_sd": 0.5 * np.log(np.maximum(trace_m2, 1e-2)),
        "log_height_sd": np.log(np.maximum(fits.height_sd_m, 1e-2)),
        "lens_deviations": np.minimum(lens_off, _LIMITS.camera_deviations),
        "roll_deg": np.abs(poses.roll_deg),
    }
    return figures | _warp_figure(poses, rays) | _photo_figures(rays, len(poses))


def _warp_figure(poses: Poses, rays: Rays) -> dict[str, Float64Array]:
    """Return, by name, how strongly poses warp the image.

    The figure (M,) is the root mean square of a lens's distortion, or of a panorama's wander, in
    standard deviations; see `Rays.warp_sd`. A lens without distortion has no such figure.
    """
    if not len(rays.warp_sd):
        return {}
    warp = poses.wander if poses.distortion is None else poses.distortion[:, np.newaxis]
    if warp is None:
        return {}
    rms = np.sqrt(np.mean((warp / rays.warp_sd) ** 2, axis=1))
    return {"warp_deviations": np.minimum(rms, _LIMITS.camera_deviations)}


def _log_odds(poses: Poses, within_m: float) -> Float64Array:
    """Return the log odds (M,) of each answer against all others.

    The answer of a pose is all poses near it that look its way.
    """
    weight = _weights(poses)
    own = poses.are_same(within_m, SAME_VIEW_DEG) @ weight
    odds = (own + _LIMITS.least_weight) / (weight.sum() - own + _LIMITS.least_weight)
    return np.asarray(np.log(odds))


def _lead(best: Poses, found: Poses, within_m: float) -> float:
    """Return how far an answer leads its best rival in retrieval.

    ``best`` is the answer's refined pose; it owns the retrieved poses within a distance that look
    its way. The lead is negative if a rival costs less. An answer without retrieved poses counts as
    the worst of them, and one without rivals has no lead.
    """
    is_own = best.are_same(within_m, SAME_VIEW_DEG, found)[0]
    if is_own.all():
        return 0.0
    own = found.cost[is_own].min() if is_own.any() else found.cost.max()
    lead = found.cost[~is_own].min() - own
    return float(np.clip(lead, -_LIMITS.greatest_lead, _LIMITS.greatest_lead))


def _weights(poses: Poses) -> Float64Array:
    """Return the likelihoods (M,) of poses, as shares of the best one's."""
    return np.asarray(np.exp((poses.cost.min() - poses.cost) / TEMPERATURE))


def retrieved_figures(found: Poses, rays: Rays) -> dict[str, Float64Array]:
    """Return the figures (M,) of retrieved poses by name."""
    margin = _margin_or(found, RIGHT_WITHIN_M, np.zeros(len(found)))
    far_margin = _margin_or(found, ROUGHLY_WITHIN_M, margin)
    return {
        "cost": found.cost,
        "margin": _margin(margin),
        "log_margin": _log_margin(margin),
        "log_far_margin": _log_margin(far_margin),
    } | _photo_figures(rays, len(found))


def model_name(stage: str, within_m: float) -> str:
    """Return the name of a stage's model (refined, retrieved, fitted)."""
    return f"{stage}, {within_m:g} m"


def models(file: str = "confidence.json") -> dict[str, Logistic]:
    """Return the learned models of a packaged file by name.

    See `model_name` and `ORIENTED`.
    """
    text = resources.files(__package__).joinpath(file).read_text(encoding="utf-8")
    return {name: Logistic(**model) for name, model in json.loads(text)["models"].items()}


def shared_probabilities(
    learned: Mapping[str, Logistic], poses: Poses, figures: Mapping[str, Float64Array]
) -> tuple[Float64Array, Float64Array]:
    """Return the probabilities that refined poses are right.

    They are (M,) each: of an error up to 200 m, and up to 1 km. The models were learned from best
    poses, and hold only for the best one. All poses within the distance that look the same way
    share the best pose's probability, and all other poses share the rest. Shares follow the costs,
    and the shares of neighbouring poses add up. An infinite cost has no share.
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


def beside_rivals(sure: float, rivals: Iterable[float]) -> float:
    """Return a pose's confidence, if at most one of several is right.

    Its own confidence ``sure`` and the confidences of its rivals were found without knowing of one
    another. Each gives the odds of its pose against no pose being right; the result is the pose's
    odds divided by the sum of 1 and all odds.
    """
    odds = [one / max(1.0 - one, 1e-9) for one in (sure, *rivals)]
    return odds[0] / (1.0 + sum(odds))


def _shares(is_near: BoolArray, weight: Float64Array, best: int, sure: float) -> Float64Array:
    """Return each pose's part of a probability.

    ``weight`` is (M,), ``is_near`` (M, M) says which poses are near each other. No other answer
    gets more probability, relative to its weight, than the best one.
    """
    own = weight * is_near[best]
    others = weight * ~is_near[best]
    worth = sure / own.sum()
    rest = (1.0 - sure) / max(others.sum(), np.finfo(float).tiny)
    return np.asarray(is_near @ own * worth + is_near @ others * min(worth, rest))


def probabilities(
    learned: Mapping[str, Logistic], stage: str, figures: Mapping[str, Float64Array]
) -> tuple[Float64Array, Float64Array]:
    """Return the probabilities that poses are right.

    They are (M,) each: of an error up to 200 m, and up to 1 km.
    """
    near, roughly = (
        learned[model_name(stage, within_m)].probability(figures) for within_m in DISTANCES_M
    )
    return near, np.maximum(near, roughly)


def _margin_or(found: Poses, least_m: float, otherwise: Float64Array) -> Float64Array:
    """Return the margin (M,) of each pose over its rivals.

    A pose without rivals has its value of ``otherwise`` (M,).
    """
    has_rivals = (found.distances_m() > least_m).any(axis=1)
    return np.where(has_rivals, found.rival_margin(least_m), otherwise)


def _photo_figures(rays: Rays, count: int) -> dict[str, Float64Array]:
    """Return the figures of a skyline's width, relief and lens."""
    azimuth, y = level(rays.u, rays.v, 0.0, 0.0, rays.projection)
    # Relief is the deviation from a line: a pitch and a roll can explain the line.
    trend = np.polynomial.Polynomial.fit(azimuth, y, 1, w=np.sqrt(rays.weight))
    relief = np.sqrt(np.average((y - trend(azimuth)) ** 2, weights=rays.weight))
    visible_deg = np.degrees(np.ptp(azimuth))
    return {
        "log_relief": np.full(count, np.log(max(np.degrees(relief), 1e-2))),
        "log_visible": np.full(count, np.log(np.clip(visible_deg, 1.0, _LIMITS.max_visible_deg))),
        "log_lens_sd": np.full(count, np.log(np.clip(rays.lens.sd, *_LIMITS.log_scale_sd))),
    }


def _margin(margin: Float64Array) -> Float64Array:
    return np.asarray(np.clip(margin, -_LIMITS.max_margin, _LIMITS.max_margin))


def _log_margin(margin: Float64Array) -> Float64Array:
    return np.asarray(np.log(np.clip(margin, _LIMITS.min_margin, _LIMITS.max_margin)))
