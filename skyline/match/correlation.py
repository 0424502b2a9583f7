r"""Sliding normalized correlation, exact over every heading, location and assumed pitch.

With the query q, its weights w, the profile y, n = 1 where y is known (else y = n = 0) and a
turn of s bins, over the bins i of the query:

.. math::

    W = \sum w_i n_{i+s}, \quad
    a = \tfrac1W \sum w_i n_{i+s} q_i, \quad
    b = \tfrac1W \sum w_i y_{i+s}

.. math::

    \mathrm{ncc}(s) = \frac{\sum w_i q_i y_{i+s} - W a b}
    {\sqrt{(\sum w_i n_{i+s} q_i^2 - W a^2)\,(\sum w_i y_{i+s}^2 - W b^2)}}

Each sum is a circular correlation of an array of the query with one of the profile, so all turns
come from one product of Fourier transforms. A turn has no correlation where too little of the query
overlaps the profile (W below a share of the query's weight), or where either curve is flat over the
overlap. The score is 1 - ncc, in [0, 2].
"""

import numpy as np
from scipy import fft

from skyline.arrays import Complex128Array, Float32Array, Float64Array, IntArray
from skyline.match.profiles import TANGENT_PER_PX, Fits, ProfileRanker
from skyline.match.query_rays import QueryCurves, QueryRays

_CHUNK = 8
"""Locations at a time; keeps the arrays of the transforms in the cache."""
_MIN_OVERLAP = 0.8
"""Least share of the query's weight that must lie over known profile."""
_FLAT_PX = 0.1
"""Curves with a smaller standard deviation over the overlap have no correlation."""
_Transforms = tuple[Complex128Array | None, Complex128Array, Complex128Array]


class CorrelationMatcher(ProfileRanker):
    """The plain baseline: the greatest normalized correlation wins.

    The transforms of profiles are computed anew for each query: they are few beside those that a
    query needs, and would take several times the memory of the profiles.
    """

    def fit(self, query: QueryRays) -> Fits:
        """Return the best pose at every location; score is 1 - ncc."""
        profiles = self.profiles
        curves = QueryCurves.of(query, profiles.bins)
        chunks = [profiles.y[k : k + _CHUNK] for k in range(0, len(profiles), _CHUNK)]
        ncc = [self._greatest(curves, chunk) for chunk in chunks]
        peak, pitch, turn = (np.concatenate(parts) for parts in zip(*ncc, strict=True))
        axis = turn + profiles.bins // 2
        return Fits(
            1.0 - peak,
            axis % profiles.bins * (360.0 / profiles.bins),
            curves.pitch_deg[pitch],
            np.zeros(len(profiles)),
        )

    def _greatest(
        self, curves: QueryCurves, y: Float32Array
    ) -> tuple[Float64Array, IntArray, IntArray]:
        """Return the greatest ncc of each location (-inf if none), its pitch's row and its turn."""
        transforms = _transformed(y)
        row = np.arange(len(y))
        best = np.full(len(y), -np.inf)
        pitch, turn = np.zeros((2, len(y)), dtype=np.intp)
        for number, (q, weight) in enumerate(zip(curves.y, curves.weight, strict=True)):
            ncc = self._ncc(transforms, q, weight)
            peak = ncc.argmax(axis=1)
            greater = ncc[row, peak] > best
            best = np.where(greater, ncc[row, peak], best)
            pitch = np.where(greater, number, pitch)
            turn = np.where(greater, peak, turn)
        return best, pitch, turn

    def _ncc(self, transforms: _Transforms, q: Float64Array, weight: Float64Array) -> Float64Array:
        """Return ncc (L, B) of one query curve at every turn, -inf where there is none."""
        # Deviations from the mean keep the differences of sums below well conditioned.
        q = np.where(weight > 0.0, q, 0.0)
        q = np.where(weight > 0.0, q - np.average(q, weights=weight), 0.0)
        of_n, of_y, of_y2 = transforms
        query_w, query_wq, query_wq2 = fft.rfft(weight * np.stack([q**0, q, q**2])).conj()
        bins = len(q)
        sum_y, sum_y2 = fft.irfft(of_y * query_w, bins), fft.irfft(of_y2 * query_w, bins)
        covariance = fft.irfft(of_y * query_wq, bins)
        if of_n is None:
            # All of the query then lands on known profile, and its mean over that is 0.
            total, enough = np.full(1, weight.sum()), np.full(1, True)
            variance_q = np.full(1, np.sum(weight * q**2))
        else:
            total = fft.irfft(of_n * query_w, bins)
            enough = total >= _MIN_OVERLAP * weight.sum() - 1e-9
            total = np.where(enough, total, 1.0)
            sum_q = fft.irfft(of_n * query_wq, bins)
            variance_q = fft.irfft(of_n * query_wq2, bins) - sum_q**2 / total
            covariance -= sum_q * sum_y / total
        variance_y = sum_y2 - sum_y**2 / total
        flat = (_FLAT_PX * TANGENT_PER_PX) ** 2 * total
        usable = enough & (variance_q > flat) & (variance_y > flat)
        scale = np.sqrt(np.where(usable, variance_q * variance_y, 1.0))
        return np.where(usable, covariance / scale, -np.inf)


def _transformed(y: Float32Array) -> _Transforms:
    """Return the Fourier transforms (L, B / 2 + 1) of n, y and y**2 of profiles.

    The first is None where the profiles are known throughout.
    """
    n = np.isfinite(y).astype(np.float64)
    y0 = np.where(n > 0.0, y, 0.0).astype(np.float64)
    mean = y0.sum(axis=1, keepdims=True) / np.maximum(n.sum(axis=1, keepdims=True), 1.0)
    y0 = (y0 - mean) * n
    return None if n.all() else fft.rfft(n), fft.rfft(y0), fft.rfft(y0**2)
