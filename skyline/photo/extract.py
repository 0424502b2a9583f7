"""Photo to query skyline: sky and ground told apart by colour, edges and smoothness.

A skyline is one border row per column, so labelling a photo "sky above, ground below" is a
shortest path through the columns, solved exactly by dynamic programming. A path is cheap where
what lies above it has the sky's colours and no sharp edges, what lies just below it has the
ground's colours, it runs along a sharp edge, and it is not steep. Nothing is trained beforehand:
the colours of sky and ground are learnt from the photo itself, in turns with the path. The path
is found at about 0.7 million pixels, then refined to sub-pixel in a narrow band of the full photo.
"""

import logging
from dataclasses import dataclass, replace
from math import ceil
from typing import Self

import numpy as np
from scipy import ndimage

from skyline.arrays import BoolArray, Float32Array, Float64Array, IntArray, UInt8Array
from skyline.errors import InputError
from skyline.photo.evidence import (
    ColourModel,
    Evidence,
    daylight_groundness,
    gather_evidence,
    to_lab,
)
from skyline.photo.frame import Content, content_of
from skyline.photo.occluders import occluded
from skyline.photo.paths import Steps, detours, shortest_path
from skyline.photo.query import QuerySkyline

log = logging.getLogger(__name__)


TRUST_THRESHOLD = 0.25
"""Columns of less confidence are masked."""
MIN_TRUSTED_SHARE = 0.1
"""A photo with a smaller share of trusted columns has no skyline."""

# All prices are in units of the reward for one column along a full edge.
_STRICT_CROSSING_PRICE = 1.0
_CROSSING_PRICES = (0.3, 0.5, 0.7)
"""Price of an edge pixel above the path. A low price takes snow over rock for sky, a high one
clouds for ground: what both agree on is trusted, the lowest price first."""
_MIN_AGREEMENT = 0.5
"""Share of the columns in which a price must agree with the strict one to be believed."""
_CROSSING_SATURATES = 3.0
"""Edge pixels after which more cost little: a logo in the sky is not worth a detour."""
_COLOUR_PRICE = 0.04
"""Price of one pixel that has the other side's colours."""
_GROUND_BAND_SHARE = 0.12
"""Share of the rows, just below the path, that should have ground colours; deeper, lakes and
glaciers may look like sky."""
STEPS = Steps(reach_rows=12, price_per_row=0.07, jump_price=3.0)
_NO_SKY_SHARE = 0.9
"""Share of the columns without any sky at which daylight has misled."""
_MAX_ROUNDS = 6
_SETTLED_SHARE = 0.002
"""The path has settled when fewer columns than this move by more than a pixel in a round."""

_RIVAL_DISTANCE_SHARE = 0.012
"""Share of the rows beyond which another path is a rival, not the same skyline."""
_CLEAR_MARGIN = 1.0
"""Extra cost of the best rival at which confidence in its absence is 1 - 1/e."""
_OUTCROP_SHARE = 0.006
"""Share of the rows by which the path may have settled on rock just below a snowy skyline."""
_TOPMOST_STEPS = Steps(reach_rows=12, price_per_row=0.15, jump_price=3.0)
FORBIDDEN = 1e3

_REFINE_STEPS = Steps(reach_rows=2, price_per_row=0.05, jump_price=1.0)
_REFINE_REACH = 1.5
"""Working pixels by which a working path may be off; at least three photo pixels are searched."""


@dataclass(frozen=True, slots=True, eq=False)
class Border:
    """The path at working size, with what its confidence rests on.

    Attributes
    ----------
    row : (w,) intp
    cost : (h, w) float32
        Of which it is the cheapest path.
    groundness : (h, w) float32
        See `ColourModel.groundness`.
    """

    row: IntArray
    cost: Float32Array
    groundness: Float32Array


def extract_skyline(image: UInt8Array) -> QuerySkyline:
    """Find the skyline of a photo.

    Uniform borders and caption bars are set aside; columns whose skyline is not clear, lies on
    the photo's edge or belongs to a narrow upright thing are masked, not guessed.

    Parameters
    ----------
    image : (H, W, 3) uint8
        RGB, upright.

    Returns
    -------
    QuerySkyline
        In pixels of ``image``, field of view unknown.

    Raises
    ------
    InputError
        Not such an array, too small, or without a skyline.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            f"image has shape {image.shape} and type {image.dtype}; expected (H, W, 3) uint8 RGB"
        )
    extraction = Extraction.of(image)
    query = extraction.query(extraction.row_px, extraction.confidence)
    _require_skyline(query, extraction.content)
    return query


@dataclass(frozen=True, slots=True, eq=False)
class Extraction:
    """A photo's skyline with what it was found from, so that it can be found again.

    Attributes
    ----------
    shape : (int, int)
        Height and width of the image.
    content : Content
        What of the image is photo.
    photo : (H, W, 3) uint8
        That part.
    evidence : Evidence
    border : Border
        The path found at working size.
    row_px, confidence : (W,) float64
        Of the photo's columns, whether trusted or not.
    """

    shape: tuple[int, int]
    content: Content
    photo: UInt8Array
    evidence: Evidence
    border: Border
    row_px: Float64Array
    confidence: Float64Array

    @classmethod
    def of(cls, image: UInt8Array) -> Self:
        """Find the skyline of an image (H, W, 3) uint8; raises as `content_of`."""
        content = content_of(image)
        photo = content.crop(image)
        evidence = gather_evidence(photo)
        border, agreed = _find_border(evidence)
        at_work = to_work_columns(photo.shape[1], evidence)
        sure = np.where(agreed, _confidence(evidence, border), 0.0)
        confidence = np.interp(at_work, np.arange(len(sure)), sure)
        row = to_photo_rows(border.row, evidence, at_work)
        row_px = refine_rows(photo, row, evidence.row_scale)
        return cls(
            (image.shape[0], image.shape[1]), content, photo, evidence, border, row_px, confidence
        )

    def query(self, row_px: Float64Array, confidence: Float64Array) -> QuerySkyline:
        """Return rows of the photo's columns as a query of the image, doubtful ones masked."""
        return _within(row_px, confidence, self.content, self.shape)


def _find_border(evidence: Evidence) -> tuple[Border, BoolArray]:
    """Find the border at working size, and the columns where it does not hang on one price."""
    colours = ColourModel(evidence.lab)
    start = _first_path(evidence)
    strict = _settle(evidence, colours, start, _STRICT_CROSSING_PRICE)
    for price in _CROSSING_PRICES:
        border = _settle(evidence, colours, start, price)
        agreed = np.abs(border.row - strict.row) <= _rival_distance(len(evidence.edges))
        if agreed.mean() >= _MIN_AGREEMENT:
            return replace(border, row=topmost(evidence.edges, border.row)), agreed
    return strict, np.zeros(len(start), dtype=bool)


def _first_path(evidence: Evidence) -> IntArray:
    """Return the path along sharp edges under nothing but smoothness and daylight."""
    cost = _edge_cost(evidence.edges, _STRICT_CROSSING_PRICE)
    row = shortest_path(cost + _colour_cost(daylight_groundness(evidence.lab)), STEPS)
    # Under a dark sky over snow everything up to the top would be ground.
    no_sky = np.mean(row <= 2) > _NO_SKY_SHARE
    return shortest_path(cost, STEPS) if no_sky else row


def _settle(
    evidence: Evidence, colours: ColourModel, start: IntArray, crossing_price: float
) -> Border:
    """Learn the colours on the path's two sides and find the path, in turns, until it settles."""
    rows = np.arange(len(evidence.edges))[:, np.newaxis]
    edge_cost = _edge_cost(evidence.edges, crossing_price)
    border = Border(start, edge_cost, np.zeros_like(evidence.edges))
    for _ in range(_MAX_ROUNDS):
        groundness = colours.groundness(rows < border.row, rows > border.row)
        cost = edge_cost + _colour_cost(groundness)
        before, border = border, Border(shortest_path(cost, STEPS), cost, groundness)
        if np.mean(np.abs(border.row - before.row) > 1) < _SETTLED_SHARE:
            break
    return border


def topmost(edges: Float32Array, row: IntArray) -> IntArray:
    """Return the path moved to the topmost clear edge near it: rock outcrops lie under snow."""
    height = len(edges)
    away = np.abs(np.arange(height)[:, np.newaxis] - row)
    near = away <= max(2, round(_OUTCROP_SHARE * height))
    cost = _edge_cost(np.where(near, edges, np.float32(0.0)), _STRICT_CROSSING_PRICE)
    return shortest_path(np.where(near, cost, np.float32(FORBIDDEN)), _TOPMOST_STEPS)


def _rival_distance(height: int) -> int:
    """Return the rows beyond which another path is not the same skyline."""
    return max(3, round(_RIVAL_DISTANCE_SHARE * height))


def _edge_cost(edges: Float32Array, crossing_price: float) -> Float32Array:
    """Return the price of the edges crossed above each pixel less the reward for its own."""
    crossed = np.zeros_like(edges)
    # The path's own edge is up to three pixels wide and not yet crossed.
    crossed[3:] = np.cumsum(edges, axis=0)[:-3]
    saturated = _CROSSING_SATURATES * (1.0 - np.exp(-crossed / _CROSSING_SATURATES))
    return np.asarray(crossing_price * saturated - edges, dtype=np.float32)


def _colour_cost(groundness: Float32Array) -> Float32Array:
    """Return the price of ground colours above and sky colours just below each pixel."""
    height, width = groundness.shape
    band = max(4, round(_GROUND_BAND_SHARE * height))
    none = np.zeros((1, width), dtype=np.float32)
    ground_above = np.vstack([none, np.cumsum(np.maximum(groundness, 0.0), axis=0)])
    sky_above = np.vstack([none, np.cumsum(np.maximum(-groundness, 0.0), axis=0)])
    band_end = np.minimum(np.arange(height) + band, height)
    sky_below = sky_above[band_end] - sky_above[:height]
    return np.asarray(_COLOUR_PRICE * (ground_above[:height] + sky_below), dtype=np.float32)


def _confidence(evidence: Evidence, border: Border) -> Float64Array:
    """Return each working column's confidence, 0 to 1: edge x no rival x colours apart."""
    height = len(evidence.edges)
    away = np.abs(np.arange(height)[:, np.newaxis] - border.row)
    detour = detours(border.cost, STEPS)
    rival = np.where(away > _rival_distance(height), detour, np.inf).min(axis=0)
    margin = 1.0 - np.exp(-rival / _CLEAR_MARGIN)
    confidence = ndimage.median_filter(clearness(evidence, border) * margin, 5, mode="nearest")
    outside = (border.row <= 2) | (border.row >= height - 3)
    confidence[outside | occluded(evidence, border.row)] = 0.0
    return np.asarray(confidence, dtype=np.float64)


def clearness(evidence: Evidence, border: Border) -> Float64Array:
    """Return 0 to 1 per column: how sharp the edge is, times how far the colours are apart."""
    away = np.abs(np.arange(len(evidence.edges))[:, np.newaxis] - border.row)
    edge = np.sqrt(np.where(away <= 1, evidence.edges, 0.0).max(axis=0))
    return np.asarray(edge * _colour_contrast(border), dtype=np.float64)


def _colour_contrast(border: Border) -> Float64Array:
    """Return how far the colours just above and just below are apart, 0 to 1 per column."""
    height = len(border.groundness)
    band = max(4, round(_GROUND_BAND_SHARE * height / 2.0))
    total = np.vstack([np.zeros_like(border.groundness[:1]), border.groundness.cumsum(axis=0)])
    columns = np.arange(len(border.row))

    def mean_between(start: IntArray, stop: IntArray) -> Float64Array:
        start, stop = np.clip(start, 0, height), np.clip(stop, 0, height)
        sums = total[stop, columns] - total[start, columns]
        return np.asarray(sums / np.maximum(stop - start, 1), dtype=np.float64)

    above = mean_between(border.row - 1 - band, border.row - 1)
    below = mean_between(border.row + 2, border.row + 2 + band)
    return np.asarray(np.clip(below - above, 0.0, 1.0), dtype=np.float64)


def to_work_columns(width: int, evidence: Evidence) -> Float64Array:
    """Return where each photo column's centre lies at working size."""
    at_work = (np.arange(width) + 0.5) * evidence.edges.shape[1] / width - 0.5
    return np.asarray(at_work, dtype=np.float64)


def to_photo_rows(row: IntArray, evidence: Evidence, at_work: Float64Array) -> Float64Array:
    """Return a working path's row in each photo column, photo pixels."""
    return (np.interp(at_work, np.arange(len(row)), row) + 0.5) / evidence.row_scale - 0.5


def refine_rows(photo: UInt8Array, row: Float64Array, scale: float) -> Float64Array:
    """Return the rows of the steepest change near a path, to sub-pixel.

    Within a band around the path a second shortest path follows the greatest difference between
    the two pixels above and the two below a border; a parabola through the three differences
    around it gives the fraction.
    """
    height, width = photo.shape[:2]
    reach = max(3, ceil(_REFINE_REACH / scale))
    centre = np.round(row).astype(np.intp)
    # Borders r - 0.5 for r = centre - reach ... centre + reach need two more rows either side.
    rows = centre + np.arange(-reach - 2, reach + 2)[:, np.newaxis]
    lab = to_lab(photo[np.clip(rows, 0, height - 1), np.arange(width)])
    below, above = lab[2:-1] + lab[3:], lab[:-3] + lab[1:-2]
    step = np.linalg.norm(below - above, axis=2) / 2.0
    strength = step / (step.max(axis=0) + 1.0)
    best = shortest_path((-strength).astype(np.float32), _REFINE_STEPS)
    columns = np.arange(width)
    inner = np.clip(best, 1, len(step) - 2)
    before, at, after = (step[inner + k, columns] for k in (-1, 0, 1))
    bend = before - 2.0 * at + after
    peaked = bend < 0.0
    shift = np.where(peaked, 0.5 * (before - after) / np.where(peaked, bend, 1.0), 0.0)
    return np.asarray(centre - reach + inner - 0.5 + np.clip(shift, -0.5, 0.5), dtype=np.float64)


def _within(
    row_px: Float64Array, confidence: Float64Array, content: Content, shape: tuple[int, ...]
) -> QuerySkyline:
    """Return the query of the whole image, doubtful columns and borders masked."""
    height, width = shape[:2]
    trusted = confidence >= TRUST_THRESHOLD
    whole_row, whole_confidence = np.full(width, np.nan), np.zeros(width)
    inside = slice(content.left, content.right)
    whole_row[inside] = np.where(trusted, row_px + content.top, np.nan)
    whole_confidence[inside] = np.where(trusted, confidence, 0.0)
    return QuerySkyline(whole_row, whole_confidence, width, height)


def _require_skyline(query: QuerySkyline, content: Content) -> None:
    share = float(query.trusted[content.left : content.right].mean())
    log.debug("skyline trusted in %.0f %% of the columns", 100.0 * share)
    if share < MIN_TRUSTED_SHARE:
        raise InputError(
            f"no skyline found: {100.0 * share:.0f} % of the columns show a clear border between "
            f"sky and ground, expected at least {100.0 * MIN_TRUSTED_SHARE:.0f} %; draw it as a "
            "trace (CSV column_px,row_px) or a mask (PNG, white = sky)"
        )
