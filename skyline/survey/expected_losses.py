"""The share of views that a search loses between places.

Between places, a view's skyline differs from the places' skylines by an angle of about the spacing
over the skyline's distance. The odds that a whole search, refinement included, then fails grow with
a power of that ratio. `LossLaw` was fitted to searches for synthetic views, 60 degrees wide;
docs/method.md has the terrain.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from skyline.arrays import Float32Array, Float64Array
from skyline.store.mapped_places import PlaceSource


@dataclass(frozen=True, slots=True)
class LossLaw:
    """The law of losses, and the views to which it is applied."""

    even_odds: float = 0.72
    """Spacing over distance where half of the views are lost."""
    power: float = 1.55
    """Power of that ratio in the odds of a loss."""
    too_near_m: float = 25.0
    """Distance at which half of the skylines are lost, however dense the places are: wrong slopes
    fit them as well. Plans leave this out, since no spacing changes it."""
    too_near_power: float = 1.75
    """Power of the distance in the odds of such a loss."""
    nearest_m: float = 1.0
    """Least distance of a skyline; nearer ones count as this near."""
    farthest_m: float = 1e6
    """Greatest distance of a skyline; directions without data count as this far."""
    directions: int = 36
    """Number of directions of the views, all equally likely."""
    classes_m: tuple[float, ...] = (0.0, 150.0, 400.0)
    """Least distances of the classes of skylines for which finds are reported."""
    most_places: int = 20_000
    """Greatest number of places from which finds are estimated. All 2.7 million of a store take
    14.5 GB, and change no share by a point."""

    def lost(self, nearness: Float64Array, spacing_m: Float64Array) -> Float64Array:
        """Return the expected share of lost views, by nearness and spacing."""
        odds = (spacing_m * nearness / self.even_odds) ** self.power
        return np.asarray(odds / (1.0 + odds), dtype=np.float64)

    def nearness(self, distance_m: Float32Array) -> Float64Array:
        """Return views' mean inverse distances round places, (N, 36), 1 / m."""
        # The nearest stretches of a skyline move most, so the mean is one of nearness.
        known_m = np.nan_to_num(distance_m.astype(np.float64), nan=self.farthest_m)
        nearness = 1.0 / np.clip(known_m, self.nearest_m, self.farthest_m)
        bins = distance_m.shape[1]
        width = bins // 6
        ahead = np.concatenate([nearness, nearness[:, :width]], axis=1)
        total = np.cumsum(np.pad(ahead, ((0, 0), (1, 0))), axis=1)
        starts = np.arange(self.directions) * bins // self.directions
        mean = (total[:, starts + width] - total[:, starts]) / width
        return np.asarray(mean, dtype=np.float64)


_LAW = LossLaw()


def lost_shares(distance_m: Float32Array, spacing_m: Float64Array) -> Float64Array:
    """Return expected shares (N, S) of lost views, by place and spacing.

    The views are 60 degrees wide and begin at 0, 10, 20, ... degrees. ``distance_m`` (N, B) are the
    distances of skylines all the way round; NaN where there is no data.
    """
    nearness = _LAW.nearness(distance_m)
    return np.asarray(_LAW.lost(nearness[:, np.newaxis], spacing_m[:, np.newaxis]).mean(axis=2))


def expected_finds(source: PlaceSource) -> list[tuple[float, float, float]]:
    """Return the share of views a search should find, by skyline distance.

    Each class has its least skyline distance (harmonic mean, metres), its share of all views, and
    the share of its views that is expected to be found. Among very many places, every n-th is read.
    """
    every = len(source) // _LAW.most_places + 1
    places = source.take(np.arange(0, len(source), every, dtype=np.intp))
    spacing_m = 2.0 * places.tolerance_m.astype(np.float64)
    nearness = _LAW.nearness(places.distance_m())
    area = np.square(spacing_m)[:, np.newaxis] / len(spacing_m)
    weight = np.repeat(area, _LAW.directions, axis=1)
    kept = 1.0 - _LAW.lost(nearness, spacing_m[:, np.newaxis])
    kept /= 1.0 + (_LAW.too_near_m * nearness) ** _LAW.too_near_power
    found = []
    for least_m, most_m in pairwise((*_LAW.classes_m, np.inf)):
        mine = (nearness <= 1.0 / max(least_m, _LAW.nearest_m)) & (nearness > 1.0 / most_m)
        total = weight[mine].sum()
        if total:
            share = np.average(kept[mine], weights=weight[mine])
            found.append((least_m, float(total / weight.sum()), float(share)))
    return found
