"""The plan of places: as dense as the skylines are near, whichever process plans it."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import field_of

from skyline.skylines import Horizons
from skyline.store.places import BINS, Places
from skyline.survey import adaptive_places
from skyline.survey.adaptive_places import (
    BLOCK_M,
    BegunPlaces,
    blocks_of,
    planned_places,
)
from skyline.survey.expected_losses import expected_finds, lost_shares

AREA = (0.0, 0.0, 2.0 * BLOCK_M, BLOCK_M)
SPACINGS_M = 1280.0 / 2.0 ** (np.arange(15) / 2.0)

EAST, NORTH = np.meshgrid(np.arange(-960.0, 6081.0, 80.0), np.arange(6080.0, -961.0, -80.0))
"""Of samples in a block and round about. The lattices down to a spacing of 80 m lie on them."""
NODE_M = np.hypot(EAST - 2560.0, NORTH - 2560.0)
"""Distance from a node of the coarsest lattice."""
RANDOM = np.random.default_rng(2).random(EAST.shape)

HOLES = {
    "all but a disc between the coarsest nodes": np.hypot(EAST - 1920.0, NORTH - 1920.0) > 500.0,
    "all but one triangle": NODE_M + (EAST < 2560.0) + (NORTH < 2560.0) > 80.0,
    "a third, scattered": RANDOM < 0.3,
    "all": NODE_M >= 0.0,
}


def looking(distance_m):
    """Return a renderer of skylines at a distance that depends on the easting."""

    def look(eyes):
        shape = (len(eyes), BINS)
        distance = np.broadcast_to(distance_m(eyes.easting_m)[:, None], shape)
        nothing, place = np.zeros(shape, np.float32), (eyes.easting_m, eyes.northing_m)
        flags = nothing.astype(np.uint8)
        elevation_m = eyes.eye_elevation_m
        return BegunPlaces.of(Horizons(*place, elevation_m, nothing, np.float32(distance), flags))

    return look


def planned(terrain, distance_m, price, area=AREA):
    blocks = blocks_of(area)
    look = looking(distance_m)
    return Places.concatenate([planned_places(terrain, look, area, price, one) for one in blocks])


@pytest.fixture(scope="module")
def plain():
    return field_of(np.full((140, 140), 500.0), 100.0, west_m=-1500.0, north_m=7500.0)


def price_of_level(level, distance_m):
    """Return a price at which a level is the best where all skylines are at one distance."""
    lost = lost_shares(np.full((1, BINS), distance_m, dtype=np.float32), SPACINGS_M)
    prices = np.geomspace(1e-2, 1e8, 2000)
    best = np.argmin(lost + prices[:, None] / SPACINGS_M**2, axis=1)
    return float(np.median(prices[best == level]))


def positions(places):
    return set(zip(places.easting_m.tolist(), places.northing_m.tolist(), strict=True))


def near_in_the_west(easting_m):
    return np.where(easting_m < BLOCK_M, 300.0, 3e4)


class TestPrice:
    look = staticmethod(looking(near_in_the_west))

    @pytest.mark.parametrize("loss", [0.05, 0.35])
    def test_it_suits_the_loss(self, plain, loss):
        price = adaptive_places.Prices(plain, AREA, self.look).of_loss(loss)
        lost = self.look(adaptive_places.spread_over(plain, AREA)[0]).lost

        def lost_at(price):
            level = np.argmin(lost + price / SPACINGS_M**2, axis=1)
            return lost[np.arange(len(lost)), level].mean()

        # At the price itself two spacings may cost the same.
        assert lost_at(0.999 * price) <= loss < lost_at(1.001 * price)

    @pytest.mark.parametrize("number", [1000, 20_000])
    def test_it_suits_the_number(self, plain, number):
        price = adaptive_places.Prices(plain, AREA, self.look).of_number(number)
        places = planned(plain, near_in_the_west, price)
        # Spacings are steps of the root of 2, so numbers are steps of 2 where all is alike.
        assert number <= 1.05 * len(places) <= 2.1 * number
        assert adaptive_places.Prices(plain, AREA, self.look).places(price) == pytest.approx(
            len(places), rel=0.1
        )


class TestPlan:
    @pytest.mark.parametrize("level", [0, 7])
    def test_the_same_all_over_makes_a_lattice(self, plain, level):
        price = price_of_level(level, 2000.0)
        places = planned(plain, lambda easting: np.full(len(easting), 2000.0), price)
        assert np.unique(places.tolerance_m) == np.float32(SPACINGS_M[level] / 2.0)
        # Places on the far sides of the area belong to blocks beyond it.
        assert len(places) == len(positions(places))
        assert len(places) == round(AREA[2] * AREA[3] / SPACINGS_M[level] ** 2)

    def test_it_is_dense_where_skylines_are_near(self, plain):
        look = looking(near_in_the_west)
        price = adaptive_places.Prices(plain, AREA, look).of_loss(0.15)
        lost = look(adaptive_places.spread_over(plain, AREA)[0]).lost
        wanted = SPACINGS_M[np.argmin(lost + price / SPACINGS_M**2, axis=1)]
        places = planned(plain, near_in_the_west, price)
        west = places.easting_m < BLOCK_M
        assert np.median(places.tolerance_m[west]) == np.float32(wanted.min() / 2.0)
        assert np.median(places.tolerance_m[~west]) == np.float32(wanted.max() / 2.0)
        assert len(places) == len(positions(places))
        # Every location has one place to itself.
        own_m2 = (2.0 * places.tolerance_m.astype(float)) ** 2
        assert own_m2.sum() == pytest.approx(AREA[2] * AREA[3], rel=1e-6)

    @pytest.mark.parametrize("hole", HOLES)
    def test_holes_of_every_shape(self, hole):
        """Places are the samples with heights that a lattice of 160 m has nodes at."""
        heights_m = np.where(HOLES[hole], np.nan, 500.0)
        field = field_of(heights_m, 80.0, west_m=EAST.min(), north_m=NORTH.max())
        block, price = (0.0, 0.0, BLOCK_M, BLOCK_M), price_of_level(6, 500.0)
        places = planned(field, lambda easting: np.full(len(easting), 500.0), price, block)
        within = (EAST >= 0.0) & (EAST < BLOCK_M) & (NORTH >= 0.0) & (NORTH < BLOCK_M)
        stands = within & (EAST % 160.0 == 0.0) & (NORTH % 160.0 == 0.0) & ~HOLES[hole]
        wanted = set(zip(EAST[stands].tolist(), NORTH[stands].tolist(), strict=True))
        assert positions(places) == wanted
        assert len(places) == len(wanted)


class TestExpectedFinds:
    def test_they_are_means_of_the_area_by_distance(self):
        """A near place of 10 m and a far one of 160 m stand for 256 times the area."""
        distance_m = np.repeat(np.float32([[50.0], [5000.0]]), BINS, axis=1)
        nothing = np.zeros((2, BINS), np.float32)
        east_m = np.zeros(2)
        seen = Horizons(east_m, east_m, east_m, nothing, distance_m, nothing.astype(np.uint8))
        tolerance_m = np.float32([5.0, 80.0])
        places = replace(Places.of(seen, 0.0), tolerance_m=tolerance_m)
        (near_m, near_share, near_found), (far_m, far_share, far_found) = expected_finds(places)
        assert (near_m, far_m) == (0.0, 400.0)
        assert (near_share, far_share) == pytest.approx((1.0 / 257.0, 256.0 / 257.0))
        assert (near_found, far_found) == pytest.approx((0.673, 0.992), abs=5e-4)
