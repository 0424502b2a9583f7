"""The plan of places: as dense as the skylines are near, the same whoever plans it."""

import numpy as np
import pytest
from scenes import field_of

from skyline.errors import InputError
from skyline.horizons import Horizons
from skyline.places import BINS, Places
from skyline.planning.adaptive import (
    BLOCK_M,
    AdaptivePlanner,
    Blocks,
    blocks_of,
    price_of,
    spread_over,
)
from skyline.planning.loss import lost_shares

AREA = (0.0, 0.0, 2.0 * BLOCK_M, BLOCK_M)
SPACINGS_M = 1280.0 / 2.0 ** (np.arange(13) / 2.0)


def looking(distance_m):
    """Return what renders skylines at a distance that depends on the easting."""

    def look(eyes):
        shape = (len(eyes), BINS)
        distance = np.broadcast_to(distance_m(eyes.easting_m)[:, None], shape)
        nothing = np.zeros(shape, dtype=np.float32)
        return Horizons(
            eyes.easting_m,
            eyes.northing_m,
            eyes.eye_elevation_m,
            nothing,
            distance.astype(np.float32),
            nothing.astype(np.uint8),
        )

    return look


def planned(terrain, distance_m, price, area=AREA):
    planner = AdaptivePlanner(terrain, looking(distance_m), area, price, 2.0)
    return planner.places(blocks_of(area))


@pytest.fixture(scope="module")
def plain():
    return field_of(np.full((140, 140), 500.0), 100.0, west_m=-1500.0, north_m=7500.0)


def positions(places):
    return set(zip(places.easting_m.tolist(), places.northing_m.tolist(), strict=True))


class TestLoss:
    def test_it_is_the_mean_over_the_directions_of_a_photo(self):
        generator = np.random.default_rng(3)
        distance = np.exp(generator.normal(7.0, 2.0, (3, BINS))).astype(np.float32)
        distance[:, 40:43] = np.nan
        plain = np.zeros((3, 2))
        for place, skyline in enumerate(np.nan_to_num(distance, nan=1e6)):
            for start in range(0, BINS, 10):
                window = np.take(skyline, np.arange(start, start + 60), mode="wrap")
                ratio = np.array([50.0, 300.0]) * np.mean(1.0 / window.astype(float))
                odds = (ratio / 0.72) ** 1.55
                plain[place] += odds / (1.0 + odds) / 36
        lost = lost_shares(distance, np.array([50.0, 300.0]))
        np.testing.assert_allclose(lost, plain, rtol=1e-9)

    def test_near_skylines_and_far_places_lose_more(self):
        distance = np.geomspace(10.0, 1e5, 20)[:, None] * np.ones((1, BINS))
        lost = lost_shares(distance.astype(np.float32), SPACINGS_M)
        assert (np.diff(lost, axis=0) < 0.0).all()
        assert (np.diff(lost, axis=1) < 0.0).all()


class TestPrice:
    look = staticmethod(looking(lambda easting: np.where(easting < BLOCK_M, 300.0, 3e4)))

    @pytest.mark.parametrize("loss", [0.05, 0.2, 0.35])
    def test_it_suits_the_loss(self, plain, loss):
        price = price_of(loss, plain, AREA, self.look, 2.0)
        lost = lost_shares(self.look(spread_over(plain, AREA, 2.0)).distance_m, SPACINGS_M)

        def lost_at(price):
            level = np.argmin(lost + price / SPACINGS_M**2, axis=1)
            return lost[np.arange(len(lost)), level].mean()

        # At the price itself two spacings may cost the same.
        assert lost_at(0.999 * price) <= loss < lost_at(1.001 * price)

    @pytest.mark.parametrize("loss", [0.0, 1.0, -0.1, np.nan])
    def test_a_loss_is_a_share(self, plain, loss):
        with pytest.raises(InputError, match=r"expected a share between 0 and 1"):
            price_of(loss, plain, AREA, self.look, 2.0)

    def test_a_loss_that_no_places_come_down_to(self, plain):
        with pytest.raises(InputError, match=r"20 m apart, the closest there are, .* larger one"):
            price_of(1e-4, plain, AREA, self.look, 2.0)

    def test_viewpoints_spread_evenly_over_the_area(self, plain):
        eyes = spread_over(plain, AREA, 2.0)
        share = np.stack([eyes.easting_m / AREA[2], eyes.northing_m / AREA[3]])
        counted, *_ = np.histogram2d(*share, bins=8)
        assert len(eyes) == 512
        assert (np.abs(counted - 8) <= 3).all()
        with pytest.raises(InputError, match="no viewpoint falls on the surface"):
            spread_over(plain, (1e6, 1e6, 2e6, 2e6), 2.0)


class TestPlan:
    @pytest.mark.parametrize("level", [0, 1, 6, 7])
    def test_the_same_all_over_makes_a_lattice(self, plain, level):
        def far(easting):
            return np.full(len(easting), 2000.0)

        lost = lost_shares(looking(far)(spread_over(plain, AREA, 2.0)).distance_m[:1], SPACINGS_M)
        # Any price at which this level is the best one.
        prices = np.geomspace(1e-2, 1e8, 2000)
        best = np.argmin(lost + prices[:, None] / SPACINGS_M**2, axis=1)
        price = float(np.median(prices[best == level]))
        places = planned(plain, far, price)
        assert np.unique(places.tolerance_m) == np.float32(SPACINGS_M[level] / 2.0)
        # Places on the far sides of the area belong to blocks beyond it.
        assert len(places) == len(positions(places))
        assert len(places) == round(AREA[2] * AREA[3] / SPACINGS_M[level] ** 2)

    def test_it_is_dense_where_skylines_are_near(self, plain):
        def distance_m(easting):
            return np.where(easting < BLOCK_M, 300.0, 3e4)

        sample = looking(distance_m)(spread_over(plain, AREA, 2.0))
        price = price_of(0.15, plain, AREA, looking(distance_m), 2.0)
        places = planned(plain, distance_m, price)
        west = places.easting_m < BLOCK_M
        wanted = SPACINGS_M[
            np.argmin(lost_shares(sample.distance_m, SPACINGS_M) + price / SPACINGS_M**2, axis=1)
        ]
        assert np.median(places.tolerance_m[west]) == np.float32(wanted.min() / 2.0)
        assert np.median(places.tolerance_m[~west]) == np.float32(wanted.max() / 2.0)
        assert len(places) == len(positions(places))
        # Every location has one place to itself.
        own_m2 = (2.0 * places.tolerance_m.astype(float)) ** 2
        assert own_m2.sum() == pytest.approx(AREA[2] * AREA[3], rel=1e-6)

    def test_a_plain_takes_less_than_a_place_a_square_kilometre(self, plain):
        def distance_m(easting):
            return np.full(len(easting), 3e4)

        price = price_of(0.2, plain, AREA, looking(distance_m), 2.0)
        places = planned(plain, distance_m, price)
        assert len(places) <= AREA[2] * AREA[3] / 1e6

    def test_blocks_are_planned_each_on_its_own(self, plain):
        def distance_m(easting):
            return 100.0 + np.abs(easting - 4000.0)

        whole = planned(plain, distance_m, 300.0)
        planner = AdaptivePlanner(plain, looking(distance_m), AREA, 300.0, 2.0)
        blocks = blocks_of(AREA)
        assert len(blocks) == 2
        parts = [planner.places(blocks[np.array([one])]) for one in (1, 0)]
        assert positions(parts[0]) | positions(parts[1]) == positions(whole)
        np.testing.assert_array_equal(
            Places.concatenate(parts[::-1]).tolerance_m, whole.tolerance_m
        )
        eastern = blocks.holding(np.array([BLOCK_M + 1.0]), np.array([5.0]))
        assert eastern.tolist() == [False, True]

    def test_what_is_rendered_is_kept(self, plain):
        seen = []

        def look(eyes):
            seen.append(len(eyes))
            return looking(lambda easting: np.full(len(easting), 400.0))(eyes)

        places = AdaptivePlanner(plain, look, AREA, 100.0, 2.0).places(blocks_of(AREA))
        # But for the coarsest places round about each block.
        assert sum(seen) - len(places) == 2 * (6 * 6 - 4 * 4)

    def test_nobody_stands_on_holes_or_outside(self, plain):
        area = (2000.0, 1500.0, 5000.0, 4000.0)
        heights = plain.heights_m.copy()
        heights[40:50] = np.nan
        holed = field_of(heights, 100.0, west_m=-1500.0, north_m=7500.0)
        places = planned(holed, lambda easting: np.full(len(easting), 300.0), 100.0, area)
        assert len(places) > 100
        assert not np.isnan(holed.height_at(places.easting_m, places.northing_m)).any()
        assert places.easting_m.min() >= area[0]
        assert places.easting_m.max() <= area[2]
        assert places.northing_m.min() >= area[1]
        assert places.northing_m.max() <= area[3]
        off = AdaptivePlanner(plain, looking(np.ones_like), (1e6, 1e6, 2e6, 2e6), 1.0, 2.0)
        assert off.places(Blocks(np.array([200]), np.array([200]))) is None
