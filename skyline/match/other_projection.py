r"""Whether another projection than assumed would bend a skyline like this.

A photo that does not say otherwise is taken for a perspective one. An unmarked panorama or fisheye
may then fit near the right place all the same, with a wrong eye and wrong angles, and with a field
of view and a distortion that no lens has. So the best pose is fitted three times to the same
columns: as a perspective photo, as a cylindrical panorama and as a fisheye. Each fit begins with
the scale that the perspective fit has in the middle of the photo. With the cost c of a fit, the
temperature T, and the prior density p of how its image is bent, the log odds of another projection
are

.. math::

    \frac{c_{perspective} - c_{other}}{T} + \log\frac{p_{other}}{p_{perspective}} +
    \log\frac{q}{1 - q}

with q the share of unmarked panoramas and fisheyes among photos. Costs alone do not separate them,
since a distortion of 0.3 does nearly what a fisheye does. Distortion alone does not either, since a
narrow panorama needs little of it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import Float64Array
from skyline.camera.projection import MAX_FISHEYE_DEG, MAX_PANORAMA_DEG, Projection
from skyline.match.lens_prior import LensPrior
from skyline.match.likelihood import GREATEST_LOG_ODDS
from skyline.match.rays import Rays, in_runs, usual_distortion_sd
from skyline.match.refine import Refinement
from skyline.match.solver import ROUGH, TEMPERATURE, Fit
from skyline.pose.pose_errors import LOG_SCALE, WARP
from skyline.pose.poses import Poses


@dataclass(frozen=True, slots=True)
class BentImages:
    """Assumptions about panoramas and fisheyes, and how they are fitted."""

    least_confidence: float = 0.5
    """Poses of lower confidence do not show which projection a photo has, since they may well be
    wrong."""
    trusted_below: float = 0.2
    """Greatest probability of another projection at which a pose is still trusted."""
    unmarked_share: float = 0.05
    """Share of panoramas and fisheyes among the photos that note no projection: a guess. If there
    were ten times fewer, their log odds would fall by 2.4."""
    lens_distortion: float = 0.035
    """Scale of the exponential distribution of barrel distortion among lenses that draw straight
    lines straight. Of such lenses in lensfun's database wider than 75 degrees, 171 settings, the
    distortions have an rms of 0.048, and 1 % exceed 0.17."""
    start_scales: tuple[float, ...] = (0.87, 1.0)
    """Factors on the perspective fit's scale from which the other projections are fitted."""
    columns_per_bin: float = 0.8
    """Columns in a step of the solver's azimuth at the side of a perspective photo, where they lie
    densest. Below 1 the solver averages no two of them in any projection, so all costs are of the
    same columns."""
    fisheye_term: float = -1.0 / 24.0
    """Mean of t in the mapping of fisheyes, half way from an equidistant lens to a stereographic
    one; see `skyline.match.rays.CameraModel.fisheye_sd`."""
    widest_radius: float = 1.5
    """Largest radius at the side of a fisheye from which a fit starts: 156 degrees."""
    least_fov_share: float = 0.75
    """Smallest field of view that is tried, as a share of the one at the perspective fit's scale.
    """
    greatest_fov_share: float = 1.25
    """Largest field of view that is tried, as the same kind of share."""


_BENT = BentImages()


@dataclass(frozen=True, slots=True)
class OtherProjection:
    """Another projection that would bend a skyline like the photo's.

    Attributes
    ----------
    projection : Projection
        Cylindrical or fisheye.
    fov_deg : float
        The horizontal field of view with which it fits best.
    probability : float
        The probability that the photo is not a perspective one.
    second : OtherProjection, optional
        The next likeliest one.
    """

    projection: Projection
    fov_deg: float
    probability: float
    second: "OtherProjection | None" = None

    @property
    def is_likely(self) -> bool:
        """Whether the pose of a perspective photo cannot be trusted."""
        return self.probability > _BENT.trusted_below

    @property
    def in_words(self) -> str:
        """The reason not to trust a pose fitted as a perspective photo's."""
        likely = [one for one in (self, self.second) if one is not None and one.is_likely]
        kinds = " or ".join(one._kind for one in likely)
        options = " or ".join(one._options for one in likely)
        return f"the skyline is bent as by {kinds}; if it is one, give {options}"

    @property
    def _kind(self) -> str:
        kind = "panorama" if self.projection.is_panorama else str(self.projection)
        return f"a {kind} of about {self.fov_deg:.0f} degrees"

    @property
    def _options(self) -> str:
        return f"--projection {self.projection} --fov-deg {self.fov_deg:.0f}"


def find_other_projection(
    rays: Rays, pose: Poses, sure: float, refinement_of: Callable[[Rays], Refinement]
) -> OtherProjection | None:
    """Return the likeliest other projection of a photo.

    None for a panorama or a fisheye, and for a pose that is probably wrong.

    Parameters
    ----------
    rays : Rays
    pose : Poses
        The photo's best pose alone.
    sure : float
        The confidence of the pose.
    refinement_of : callable
        Returns the refinement of a photo's rays, with the priors with which the pose was found.
    """
    if rays.projection.spreads_angles or sure < _BENT.least_confidence:
        return None
    columns = _columns(rays, float(pose.fov_deg[0]))
    own = _best_fit(refinement_of(columns), _from(pose, columns, np.ones(1)))
    own_log_p = -max(float(own.state[0, WARP:].sum()), 0.0) / _BENT.lens_distortion
    share = _BENT.unmarked_share
    prior_log_odds = math.log(share / (1.0 - share))
    others = []
    for bent in (_panorama(columns), _fisheye(columns)):
        start = _from(replace(pose, distortion=None), bent, np.array(_BENT.start_scales))
        fit = _best_fit(refinement_of(bent), start)
        log_p = -0.5 * float(np.square(fit.state[0, WARP:] / bent.warp_sd).sum())
        log_odds = float(own.cost[0] - fit.cost[0]) / TEMPERATURE + log_p - own_log_p
        log_odds += prior_log_odds
        log_odds = min(max(log_odds, -GREATEST_LOG_ODDS), GREATEST_LOG_ODDS)
        fov_deg = float(bent.fov_at(fit.state[0, LOG_SCALE]))
        others.append(OtherProjection(bent.projection, fov_deg, 1.0 / (1.0 + math.exp(-log_odds))))
    second, likeliest = sorted(others, key=lambda other: other.probability)
    return replace(likeliest, second=second)


def _columns(rays: Rays, fov_deg: float) -> Rays:
    """Return rays for a field of view, averaged over equal columns."""
    step_rad = 2.0 * np.pi / ROUGH.bins
    count = int(_BENT.columns_per_bin * math.sin(math.radians(fov_deg)) / step_rad)
    return replace(in_runs(rays.with_fov(fov_deg), max(count, 1)), lens=LensPrior())


def _panorama(columns: Rays) -> Rays:
    """Return a perspective photo's rays as those of a cylindrical panorama.

    The panorama has the same scale in its middle.
    """
    fov_deg = min(math.degrees(2.0 * columns.half_width), MAX_PANORAMA_DEG)
    return replace(
        columns,
        fov_deg=fov_deg,
        fov_range_deg=_range_deg(fov_deg, MAX_PANORAMA_DEG),
        projection=Projection.CYLINDRICAL,
        distortion_sd=0.0,
    )


def _fisheye(columns: Rays) -> Rays:
    """Return a perspective photo's rays as those of a fisheye.

    The fisheye has the same scale in its middle, unless it would be too wide.
    """
    shrink = min(1.0, _BENT.widest_radius / columns.half_width)
    u = shrink * columns.u
    v = shrink * columns.v
    bend = 1.0 + _BENT.fisheye_term * (u**2 + v**2)
    side = shrink * columns.half_width
    fov_deg = math.degrees(2.0 * side * (1.0 + _BENT.fisheye_term * side**2))
    return replace(
        columns,
        u=u * bend,
        v=v * bend,
        fov_deg=fov_deg,
        fov_range_deg=_range_deg(fov_deg, MAX_FISHEYE_DEG),
        projection=Projection.FISHEYE,
        distortion_sd=usual_distortion_sd(Projection.FISHEYE, fov_deg),
    )


def _range_deg(fov_deg: float, most_deg: float) -> tuple[float, float]:
    """Return the range of fields of view tried about a given one."""
    low_deg = _BENT.least_fov_share * fov_deg
    high_deg = _BENT.greatest_fov_share * fov_deg
    return min(low_deg, most_deg), min(high_deg, most_deg)


def _from(pose: Poses, rays: Rays, scales: Float64Array) -> Poses:
    """Return a pose at several scales, as starts of fits."""
    several = pose[np.zeros(len(scales), dtype=np.intp)]
    return replace(several, fov_deg=rays.fov_at(np.log(scales)))


def _best_fit(refinement: Refinement, start: Poses) -> Fit:
    """Return the best fit of two moves from a start.

    The first move assumes rough errors, the second fine ones.
    """
    particles = refinement.started(refinement.rough, start)
    particles = refinement.moved(refinement.rough, particles)
    particles = refinement.moved(refinement.fine, refinement.reweighted(particles))
    return particles.fit[np.argmin(particles.fit.cost, keepdims=True)]
