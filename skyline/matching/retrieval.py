"""Retrieval: from a query's rays to a short list of poses among all predicted places.

Coarse to fine: every heading of every entry by phases (`phases`), then a fit of the whole pose
to the profiles of the best (`curve_fit`), then the best that differ from one another.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skyline.errors import InputError
from skyline.matching.curve_fit import CurveFit, FitConfig, Rays
from skyline.matching.dense import DenseProfiles
from skyline.matching.hypotheses import Hypotheses
from skyline.matching.phases import Phases
from skyline.matching.query import QueryRays

Float64Array = NDArray[np.float64]

_FITS_AT_ONCE = 256
"""Poses fitted together; keeps the arrays in the cache."""


@dataclass(frozen=True, slots=True)
class RetrievalConfig:
    """How places are retrieved.

    Attributes
    ----------
    coarse_bins : int
        Azimuth bins that all headings are compared in; must divide those of the profiles.
    alike_deg : float
        Rises a degree of azimuth apart, that differ by this, count nothing: a quarter period.
    zoom_step : float
        Assumed fields of view differ by this share.
    fitted : int
        Entries whose pose is fitted.
    alike_weight : float
        What a standard deviation of the first comparison counts in the score of a fit. The
        fit knows more, but trusts that its entry stands where the query was taken.
    separation_m, turn_deg : float
        Hypotheses nearer to a better one, looking within a turn of the same way, are left out.
    fit : FitConfig
    """

    coarse_bins: int = 180
    alike_deg: float = 0.75
    zoom_step: float = 0.04
    fitted: int = 4000
    alike_weight: float = 1.0
    separation_m: float = 30.0
    turn_deg: float = 20.0
    fit: FitConfig = field(default_factory=FitConfig)

    def __post_init__(self) -> None:
        if self.fitted < 1 or not self.alike_deg > 0.0 or not self.zoom_step > 0.0:
            raise InputError(
                f"{self.fitted} fitted entries, rises alike within {self.alike_deg:g} degrees, "
                f"fields of view {self.zoom_step:g} apart; expected each above 0"
            )


class Retriever:
    """Finds short lists of poses in one set of profiles.

    Parameters
    ----------
    profiles : DenseProfiles
    config : RetrievalConfig, optional
    """

    def __init__(self, profiles: DenseProfiles, config: RetrievalConfig | None = None) -> None:
        self.config = config or RetrievalConfig()
        self.profiles = profiles
        omega = np.pi / 2.0 / np.radians(self.config.alike_deg)
        self._phases = Phases.of(profiles, self.config.coarse_bins, float(omega))

    def shortlist(self, query: QueryRays, count: int) -> Hypotheses:
        """Return the poses a query most likely has, best first.

        Parameters
        ----------
        query : QueryRays
            Its range of fields of view is searched.
        count : int
            At most so many.

        Returns
        -------
        Hypotheses
            Scores compare poses of one query; lower is better. Poses may lie between the
            entries.

        Raises
        ------
        InputError
            ``count`` is below 1.
        """
        if count < 1:
            raise InputError(f"count is {count}; expected at least 1 hypothesis")
        fitted = self._fitted(query)
        return fitted[fitted.spread(count, self.config.separation_m, self.config.turn_deg)]

    def _fitted(self, query: QueryRays) -> Hypotheses:
        """Return the fitted poses of the entries most alike."""
        bounds = _zoom_bounds(query)
        zooms = self._zooms(bounds)
        alike = self._phases.compare(query, _fov_deg(query, zooms))
        some = min(self.config.fitted, len(self.profiles))
        entries = np.argpartition(-alike.score, some - 1)[:some]
        rays = Rays.of(query, self.config.fit.rays)
        parts = []
        for begin in range(0, some, _FITS_AT_ONCE):
            entry = entries[begin : begin + _FITS_AT_ONCE]
            places = self.profiles[entry]
            fit = CurveFit(places, rays, query.fov_deg, bounds, self.config.fit)
            fits = fit.fit(np.radians(alike.heading_deg[entry]), zooms[alike.fov[entry]])
            heading, pitch, roll, zoom = fits.pose[:, :4].T.astype(np.float64)
            move = fits.pose[:, 4:].astype(np.float64)
            parts.append(
                Hypotheses(
                    places.easting_m + move[:, 0],
                    places.northing_m + move[:, 1],
                    places.eye_elevation_m + (places.ground_slope * move).sum(axis=1),
                    np.degrees(heading) % 360.0,
                    np.degrees(pitch),
                    np.degrees(roll),
                    _fov_deg(query, zoom),
                    fits.score - self.config.alike_weight * alike.score[entry].astype(np.float64),
                )
            )
        return Hypotheses.concatenate(parts)

    def _zooms(self, bounds: tuple[float, float]) -> Float64Array:
        """Return the middles of as few equal parts of a range as are narrow enough."""
        low, high = bounds
        parts = max(1, int(np.ceil((high - low) / self.config.zoom_step)))
        return np.asarray(low + (np.arange(parts) + 0.5) * ((high - low) / parts))


def _zoom_bounds(query: QueryRays) -> tuple[float, float]:
    """Return the range of log(tan(fov / 2)) against the query's own."""
    low, high = np.log(np.tan(np.radians(query.fov_bounds_deg) / 2.0))
    own = np.log(np.tan(np.radians(query.fov_deg) / 2.0))
    return float(low - own), float(high - own)


def _fov_deg(query: QueryRays, zoom: Float64Array) -> Float64Array:
    own = np.tan(np.radians(query.fov_deg) / 2.0)
    fov_deg = 2.0 * np.degrees(np.arctan(own * np.exp(zoom)))
    # Rounding must not take a field of view out of the query's range.
    return np.asarray(np.clip(fov_deg, *query.fov_bounds_deg))
