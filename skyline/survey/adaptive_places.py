"""Places that are dense where skylines are near, else sparse.

The plan is a tree of nested lattices. Places of the coarsest lattice are rendered first. A place's
skyline shows whether more places there would save more views than as many places in other squares.
Where they would, the next lattice, twice as dense, is filled in. Every rendered place is kept. Each
block of the map is planned on its own, and the result depends neither on the process that plans a
block nor on the order.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import Float64Array, Int64Array, IntArray, Rows
from skyline.errors import InputError
from skyline.geodesy.map_frame import Rectangle, in_rectangle
from skyline.skylines import Horizons
from skyline.store.places import Places
from skyline.survey.expected_losses import lost_shares
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_where_possible


@dataclass(frozen=True, slots=True)
class Nesting:
    """A block's nested lattices, each twice as dense as the last."""

    coarsest_m: float = 1280.0
    """Spacing of the coarsest lattice, a whole multiple of the finest."""
    finest_m: float = 10.0
    """Spacing of the finest lattice."""
    roots: int = 4
    """Squares of the coarsest lattice along a side of a block."""
    blind_level: int = 6
    """Level down to which a square is divided if there is no surface to stand on at its corner."""


@dataclass(frozen=True, slots=True)
class PriceSample:
    """The viewpoints from which a price is computed."""

    size: int = 512
    """Number of locations that are tried together."""
    least: int = 64
    """Number of viewpoints that must stand on the surface."""
    most_tries: int = 256
    """Greatest number of samples tried to find them: in the elevation model of an island, nearly
    all locations may be holes."""


_NESTING = Nesting()
_PRICE_SAMPLE = PriceSample()

_UNITS = round(_NESTING.coarsest_m / _NESTING.finest_m)
"""The coarsest spacing, in finest spacings."""

LEVELS = 2 * _UNITS.bit_length() - 1
"""Number of lattices."""

_SPACING_M: Float64Array = _NESTING.coarsest_m / 2.0 ** (np.arange(LEVELS) / 2.0)
"""Spacing of each level's lattice: the side of the square that each place has to itself."""

_DENSITY = 1.0 / _SPACING_M**2
"""Places a square metre of each level."""

BLOCK_M = _NESTING.roots * _NESTING.coarsest_m
"""Side of a block."""

NODES_AROUND = (_NESTING.roots + 2) ** 2 - _NESTING.roots**2
"""Nodes around a block that are rendered for the squares at its sides."""


@dataclass(frozen=True, slots=True, eq=False)
class BegunPlaces(Rows):
    """N places of an unfinished plan, as `BEGUN` rows hold them."""

    places: Places
    """The places, whose tolerances are not set yet."""
    lost: Float64Array
    """Shares (N, LEVELS) of the views round each place that each spacing is expected to lose."""

    @classmethod
    def of(cls, horizons: Horizons) -> "BegunPlaces":
        """Return the begun places of rendered skylines in 360 bins."""
        return cls(Places.of(horizons, 0.0), lost_shares(horizons.distance_m, _SPACING_M))


RenderBegun = Callable[[Viewpoints], BegunPlaces]
"""Renders viewpoints, and returns their places."""


def blocks_of(area: Rectangle) -> list[tuple[int, int]]:
    """Return the blocks that meet an area, by rows from the north-west.

    A block is a square with sides of `BLOCK_M`. Its western and southern sides lie at its column
    and its row times `BLOCK_M`.
    """
    west, south, east, north = (side / BLOCK_M for side in area)
    rows = range(math.ceil(north) - 1, math.floor(south) - 1, -1)
    return [(col, row) for row in rows for col in range(math.floor(west), math.ceil(east))]


class Prices:
    """Prices of plans for an area.

    A price is the area, in square metres, whose views a place must save to be part of a plan.
    Prices are computed from skylines at viewpoints spread over the area. Raises `InputError` for an
    area of holes.
    """

    def __init__(self, terrain: HeightField, area: Rectangle, render: RenderBegun) -> None:
        eyes, self._surface_m2 = spread_over(terrain, area)
        self._lost = render(eyes).lost

    def of_loss(self, loss: float) -> float:
        """Return the highest price at which at most this share is lost.

        The lowest price is returned if every plan loses more.
        """
        rows = np.arange(len(self._lost))
        return self._limit(lambda level: float(self._lost[rows, level].mean()) > loss)

    def of_number(self, number: int) -> float:
        """Return the price of a plan of about this many places."""
        return self._limit(lambda level: self._surface_m2 * _DENSITY[level].mean() < number)

    def places(self, price: float) -> int:
        """Return about how many places a plan of a price has."""
        return round(self._surface_m2 * float(_DENSITY[self._levels(price)].mean()))

    def _levels(self, price: float) -> IntArray:
        """Return the level that costs least at each viewpoint."""
        levels: IntArray = np.argmin(self._lost + price * _DENSITY, axis=1)
        return levels

    def _limit(self, is_too_coarse: Callable[[IntArray], bool]) -> float:
        """Return the highest price whose levels are not too coarse."""
        # From less than any place can save to more than a whole square of the coarsest lattice.
        low, high = 1e-3, 1e12
        for _ in range(60):
            price = float(np.sqrt(low * high))
            if is_too_coarse(self._levels(price)):
                high = price
            else:
                low = price
        return low


def spread_over(terrain: HeightField, area: Rectangle) -> tuple[Viewpoints, float]:
    """Return viewpoints spread evenly over an area, and its surface (m2).

    There are about 64 to 512 of them, always the same; fewer if less than 0.05 % of the area has a
    surface. Raises `InputError` if none of 131,072 locations has one.
    """
    # The sequence of the plastic number (Roberts 2018) fills a square evenly, however long it is.
    step = np.array([0.7548776662466927, 0.5698402909980532])
    west, south, east, north = area
    found: list[Viewpoints] = []
    tried = 0
    size = _PRICE_SAMPLE.size
    most = _PRICE_SAMPLE.most_tries * size
    while tried < most and sum(map(len, found)) < _PRICE_SAMPLE.least:
        share = (0.5 + (tried + np.arange(1, size + 1))[:, None] * step) % 1.0
        easting = west + share[:, 0] * (east - west)
        northing = south + share[:, 1] * (north - south)
        found.append(stand_where_possible(terrain, easting, northing)[0])
        tried += size
    eyes = Viewpoints.concatenate(found)
    if not len(eyes):
        raise InputError(
            f"no viewpoint falls on the surface in easting {west:.0f} to {east:.0f}, northing "
            f"{south:.0f} to {north:.0f}; choose another area"
        )
    return eyes, (east - west) * (north - south) * len(eyes) / tried


def planned_places(
    terrain: HeightField, render: RenderBegun, area: Rectangle, price: float, block: tuple[int, int]
) -> Places:
    """Lay out and render a block's places, by rows from the north-west.

    ``price`` is computed by `Prices`; places outside the area are not kept.
    """
    seen = _Seen(terrain, render, block)
    # Nodes around the block are included, for the squares at its sides.
    seen.fill(_lattice_of_roots(-1, _NESTING.roots + 2))
    nodes = _lattice_of_roots(0, _NESTING.roots)
    rows = []
    tolerances_m = []
    west, south, east, north = area
    for level in range(LEVELS):
        # Only squares that meet the area are kept.
        left_m, low_m = seen.position_m(nodes - nodes % _side(level))
        side_m = _side(level) * _NESTING.finest_m
        meets = (left_m <= east) & (left_m + side_m > west)
        nodes = nodes[meets & (low_m <= north) & (low_m + side_m > south)]
        seen.fill(nodes)
        # They are divided where a denser lattice pays.
        halved = np.zeros(len(nodes), dtype=bool)
        if level < LEVELS - 1:
            cost = seen.lost_around(nodes, level) + price * _DENSITY
            pays = cost[:, level + 1 :].min(axis=1) < cost[:, level]
            halved = np.where(np.isnan(cost[:, 0]), level < _NESTING.blind_level, pays)
        rows.append(seen.rows(nodes[~halved]))
        tolerances_m.append(np.full(len(rows[-1]), _SPACING_M[level] / 2.0, np.float32))
        nodes = _next_lattice(nodes[halved], level)
    some = Places.concatenate(seen.places)[np.concatenate(rows)]
    places = replace(some, tolerance_m=np.concatenate(tolerances_m))
    places = places[in_rectangle(area, places.easting_m, places.northing_m)]
    return places[np.lexsort((places.easting_m, -places.northing_m))]


_UNTRIED = -2
"""Row of a node that was not tried."""

_BARE = -1
"""Row of a node without a surface to stand on."""


class _Seen:
    """The nodes in and around a block, and their places.

    Nodes are columns and rows of the finest lattice, from the block's south-western corner.
    """

    def __init__(self, terrain: HeightField, render: RenderBegun, block: tuple[int, int]) -> None:
        self._terrain = terrain
        self._render = render
        self._corner_m = np.array(block) * BLOCK_M
        self._row: Int64Array = np.full(2 * ((_NESTING.roots + 2) * _UNITS,), _UNTRIED)
        self._lost: Float64Array = np.zeros((0, LEVELS))
        self.places: list[Places] = []

    def position_m(self, nodes: Int64Array) -> tuple[Float64Array, Float64Array]:
        """Return the eastings and northings of nodes (N, 2)."""
        position = self._corner_m + nodes * _NESTING.finest_m
        return position[:, 0], position[:, 1]

    def fill(self, nodes: Int64Array) -> None:
        """Render the nodes (N, 2) that have not been tried yet."""
        nodes = nodes[self._row[_index(nodes)] == _UNTRIED]
        eyes, stands = stand_where_possible(self._terrain, *self.position_m(nodes))
        self._row[_index(nodes)] = _BARE
        self._row[_index(nodes[stands])] = len(self._lost) + np.arange(len(eyes))
        begun = self._render(eyes)
        self.places.append(begun.places)
        self._lost = np.concatenate([self._lost, begun.lost])

    def rows(self, nodes: Int64Array) -> Int64Array:
        """Return the rows, in `places`, of nodes (N, 2) with a place."""
        row = self._row[_index(nodes)]
        return row[row >= 0]

    def lost_around(self, nodes: Int64Array, level: int) -> Float64Array:
        """Return what each spacing loses at nodes (N, 2) and their neighbours.

        The shares (N, levels) are means over the nodes that have places; NaN where none has.
        """
        side = _side(level)
        steps = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)]) * side
        if level % 2:
            steps = np.array([(1, 1), (-1, 1), (1, -1), (-1, -1)]) * (side // 2)
        around = nodes[:, None] + np.concatenate([np.zeros((1, 2), np.int64), steps])
        row = self._row[_index(around)]
        known = row >= 0
        lost = np.zeros((*known.shape, LEVELS))
        lost[known] = self._lost[row[known]]
        number = known.sum(axis=1)[:, None]
        return np.where(number > 0, lost.sum(axis=1) / np.maximum(number, 1), np.nan)


def _index(nodes: Int64Array) -> tuple[Int64Array, Int64Array]:
    """Return the indices of nodes (..., 2) in `_Seen._row`."""
    return nodes[..., 0] + _UNITS, nodes[..., 1] + _UNITS


def _side(level: int) -> int:
    """Return the side of a level's squares, in finest spacings.

    Places of an even level lie at the corners; an odd level also has one in the middle of each
    square.
    """
    return _UNITS >> level // 2


def _lattice_of_roots(first: int, number: int) -> Int64Array:
    """Return a square of nodes (N, 2) of the coarsest lattice."""
    at = np.arange(first, first + number) * _UNITS
    return np.stack(np.meshgrid(at, at), axis=2).reshape(-1, 2)


def _next_lattice(nodes: Int64Array, level: int) -> Int64Array:
    """Return nodes (N, 2), and the nodes that the next level adds."""
    half = _side(level) // 2
    beside = nodes + half
    if level % 2:
        # A corner adds the middle of one side, and a square's middle the middle of another side.
        step = np.where(nodes[:, 0] % _side(level) == 0, half, -half)
        beside = nodes + np.stack([step, np.zeros_like(step)], axis=1)
    return np.concatenate([nodes, beside])
