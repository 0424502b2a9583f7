"""Trees and houses on the ground: a surface model as an upper bound for the skyline."""

from dataclasses import replace

import numpy as np
import pytest
from ray_scenes import photographed_from, poses, rays_of
from scenes import at_m, field_of, fractal

from skyline import horizon, stand_at, stand_on
from skyline.errors import InputError
from skyline.match.refine import WHOLE, Refinement
from skyline.render.horizon import RenderConfig, RenderedScene
from skyline.terrain.provenance import Provenance
from skyline.terrain.surface_model import SurfaceRules, read_surface

SHORT = replace(WHOLE, shortlist=12, rounds=6, restarts=1, finalists=4, final_rounds=3)
TREES_M = 20.0


@pytest.fixture(scope="module")
def bare():
    """Rough ground of 500 m relief in a bowl, 12 x 12 km, which holds the skyline."""
    rough = fractal(400, 400, relief_m=1500.0, seed=5, exponent=2.0)
    return field_of(rough + 1500.0 + 0.01 * np.square(np.hypot(*np.ogrid[-200:200, -200:200])))


@pytest.fixture(scope="module")
def canopy():
    """Trees 20 m high in patches on half of that ground."""
    return field_of(np.where(fractal(400, 400, seed=9, exponent=1.5) > 0.0, TREES_M, 0.0))


@pytest.fixture(scope="module")
def forest(bare, canopy):
    """The surface of ground and trees."""
    return field_of(bare.heights_m + canopy.heights_m)


@pytest.mark.parametrize("sea_share", [0.0, 0.6])
def test_a_surface_and_a_canopy_model_give_the_same_heights(bare, canopy, sea_share):
    """Also where most of the ground is low."""
    sea_m = np.quantile(bare.heights_m, sea_share) if sea_share else 0.0
    ground = field_of(np.maximum(bare.heights_m - sea_m, 0.0))
    trees = np.where(ground.heights_m > 0.0, canopy.heights_m, 0.0)
    for model in (trees, ground.heights_m + trees):
        over = read_surface(field_of(model), ground)
        np.testing.assert_allclose(over.heights_m - ground.heights_m, trees, atol=1e-3)


def test_woods_in_the_hollows_of_low_land_are_a_surface(bare):
    low = field_of(50.0 + 6.0 * (bare.heights_m - bare.heights_m.mean()) / bare.heights_m.std())
    trees = np.where(low.heights_m < 47.0, TREES_M, 0.0)
    over = read_surface(field_of(low.heights_m + trees), low)
    np.testing.assert_allclose(over.heights_m - low.heights_m, trees, atol=1e-3)


def test_the_highest_of_a_fine_model_counts_and_tall_trees_where_there_is_none(bare):
    trees = np.zeros((300, 300))
    trees[151, 149] = 30.0
    fine = field_of(trees, 5.0, west_m=3000.0, north_m=-3000.0)
    rise_m = read_surface(fine, bare).heights_m - bare.heights_m
    at_row, at_col = (3000.0 + 5.0 * 151) / 30.0, (3000.0 + 5.0 * 149) / 30.0
    row, col = np.nonzero((rise_m > 1.0) & (rise_m < SurfaceRules().unknown_m - 1.0))
    # All corners of the cell that it stands in, and none beyond the next.
    assert {(int(at_row) + i, int(at_col) + j) for i in (0, 1) for j in (0, 1)} <= set(
        zip(row.tolist(), col.tolist(), strict=True)
    )
    assert np.abs(row - at_row).max() <= 1.5
    np.testing.assert_allclose(rise_m[row, col], 30.0, atol=1e-3)
    assert rise_m[0, 0] == pytest.approx(SurfaceRules().unknown_m, abs=1e-3)


def test_a_surface_of_another_area_or_datum_is_refused(bare, forest):
    away = field_of(forest.heights_m, west_m=1e6)
    with pytest.raises(InputError, match="has no height over the DEM"):
        read_surface(away, bare)
    with pytest.raises(InputError, match=r"is \+\d+ m above the DEM in the median"):
        read_surface(field_of(forest.heights_m + 200.0), bare)
    models = [
        replace(field, provenance=Provenance(conventions={"vertical_datum": f"X ({above})"}))
        for field, above in ((forest, "ellipsoid"), (bare, "geoid"))
    ]
    with pytest.raises(InputError, match="above the ellipsoid, and the DEM above the geoid"):
        read_surface(*models)


def test_a_surface_that_stands_over_open_ground_or_has_holes_is_warned_of(bare, forest, caplog):
    read_surface(forest, bare)
    assert caplog.text == ""
    read_surface(field_of(forest.heights_m + 25.0), bare)
    assert "at least 25 m above the DEM in 90 % of the area" in caplog.text
    with pytest.raises(InputError, match="at least 48 m above the DEM in 90 % of the area, and no"):
        read_surface(field_of(forest.heights_m + 48.0), bare)
    read_surface(field_of(np.where(forest.heights_m > bare.heights_m, TREES_M, np.nan)), bare)
    assert "where trees of 40 m are assumed" in caplog.text


def test_a_horizon_lies_between_the_bare_one_and_the_surface_s(bare, forest):
    # Easting and northing of the scenes' frame, in open ground and under trees.
    lon, lat = bare.frame.to_lonlat([4000.0, 6200.0, 8000.0], [-6000.0, -5000.0, -8000.0])
    found = horizon(bare, lon=lon, lat=lat, surface=forest)
    eyes = stand_at(bare, lon=lon, lat=lat, summit_within_m=0.0)
    assert (found.surface_deg >= found.elevation_deg).all()
    assert (found.surface_deg > found.elevation_deg + 0.05).any(axis=1).all()
    data = found.to_xarray()
    assert data.surface_deg.dims == ("point", "azimuth_deg")
    at_east = data.sel(azimuth_deg=90.0).surface_deg.to_numpy()
    np.testing.assert_array_equal(at_east, found.surface_deg[:, 180])
    plain = horizon(bare, lon=lon, lat=lat)
    np.testing.assert_array_equal(plain.elevation_deg, found.elevation_deg)
    assert not plain.has_surface
    over_m = forest.height_at(easting_m=eyes.easting_m, northing_m=eyes.northing_m)
    assert (over_m > eyes.eye_elevation_m).tolist() == [False, False, True]
    assert found.surface_deg[2].min() > 30.0


def _open_places(bare, canopy, count):
    """Return places (count, 2) from which no tree within 100 m hides the view."""
    generator = np.random.default_rng(1)
    ring = 100.0 * np.exp(0.25j * np.pi * np.arange(8))
    places = []
    while len(places) < count:
        place = generator.uniform((3000.0, -9000.0), (9000.0, -3000.0))
        around = place[0] + ring.real, place[1] + ring.imag
        if not canopy.height_at(**at_m(around)).any():
            places.append(place)
    return np.array(places)


@pytest.mark.slow
def test_with_a_surface_places_in_a_forest_are_found_nearer(bare, canopy, forest):
    off_m = {"without": [], "with": []}
    config = RenderConfig(width=320)
    scenes = {
        "without": RenderedScene(bare, config),
        "with": RenderedScene(bare, config, surface=read_surface(forest, bare)),
    }
    for index, place in enumerate(_open_places(bare, canopy, 18)):
        camera = {"heading_deg": 37.0 * index, "pitch_deg": 1.0, "roll_deg": -1.0, "fov_deg": 60.0}
        # The camera stands on the ground and sees the forest.
        u, v = photographed_from(forest, stand_on(bare, **at_m(place)), **camera)
        noise = np.random.default_rng(0).normal(0.0, np.radians(0.05), len(v))
        query = rays_of(u, v + noise, 60.0)
        ring = 60.0 * np.exp(2j * np.pi * np.arange(6) / 6)
        around = at_m((place[0] + ring.real, place[1] + ring.imag))
        heading_deg = camera["heading_deg"] + 1.5 * (-1.0) ** np.arange(6)
        start = poses(6, **around, grid_heading_deg=heading_deg)
        for name, scene in scenes.items():
            best = Refinement(query, scene, SHORT).run(start)
            off_m[name].append(np.hypot(*(place - [best.easting_m[0], best.northing_m[0]])))
    without_m, with_m = np.array(off_m["without"]), np.array(off_m["with"])
    for scene in scenes.values():
        scene.close()
    assert np.median(with_m) < 0.7 * np.median(without_m)
    assert (with_m < 20.0).sum() > (without_m < 20.0).sum()
