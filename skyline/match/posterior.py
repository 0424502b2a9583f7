r"""Posterior: the probability of every place searched, given a photo.

A search has candidates c, their covariances, and how sure the best one is: it is right within
200 m with the probability P_200, and within 1 km with P_1000. The posterior of a place x is

.. math::

    p(x) = \sum_c m_c\, t(x; x_c, \Sigma_c) + r\, N(x; x_1, S^2) + q\, p_q(x)

where t is Student's distribution with n degrees of freedom, scaled so that its region of 95 % is
the normal distribution's. Covariances are often too large, and now and then far too small.

.. math::

    t(x; x_c, \Sigma) = \frac{1}{2 \pi k \sqrt{|\Sigma|}}
    \left(1 + \frac{(x - x_c)^T \Sigma^{-1} (x - x_c)}{n k}\right)^{-(n + 2) / 2}, \quad
    k = \frac{-2 \ln 0.05}{n (0.05^{-2 / n} - 1)}

The masses m of the candidates are their confidences: P_200 for the best one. r is the rest of
P_1000. q is the probability that no candidate is right. Retrieval spreads q over the poses k that
fit without rendering, by their costs C, and over all places i, by their scores z in screening and
the areas a that they represent:

.. math::

    p_q(x) = f \sum_k \frac{e^{-C_k / T}}{\sum e^{-C / T}} N(x; x_k, t^2) +
    (1 - f) \sum_i \frac{a_i e^{b z_i}}{\sum a\, e^{b z}} N(x; x_i, t^2 + a_i / 4)

The settings of `Spread` are learned. Where a photo notes its place, or photo spots are given, both
sums are also weighted by the densities of `skyline.match.position_prior` and
`skyline.match.photo_spots`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import cv2
import numpy as np

from skyline.arrays import Float32Array, Float64Array, Rows, ShortRepr
from skyline.errors import InputError, library
from skyline.files.cf import METRES
from skyline.geodesy.cell_grid import CellGrid
from skyline.geodesy.map_frame import Frame
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.screen import AlikePlaces
from skyline.pose.pose import RIGHT_WITHIN_M, ROUGHLY_WITHIN_M, Pose
from skyline.pose.poses import Poses

if TYPE_CHECKING:
    from xarray import DataArray

SHARES = (0.5, 0.8, 0.95)
"""Shares of the probability that the regions of maps hold."""


@dataclass(frozen=True, slots=True)
class Spread:
    """How widely probability is spread around what a search has found.

    The settings are close to the likeliest for 35 searches in the Sierra and the Rofental, of
    which 23 were unsure (their record is not kept). The likelihood has a flat maximum.
    """

    freedom: float = 3.0
    """n, the degrees of freedom of candidates' errors."""
    roughly_sd_m: float = 400.0
    """S: most of such a distribution lies between 200 m and 1 km from its middle."""
    fitted_share: float = 0.5
    """f, the share of fitted poses in the probability that no candidate is right."""
    temperature: float = 0.2
    """T, by which the costs of fitted poses are divided."""
    around_m: float = 60.0
    """t, the deviation around fitted poses; around a place, half the side of its square is added in
    quadrature."""
    score_weight: float = 8.0
    """b, the gain of log probability with the score of a place."""
    reach_sds: float = 10.0
    """Deviations of a candidate beyond which nothing is drawn."""
    unknown_sd_m: float = 40.0
    """Deviation of a candidate without a covariance, which was not refined."""


@dataclass(frozen=True, slots=True)
class MapSize:
    """How fine the grid of a posterior is."""

    most_cells: int = 4_000_000
    finest_m: float = 2.0
    """Least side of a cell; candidates are seldom more exact."""


SPREAD = Spread()
_SIZE = MapSize()


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """The poses and places that a posterior is made of.

    Attributes
    ----------
    candidates : sequence of Pose
        Best first, with their confidences; may be empty.
    fitted : Poses
        Poses that fit without rendering.
    places : AlikePlaces
        The places that were searched, one or more.
    prior : Prior
        The place that the photo notes, and photo spots. Candidates' confidences already allow for
        them.
    """

    candidates: Sequence[Pose]
    fitted: Poses
    places: AlikePlaces
    prior: Prior = NOTHING_KNOWN


@dataclass(frozen=True, slots=True, eq=False)
class _Spots(Rows):
    """N candidates, each with a share of the probability."""

    easting_m: Float64Array
    northing_m: Float64Array
    covariance_m2: Float64Array
    """(N, 2, 2) float64."""
    share: Float64Array


@dataclass(frozen=True, slots=True, eq=False)
class _Shares:
    """How candidates share the probability."""

    spots: _Spots
    roughly: float
    """Probability that the best one is off by 200 m to 1 km and no other is right."""
    none_right: float
    """Probability that none is right."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Posterior(ShortRepr):
    """The probability that a photo was taken in each cell.

    Attributes
    ----------
    probability : (rows, cols) float32
        The sum is 1.
    grid : CellGrid
        The cells: their north-western corner, ``west_m`` and ``north_m`` in the frame, and their
        side, ``cell_m``.
    frame : Frame
        The store's frame: `Matcher.frame`.
    """

    probability: Float32Array
    grid: CellGrid
    frame: Frame

    def least_probability(self, share: float) -> float:
        """Return the least probability of the cells in a region.

        The region is the smallest area that holds a share of the probability: the cells that are at
        least as probable.

        Raises
        ------
        InputError
            The share is not between 0 and 1.
        """
        if not 0.0 < share < 1.0:
            raise InputError(f"a share is {share!r}; expected a number between 0 and 1")
        cells = np.sort(self.probability, axis=None)[::-1]
        held = np.cumsum(cells, dtype=np.float64)
        return float(cells[np.searchsorted(held, share * held[-1])])

    def area_km2(self, share: float) -> float:
        """Return the size of the smallest area that holds a share."""
        cells = np.count_nonzero(self.probability >= self.least_probability(share))
        return float(cells * (self.grid.cell_m / 1000.0) ** 2)

    def probability_at(self, *, easting_m: float, northing_m: float) -> float:
        """Return the probability of a place's cell; 0 outside the map."""
        grid = self.grid
        row = math.floor((grid.north_m - northing_m) / grid.cell_m)
        col = math.floor((easting_m - grid.west_m) / grid.cell_m)
        is_inside = 0 <= row < grid.rows and 0 <= col < grid.cols
        return float(self.probability[row, col]) if is_inside else 0.0

    def share_at(self, *, easting_m: float, northing_m: float) -> float:
        """Return the probability of all cells more probable than a place's.

        The place lies in the regions of all greater shares.
        """
        own = self.probability_at(easting_m=easting_m, northing_m=northing_m)
        return float(self.probability[self.probability > own].sum(dtype=np.float64))

    def region(self, share: float) -> list[list[Float64Array]]:
        """Return the outline of the smallest area that holds a share.

        Returns
        -------
        list of list of (P, 2) float64
            Polygons, each a closed outline and its holes: eastings and northings. Outlines are
            counter-clockwise, holes clockwise.

        Raises
        ------
        InputError
            The share is not between 0 and 1.
        """
        from contourpy import FillType, contour_generator  # noqa: PLC0415  (slow to load)

        least = self.least_probability(share)
        next_lower = float(self.probability[self.probability < least].max(initial=0.0))
        tiny = float(np.finfo(np.float32).tiny)
        # The logarithm of a normal distribution is smooth, and well interpolated between cells. A
        # rim of empty cells closes the outlines at the map's border.
        height = np.log(np.pad(np.maximum(self.probability, tiny), 1, constant_values=tiny))
        rows, cols = height.shape
        found = contour_generator(
            x=self.grid.west_m + (np.arange(cols) - 0.5) * self.grid.cell_m,
            y=self.grid.north_m - (np.arange(rows) - 0.5) * self.grid.cell_m,
            z=height,
            fill_type=FillType.OuterOffset,
        ).filled(0.5 * math.log(max(least, tiny)) + 0.5 * math.log(max(next_lower, tiny)), np.inf)
        polygons = (
            [self._simplified(points[begin:end]) for begin, end in pairwise(ends)]
            for points, ends in zip(*found, strict=True)
        )
        return [
            [ring for ring in rings if len(ring) > 3] for rings in polygons if len(rings[0]) > 3
        ]

    def _simplified(self, ring: Float64Array) -> Float64Array:
        """Return a closed outline, simplified by a quarter of a cell."""
        # Single precision has no room for eastings of a whole country.
        off = (ring - ring[0]).astype(np.float32)
        kept = cv2.approxPolyDP(off[:-1, np.newaxis], 0.25 * self.grid.cell_m, closed=True)[:, 0]
        closed = ring[0] + np.concatenate([kept, kept[:1]], dtype=np.float64)
        # Rows count southwards, so what turns left on the grid turns right on the map.
        return np.asarray(closed[::-1])

    def to_xarray(self) -> DataArray:
        """Return the probabilities as a DataArray (y, x), on the frame's map.

        Raises
        ------
        InputError
            Xarray is not installed.
        """
        made: DataArray = library("xarray", "a DataArray").DataArray(
            self.probability,
            {
                "y": ("y", self.grid.northings_m(), METRES),
                "x": ("x", self.grid.eastings_m(), METRES),
            },
            name="probability",
            attrs={"long_name": "probability of a cell", "crs_wkt": self.frame.wkt},
        )
        return made


def grid_around(searches: Iterable[Findings]) -> CellGrid:
    """Return the grid around the places and the candidates of searches."""
    corners_m = []
    for found in searches:
        corners_m += [(one.easting_m, one.northing_m) for one in found.candidates]
        places = found.places
        for sign in (-1.0, 1.0):
            east_m = places.easting_m + sign * places.tolerance_m
            north_m = places.northing_m + sign * places.tolerance_m
            corners_m += [(east_m.min(), north_m.min()), (east_m.max(), north_m.max())]
    west, south = (float(least) for least in np.min(corners_m, axis=0))
    east, north = (float(most) for most in np.max(corners_m, axis=0))
    cell_m = max(_SIZE.finest_m, math.sqrt((east - west) * (north - south) / _SIZE.most_cells))
    rows, cols = math.ceil((north - south) / cell_m), math.ceil((east - west) / cell_m)
    return CellGrid(west, north, cell_m, rows, cols)


def posterior_of(found: Findings, frame: Frame, grid: CellGrid | None = None) -> Posterior:
    """Return the posterior of a photo.

    ``frame`` is the frame of its places and poses. By default the grid is the one around the places
    and the candidates.
    """
    fitted, places, prior = found.fitted, found.places, found.prior
    shares = _shares_of(found.candidates)
    spots, left = shares.spots, shares.none_right
    layer = _Layer(grid or grid_around([found]))
    for spot in spots:
        layer.add_spot(spot)
    if len(spots):
        best = spots[:1]
        wide_m = np.array([SPREAD.roughly_sd_m])
        layer.add_round(best.easting_m, best.northing_m, wide_m, np.array([shares.roughly]))
    by_fits = SPREAD.fitted_share * left if len(fitted) else 0.0
    if by_fits:
        gain = prior.log_density(fitted) - fitted.cost / SPREAD.temperature
        share = by_fits * _softmax(gain)
        sd_m = np.full(len(fitted), SPREAD.around_m)
        layer.add_round(fitted.easting_m, fitted.northing_m, sd_m, share)
    gain = prior.log_density(places) + SPREAD.score_weight * places.score
    weight = _softmax(gain + 2.0 * np.log(places.tolerance_m))
    sd_m = np.hypot(SPREAD.around_m, places.tolerance_m)
    layer.add_round(places.easting_m, places.northing_m, sd_m, (left - by_fits) * weight)
    probability = layer.probability / layer.probability.sum()
    return Posterior(probability.astype(np.float32), layer.grid, frame)


def _shares_of(candidates: Sequence[Pose]) -> _Shares:
    """Return how candidates share the probability.

    A candidate within 200 m of a better one has no share of its own: the better one's confidence
    and covariance include it.
    """
    if not candidates:
        none = np.zeros(0)
        return _Shares(_Spots(none, none, np.zeros((0, 2, 2)), none), 0.0, 1.0)
    place = np.array([(one.easting_m, one.northing_m) for one in candidates])
    apart_m = np.hypot(*(place[:, np.newaxis] - place).T)
    is_near = np.tril(apart_m <= RIGHT_WITHIN_M, -1).any(axis=1)
    share = np.array([one.confidence or 0.0 for one in candidates]) * ~is_near
    within_1km = float(share[apart_m[0] <= ROUGHLY_WITHIN_M].sum())
    roughly = max(0.0, (candidates[0].confidence_1km or 0.0) - within_1km)
    left = max(0.0, 1.0 - float(share.sum()) - roughly)
    unknown = ((SPREAD.unknown_sd_m**2, 0.0), (0.0, SPREAD.unknown_sd_m**2))
    covariance_m2 = np.array([one.covariance_m2 or unknown for one in candidates])
    return _Shares(_Spots(place[:, 0], place[:, 1], covariance_m2, share), roughly, left)


def _softmax(values: Float64Array) -> Float64Array:
    weight = np.exp(values - values.max())
    return np.asarray(weight / weight.sum())


class _Layer:
    """Cells to which distributions are added."""

    def __init__(self, grid: CellGrid) -> None:
        self.grid = grid
        self.probability = np.zeros(grid.shape)

    def add_spot(self, spot: _Spots) -> None:
        """Add a candidate's distribution, as far as it lies on the grid."""
        # Half a cell is added, so that a narrow distribution reaches the middle of a cell.
        grid = self.grid
        covariance = spot.covariance_m2[0] + (0.5 * grid.cell_m) ** 2 * np.eye(2)
        reach = SPREAD.reach_sds * np.sqrt(np.diag(covariance))
        col = _cells(spot.easting_m[0] - grid.west_m, reach[0], grid.cell_m, grid.cols)
        row = _cells(grid.north_m - spot.northing_m[0], reach[1], grid.cell_m, grid.rows)
        if col.start >= col.stop or row.start >= row.stop:
            return
        east = grid.eastings_m()[col] - spot.easting_m[0]
        north = grid.northings_m()[row] - spot.northing_m[0]
        density = _density(covariance, east, north)
        self.probability[row, col] += spot.share[0] * grid.cell_m**2 * density

    def add_round(
        self,
        easting_m: Float64Array,
        northing_m: Float64Array,
        sd_m: Float64Array,
        share: Float64Array,
    ) -> None:
        """Add round normal distributions, whose deviations are of several cells or more.

        They are blurred on a coarser grid, in groups of nearly equal deviations.
        """
        grid = self.grid
        step = max(1, int(sd_m.min() / (2.0 * grid.cell_m)))
        shape = -(-grid.rows // step), -(-grid.cols // step)
        side_m = step * grid.cell_m
        # Poses are fitted a little outside the squares of places, too.
        row = np.clip((grid.north_m - northing_m) // side_m, 0, shape[0] - 1).astype(np.intp)
        col = np.clip((easting_m - grid.west_m) // side_m, 0, shape[1] - 1).astype(np.intp)
        cell = np.ravel_multi_index((row, col), shape)
        level = np.rint(2.0 * np.log2(sd_m)).astype(np.intp)
        total = np.zeros(shape)
        for one in np.unique(level):
            some = level == one
            counted = np.bincount(cell[some], share[some], minlength=total.size).reshape(shape)
            sigma = float(2.0 ** (0.5 * one)) / side_m
            total += cv2.GaussianBlur(counted, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
        self.probability += on_finer_cells(total, step, grid.shape) / step**2


def on_finer_cells(coarse: Float64Array, step: int, shape: tuple[int, int]) -> Float64Array:
    """Return the bilinear values (rows, cols) of cells ``step`` times as wide."""
    rows, cols = coarse.shape
    finer = cv2.resize(coarse, (cols * step, rows * step), interpolation=cv2.INTER_LINEAR)
    return np.asarray(finer[: shape[0], : shape[1]])


def _density(
    covariance_m2: Float64Array, east_m: Float64Array, north_m: Float64Array
) -> Float64Array:
    """Return Student's t per square metre (R, C), at offsets in metres."""
    freedom = SPREAD.freedom
    scale = -2.0 * math.log(0.05) / (freedom * (0.05 ** (-2.0 / freedom) - 1.0))
    precision = np.linalg.inv(scale * covariance_m2)
    north_m = north_m[:, np.newaxis]
    squares = precision[0, 0] * east_m**2 + precision[1, 1] * north_m**2
    squares = squares + 2.0 * precision[0, 1] * east_m * north_m
    peak = math.sqrt(np.linalg.det(precision)) / (2.0 * math.pi)
    return np.asarray(peak * (1.0 + squares / freedom) ** (-0.5 * freedom - 1.0))


def _cells(middle_m: float, reach_m: float, cell_m: float, count: int) -> slice:
    """Return the cells of a row within a reach of a point."""
    begin = math.floor((middle_m - reach_m) / cell_m)
    return slice(max(begin, 0), min(math.ceil((middle_m + reach_m) / cell_m), count))
