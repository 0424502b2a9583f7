r"""Every heading of every profile against a query, by a bounded score that is a correlation.

A profile is reduced to the rises d between neighbouring bins of about 2 degrees, which no pitch
changes and a roll hardly does. Two rises are alike by a bounded kernel,

.. math::

    k(d, d') = \cos(\omega (d - d')) = \mathrm{Re}\, e^{i \omega d} \overline{e^{i \omega d'}}

so what is far off counts no more than what is off, a fifth of the columns may be wrong, and the
sum over the query's bins is, at every turn, a circular correlation of phases. A phase takes a
byte; all turns of an entry take a few real Fourier transforms.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from skyline.errors import InputError
from skyline.matching.dense import DenseProfiles
from skyline.matching.query import Attitudes, QueryCurves, QueryRays

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
IntArray = NDArray[np.intp]
UInt8Array = NDArray[np.uint8]

PHASES = 255
"""Phases are counted in so many steps of a turn; code 0 stands for an unknown rise."""

_AT_ONCE = 512
"""Entries transformed together; keeps the arrays in the cache."""

_SAMPLE = 2048
"""Entries that say how the scores of a query are spread by chance."""

_LEVEL = Attitudes((0.0,), (0.0,))


@dataclass(frozen=True, slots=True, eq=False)
class Alike:
    """How well the best turn of each of L entries fits a query.

    Attributes
    ----------
    score : (L,) float32
        Standard deviations above the mean of all turns; higher is better.
    heading_deg : (L,) float64
        Of the query's optical axis.
    fov : (L,) intp
        Which of the assumed fields of view.
    """

    score: Float32Array
    heading_deg: Float64Array
    fov: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Phases:
    """The rises of L profiles as phases, in B bins.

    Attributes
    ----------
    code : (L, B) uint8
        1 + floor(255 * phase / 2 pi) of the rise from bin b to b + 1; 0 where it is unknown.
    rise_to_turn : float
        Phase of a rise, radians per unit of tangent: omega.
    first_deg : float
        Azimuth of bin 0's centre.
    """

    code: UInt8Array
    rise_to_turn: float
    first_deg: float

    @classmethod
    def of(cls, profiles: DenseProfiles, bins: int, rise_to_turn: float) -> "Phases":
        """Reduce profiles to phases; ``bins`` must divide theirs."""
        if bins < 8 or bins % 2 or profiles.bins % bins:
            raise InputError(
                f"{bins} coarse bins; expected an even number of at least 8 that divides the "
                f"{profiles.bins} bins of the profiles"
            )
        run = profiles.bins // bins
        code = np.empty((len(profiles), bins), dtype=np.uint8)
        for begin in range(0, len(profiles), _AT_ONCE):
            part = slice(begin, begin + _AT_ONCE)
            y = np.roll(profiles.y(part), run // 2, axis=1).reshape(-1, bins, run)
            code[part] = phase_codes(y.mean(axis=2), rise_to_turn)
        return cls(code, rise_to_turn, ((run - 1) / 2 - run // 2) * 360.0 / profiles.bins)

    def __len__(self) -> int:
        return len(self.code)

    @property
    def bins(self) -> int:
        """Number of bins B."""
        return int(self.code.shape[1])

    def compare(self, query: QueryRays, fovs_deg: Float64Array) -> Alike:
        """Return the best turn and field of view of every entry.

        Scores of different fields of view are made comparable by how those of all turns of a
        sample of the entries are spread.

        Parameters
        ----------
        query : QueryRays
        fovs_deg : (F,) float64
            Fields of view to assume.
        """
        spectra = self.query_spectra(query, fovs_deg)
        step = max(1, len(self) // _SAMPLE)
        sample = self.sums(slice(None, None, step), spectra)
        mean = sample.mean(axis=(1, 2), dtype=np.float64).astype(np.float32)
        deviation = sample.std(axis=(1, 2), dtype=np.float64).astype(np.float32)
        scale = np.divide(1.0, deviation, out=np.zeros_like(deviation), where=deviation > 0.0)

        def best(begin: int) -> tuple[Float32Array, IntArray, IntArray]:
            sums = self.sums(slice(begin, begin + _AT_ONCE), spectra)
            turn = sums.argmax(axis=2)
            peak = np.take_along_axis(sums, turn[:, :, np.newaxis], axis=2)[:, :, 0]
            score = (peak - mean[:, np.newaxis]) * scale[:, np.newaxis]
            fov = score.argmax(axis=0)
            entry = np.arange(len(fov))
            return score[fov, entry], turn[fov, entry], fov

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            parts = list(pool.map(best, range(0, len(self), _AT_ONCE)))
        score, turn, fov = (np.concatenate(part) for part in zip(*parts, strict=True))
        axis = turn + self.bins // 2
        return Alike(score, (axis * (360.0 / self.bins) + self.first_deg) % 360.0, fov)

    def sums(
        self, entries: slice, spectra: tuple[NDArray[np.complex64], NDArray[np.complex64]]
    ) -> Float32Array:
        """Return the sums of the kernel (F, N, B) of some entries at every turn."""
        code = self.code[entries]
        cosine, sine = _WAVES[0][code], _WAVES[1][code]
        known_cosine, known_sine = fft.rfft(cosine, axis=1), fft.rfft(sine, axis=1)
        sums = np.empty((len(spectra[0]), *code.shape), dtype=np.float32)
        for fov, (of_cosine, of_sine) in enumerate(zip(*spectra, strict=True)):
            product = known_cosine * of_cosine
            product += known_sine * of_sine
            sums[fov] = fft.irfft(product, self.bins, axis=1)
        return sums

    def query_spectra(
        self, query: QueryRays, fovs_deg: Float64Array
    ) -> tuple[NDArray[np.complex64], NDArray[np.complex64]]:
        """Return the conjugate spectra (F, B / 2 + 1) of the query's weighted cosines and sines."""
        waves = np.stack([self.query_waves(query.with_fov(float(fov))) for fov in fovs_deg])
        return (
            np.asarray(fft.rfft(waves.real, axis=1).conj(), dtype=np.complex64),
            np.asarray(fft.rfft(waves.imag, axis=1).conj(), dtype=np.complex64),
        )

    def query_waves(self, query: QueryRays) -> NDArray[np.complex128]:
        """Return weight * exp(i phase) (B,) of the query's rises; 0 where it is not seen."""
        curve = QueryCurves.of(query, _LEVEL, self.bins)
        y, weight = curve.y[0], curve.weight[0]
        rise = np.roll(y, -1) - y
        # The last bin's neighbour is the first one, behind the camera.
        rise[-1] = np.nan
        known = np.isfinite(rise)
        weight = np.minimum(weight, np.roll(weight, -1)) * known
        return np.asarray(weight * np.exp(1j * self.rise_to_turn * np.where(known, rise, 0.0)))


def phase_codes(y: Float32Array, rise_to_turn: float) -> UInt8Array:
    """Return the phases' codes (L, B) of profiles y (L, B); see `Phases`."""
    turns = (np.roll(y, -1, axis=1) - y) * np.float32(rise_to_turn / (2.0 * np.pi))
    turns -= np.floor(turns)
    known = np.isfinite(turns)
    steps = np.minimum(np.where(known, turns, 0.0) * PHASES, PHASES - 1)
    return np.where(known, steps.astype(np.uint8) + 1, 0).astype(np.uint8)


def _waves() -> tuple[Float32Array, Float32Array]:
    phase = (np.arange(PHASES) + 0.5) * (2.0 * np.pi / PHASES)
    cosine, sine = np.append(0.0, np.cos(phase)), np.append(0.0, np.sin(phase))
    return cosine.astype(np.float32), sine.astype(np.float32)


_WAVES = _waves()
