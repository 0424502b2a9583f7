r"""Joint posteriors of photos that one person took on one walk.

Between two photos the person went at most a distance r, by any route. Nothing else is known, so all
places within r are equally probable: with D the disc of radius r, whose sum is 1, and
:math:`p_k` the posterior of photo k alone,

.. math::

    a_k = D_k * (p_{k-1}\, a_{k-1}), \quad b_k = D_{k+1} * (p_{k+1}\, b_{k+1}), \quad
    p'_k = p_k\, a_k\, b_k / \sum p_k\, a_k\, b_k

a has what the earlier photos tell, and b what the later ones tell (the forward and backward
messages of a hidden Markov model); each is 1 if there is no such photo.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import pairwise

import numpy as np

from skyline.arrays import Float64Array, refuse_text
from skyline.errors import InputError
from skyline.match.posterior import Posterior, on_finer_cells


@dataclass(frozen=True, slots=True)
class DiscSize:
    """How finely a walk is followed."""

    radius_cells: int = 32
    """A larger disc is spread on a coarser grid: its rim is then one cell wide, 3 % of the radius.
    Speeds are known less exactly."""
    least_share: float = 1e-12
    """Values below this share of the greatest one are rounding errors of the transform."""


_DISC = DiscSize()


def check_times(times: Sequence[datetime]) -> None:
    """Raise `InputError` unless all times are datetimes, with zones or without."""
    other = next((one for one in times if not isinstance(one, datetime)), None)
    if other is not None:
        raise InputError(f"a time is {other!r}; expected a datetime of Python or pandas")
    if len({one.tzinfo is None for one in times}) > 1:
        raise InputError(
            "some photos' times have a zone, and some have none; give all alike, in a list with a "
            "column `time` beside `path`"
        )


def check_walk(photos: int, times: Sequence[datetime], walked_km_h: float) -> None:
    """Raise `InputError` unless photos have times, and a speed above 0."""
    refuse_text(walked_km_h=walked_km_h)
    if not photos or len(times) != photos or not 0.0 < walked_km_h < math.inf:
        raise InputError(
            f"{photos} photos, {len(times)} times and {walked_km_h} km/h; expected a "
            "photo or more, a time for each, and a speed above 0"
        )
    check_times(times)


def of_walk(
    posteriors: Sequence[Posterior], times: Sequence[datetime], walked_km_h: float
) -> list[Posterior]:
    """Return the posteriors of a walk's photos, in the photos' order.

    Raises as `joined`.

    Parameters
    ----------
    posteriors : sequence of Posterior
        The posteriors of the single photos, in any order, on one grid.
    times : sequence of datetime
        When each photo was taken.
    walked_km_h : float
        Greatest speed, kilometres per hour, as the crow flies.
    """
    order = sorted(range(len(times)), key=lambda number: times[number])
    hours = [(times[b] - times[a]) / timedelta(hours=1) for a, b in pairwise(order)]
    reach_m = [1000.0 * walked_km_h * one for one in hours]
    together = joined([posteriors[number] for number in order], reach_m)
    return [together[order.index(number)] for number in range(len(order))]


def joined(posteriors: Sequence[Posterior], reach_m: Sequence[float]) -> list[Posterior]:
    """Return the posterior of each photo of a walk, given all photos.

    Parameters
    ----------
    posteriors : sequence of Posterior
        The posteriors of the N single photos, in the order in which they were taken, on one grid.
    reach_m : sequence of float
        N - 1 distances: the farthest that the person can have gone from photo to photo.

    Raises
    ------
    InputError
        No walk leads through places where the photos can have been taken.
    """
    earlier = list(_messages(posteriors, reach_m))
    later = list(_messages(posteriors[::-1], reach_m[::-1]))[::-1]
    together = []
    for own, before, after in zip(posteriors, earlier, later, strict=True):
        product = own.probability * before * after
        total = product.sum(dtype=np.float64)
        if not total > 0.0:
            raise InputError(
                "no walk at this speed leads past places where these photos can have been taken; "
                "check their times, give a greater speed, or leave out a photo that another person "
                "took"
            )
        together.append(replace(own, probability=(product / total).astype(np.float32)))
    return together


def _messages(
    posteriors: Iterable[Posterior], reach_m: Iterable[float]
) -> Iterator[Float64Array | float]:
    """Yield what earlier photos tell of each photo, up to a factor."""
    message: Float64Array | float = 1.0
    yield message
    for own, away_m in zip(posteriors, reach_m, strict=False):
        product = own.probability.astype(np.float64) * message
        most = float(product.max())
        message = _spread(product / (most or 1.0), away_m / own.grid.cell_m)
        yield message


def _spread(cells: Float64Array, radius: float) -> Float64Array:
    """Return values (R, C) spread over discs; radius in cells."""
    from scipy.signal import fftconvolve  # noqa: PLC0415  (slow to load, seldom needed)

    step = max(1, int(radius / _DISC.radius_cells))
    padded = np.pad(cells, [(0, -count % step) for count in cells.shape])
    shape = padded.shape[0] // step, padded.shape[1] // step
    summed = padded.reshape(shape[0], step, shape[1], step).sum(axis=(1, 3))
    spread = fftconvolve(summed, _disc(radius / step), mode="same")
    spread[spread < _DISC.least_share * spread.max()] = 0.0
    return on_finer_cells(spread, step, cells.shape)


def _disc(radius: float) -> Float64Array:
    """Return a square grid with a disc of sum 1.

    A cell on its rim counts by the part of it that lies inside.
    """
    reach = int(np.ceil(radius))
    parts = 8  # Of a cell's side.
    along = (np.arange((2 * reach + 1) * parts) + 0.5) / parts - reach - 0.5
    is_inside = along[:, np.newaxis] ** 2 + along**2 <= max(radius, 0.5) ** 2
    cells = is_inside.reshape(2 * reach + 1, parts, 2 * reach + 1, parts).mean(axis=(1, 3))
    return np.asarray(cells / cells.sum())
