"""What is said of plans, plugins, tables, reports and views, each in one line.

Elevation models, photos, stores and fetches have files of messages of their own.
"""

import json
import sys
from concurrent.futures import CancelledError
from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
from font_scenes import UNDRAWN
from packages import install
from refusals import assert_says
from scenes import FRAME, candidate_at, field_from, field_of, fractal
from store_rows import HEADERS, write_rows

from skyline import (
    Curvature,
    LocalHorizons,
    MatchResult,
    Narrowing,
    Orienter,
    Peaks,
    PhotoSkyline,
    ReliefTiles,
    Viewer,
    build_places,
    export_matches,
    horizon,
    open_store,
    save_panorama,
    sky_view_factor,
    stand_on,
)
from skyline.errors import BuildError, BusyError, InputError, OffMapError
from skyline.files.tables import read_table
from skyline.match.config import MatchConfig
from skyline.paper.plan import PlanConfig, lay_out, plan
from skyline.plugins import load
from skyline.report.place_files import write_geopackage
from skyline.report.results_file import RESULTS, ResultsFile
from skyline.survey.cluster import Opening, Runner
from skyline.survey.plans import uniform_grid
from skyline.view.peaks import read_peaks

SKYLINE = PhotoSkyline(np.full(8, 3.0), np.ones(8), 8, 8, 60.0)
RESULT = MatchResult(SKYLINE, (candidate_at(0.0, 0.0),), 0.1, name="a.jpg")
FLAT = field_of(np.zeros((101, 101)), 30.0, west_m=-1500.0, north_m=1500.0)
PEAK = Peaks(names=("Top",), easting_m=np.zeros(1), northing_m=np.zeros(1), height_m=np.ones(1))


class TestPlans:
    @pytest.mark.parametrize(
        ("make", "said"),
        [
            (lambda _: PlanConfig(coarse_m=110.0), "not a whole multiple"),
            (lambda _: PlanConfig(site_spacing_m=400.0), r"site spacing is 400\.0 m"),
            (lambda t: lay_out(t, PlanConfig(coarse_m=50_000.0)), "larger than the area"),
            (lambda t: lay_out(t, PlanConfig(site_spacing_m=1e-6, coarse_m=1.0)), "are too many"),
            (lambda t: uniform_grid(t, 1e-6), "are too many"),
        ],
    )
    def test_of_too_few_or_too_many_sites(self, make, said):
        assert_says(said, lambda: make(FLAT))

    def test_of_a_hole(self):
        heights = fractal(60, 60, relief_m=50.0, seed=1)
        heights[20:25, 20:40] = np.nan
        hole_m = (620.0, -700.0, 1150.0, -640.0)
        config = PlanConfig(coarse_m=300.0, site_spacing_m=30.0)
        said = "falls on the surface"
        assert_says(said, lambda: plan(field_of(heights), Mock(), config, hole_m))

    @pytest.mark.parametrize("lost", [CancelledError(), OSError("stream is closed")], ids=repr)
    def test_whose_scheduler_is_lost(self, lost):
        future = Mock(**{"exception.return_value": None, "result.side_effect": lost})
        runner = Runner(Mock(**{"submit.return_value": future}))
        outcomes = runner(print, Opening(0, Mock), [1, 2], ["job 1", "job 2"])
        assert_says("scheduler has ended", lambda: next(outcomes), BuildError)


GROUP = "skyline.tests"


class TestPlugins:
    @pytest.fixture
    def site(self, tmp_path, monkeypatch):
        """A folder from which packages are imported."""
        monkeypatch.syspath_prepend(tmp_path)
        return tmp_path

    def test_of_an_unknown_name(self, site):
        install(site, "plugins_m", "", GROUP, one="plugins_m:one", two="plugins_m:two")
        assert_says(r"^test is 'three'; expected one of one, two$", lambda: load(GROUP, "three"))

    def test_of_an_installation_that_is_old(self):
        assert_says(r"no test at all.*; install skyline anew$", lambda: load(GROUP, "one"))

    def test_of_two_packages(self, site):
        for name in ("plugins_n", "plugins_o"):
            install(site, name, "def one(): return 1", GROUP, one=f"{name}:one")
        said = "^plugins_n and plugins_o each have a test 'one'"
        assert_says(said, lambda: load(GROUP, "one"))

    @pytest.mark.parametrize(
        ("code", "reason"),
        [
            ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
            ("1 / 0", "ZeroDivisionError: division by zero"),
            ("", "AttributeError: module .* has no attribute 'one'"),
        ],
    )
    def test_that_cannot_be_imported(self, site, request, code, reason):
        name = f"plugins_p{abs(hash(request.node.name))}"
        install(site, name, code, GROUP, one=f"{name}:one")
        said = rf"'one' of {name} cannot be imported \({reason}\)"
        assert_says(said, lambda: load(GROUP, "one"))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"lon,lat\n9.85\n", "line 2: lat is ``; expected a number from -90 to 90"),
        (b"lon,lat\n9.85,nan\n", "lat is `nan`"),
        (b"# note\nlon,lat\n\n9,85,46,75\n", "line 4 has 4 cells; expected 2 for `lon,lat`"),
        (b"lon,longitude\n", "has the column `lon` twice"),
        (b"", "is empty; expected places"),
        (b"lon,lat\n\0", "cannot be read as CSV"),
    ],
)
def test_a_table_with_a_mistake(tmp_path, content, said):
    (tmp_path / "a.csv").write_bytes(content)

    def read():
        for row in read_table(tmp_path / "a.csv", "expected places").rows:
            row.number("lon")
            row.number("lat")

    assert_says(said, read)


class TestPeaks:
    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("name,x,y\na,1,2\n", "has the columns"),
            ("name,lon,lat\na,1,91\n", "line 2: lat is `91`; expected a number from -90 to 90"),
            ("name,lon,lat\nGr\udcfcnhorn,1,2\n", "not UTF-8"),
        ],
    )
    def test_of_a_bad_gazetteer(self, tmp_path, text, said):
        (tmp_path / "peaks.csv").write_text(text, errors="surrogateescape")
        assert_says(said, lambda: read_peaks(tmp_path / "peaks.csv", FRAME))

    def test_of_geojson_in_metres(self, tmp_path):
        crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::2056"}}
        collection = {"type": "FeatureCollection", "features": [], "crs": crs}
        (tmp_path / "peaks.geojson").write_text(json.dumps(collection))
        said = r"LV95; expected degrees .*EPSG:4326"
        assert_says(said, lambda: read_peaks(tmp_path / "peaks.geojson", FRAME))

    def test_whose_heights_cannot_be_read(self, tmp_path, caplog):
        rows = ["A,9.0,46.0,1200", "B,9.01,46.0,1200;1210", "C,9.02,46.0,", "D,9.03,46.0,"]
        (tmp_path / "peaks.csv").write_text("\n".join(['"name","lon","lat","ele"', *rows]) + "\n")
        read_peaks(tmp_path / "peaks.csv", FRAME)
        assert "1 of 4 heights cannot be read" in caplog.text
        assert "of B)" in caplog.text

    def test_that_are_elsewhere(self, caplog):
        east, north = FRAME.from_lonlat(46.8, 9.8)
        Viewer(FLAT, replace(PEAK, easting_m=np.array([east]), northing_m=np.array([north])))
        assert "longitude and latitude seem to be swapped" in caplog.text
        degrees = replace(PEAK, easting_m=np.array([9.8]), northing_m=np.array([46.8]))
        said = "are degrees; expected metres: name the columns lon,lat"
        assert_says(said, lambda: Viewer(FLAT, degrees))

    def test_that_no_font_draws(self, tmp_path, caplog):
        cone = field_from(
            lambda east, north: np.maximum(400.0 - np.hypot(east, north - 1500.0), 0.0), 121, 30.0
        )
        there = {"easting_m": np.zeros(1), "northing_m": np.array([1500.0])}
        peak = Peaks(names=(UNDRAWN,), **there, height_m=np.array([np.nan]))
        lon, lat = map(float, FRAME.to_lonlat(0.0, 0.0))
        path = tmp_path / "north.png"
        save_panorama(cone, path, lon=lon, lat=lat, peaks=peak)
        assert f"{path}; no installed font draws 1 name: {UNDRAWN}" in caplog.text


class TestViews:
    @pytest.mark.parametrize(
        ("change", "said", "error"),
        [
            ({"easting_m": 1e6}, "the DEM covers easting", OffMapError),
            ({"fov_deg": 200.0}, "field of view", InputError),
        ],
    )
    def test_of_a_pose_that_is_none(self, change, said, error):
        pose = replace(candidate_at(0.0, 0.0), **change)
        assert_says(said, lambda: Viewer(FLAT, PEAK).summits(pose, SKYLINE), error)

    def test_of_places_in_pixels(self, tmp_path):
        pose, viewer = candidate_at(0.0, 0.0, eye_elevation_m=50.0), Viewer(FLAT)
        assert_says("step is 0", lambda: viewer.places(pose, SKYLINE, 0))
        away = replace(pose, easting_m=9e5)
        assert_says("off the map", lambda: viewer.places(away, SKYLINE), OffMapError)
        places = viewer.places(pose, SKYLINE)
        assert_says("suffix of", lambda: places.save(tmp_path / "p.csv", pose))

    @pytest.mark.parametrize(
        "call",
        [
            lambda place: Orienter(FLAT, **place),
            lambda place: Viewer(FLAT).pose(**place, heading_deg=0.0),
            lambda place: save_panorama(FLAT, "a.png", **place),
        ],
    )
    def test_of_two_places_for_one(self, call):
        lon, lat = FRAME.to_lonlat([0.0, 300.0], [0.0, 300.0])
        assert_says("2 places are given; expected one", lambda: call({"lon": lon, "lat": lat}))

    @pytest.mark.parametrize("at", [(-1, 0, 0), (2, 4, 0), (99, 0, 0)])
    def test_of_a_tile_that_is_none(self, at):
        assert_says("expected a zoom", lambda: ReliefTiles(FLAT).png(*at))


def pose_with(text):
    """Make a pose of angles, one of them a text."""
    return Viewer(FLAT).pose(lon=9.8, lat=46.8, **{**ANGLES, text: "1"})


@pytest.mark.parametrize("name", ["heading_deg", "pitch_deg", "fov_deg", "eye_height_m"])
def test_a_pose_has_no_angle_that_is_no_number(name):
    with pytest.raises(InputError, match=f"{name} of the place is masked or not a finite number"):
        Viewer(FLAT).pose(lon=9.8, lat=46.8, **{"heading_deg": 0.0, name: np.nan})


def horizons_of(count, name=""):
    """Return flat horizons of places on the equator, eight azimuths each."""
    zeros = np.zeros((count, 8), np.float32)
    return LocalHorizons(
        lon=np.arange(count) * 1.0, lat=np.zeros(count), eye_elevation_m=np.zeros(count),
        azimuth_deg=zeros + np.arange(8) * 45.0, elevation_deg=zeros, distance_m=zeros + 1000.0,
        flags=zeros.astype(np.uint8), surface_deg=zeros * np.nan, id=np.full(count, name),
    )  # fmt: skip


class TestHorizons:
    def test_of_several_places(self):
        said = "there are 3 places; take one by its number or its id, as in horizons"
        assert_says(said, lambda: horizons_of(3).sun_above("2026-06-21"))

    def test_of_a_place_that_is_not_there(self):
        said = r"0 of 3 places have the id 'B' \(ids: A\); give one of the ids, or lon and lat"
        assert_says(said, lambda: horizons_of(3, "A").sel("B"))

    def test_of_a_place_whose_name_no_font_draws(self, caplog):
        horizons_of(1, UNDRAWN).plot()
        assert f"no installed font draws {UNDRAWN}" in caplog.text

    @pytest.mark.parametrize(
        ("step_deg", "shape", "said"),
        [
            (np.radians(0.5), (720,), "not equal steps"),
            (0.5, (720, 1), r"expected \(..., 720\)"),
            (1.0, (720,), r"expected \(..., 360\)"),
        ],
    )
    def test_whose_azimuths_do_not_suit_them(self, step_deg, shape, said):
        azimuth_deg = np.arange(360 if step_deg == 1.0 else 720) * step_deg
        assert_says(said, lambda: sky_view_factor(azimuth_deg, np.zeros(shape)))

    def test_seen_at_a_tilt_beyond_a_half_turn(self):
        level = np.arange(8) * 45.0, np.zeros(8)
        assert_says("a tilt from 0", lambda: sky_view_factor(*level, 180.1, 0.0))


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ({"min_confidence": 80}, "least confidence is 80; expected 0"),
        ({"fov_sd_share": 5}, "fov_sd_share is 5; expected a share"),
    ],
)
def test_a_setting_of_matches_out_of_its_range(setting, said):
    assert_says(said, lambda: MatchConfig(**setting))


ANGLES = {"heading_deg": 0.0, "pitch_deg": 0.0, "roll_deg": 0.0, "fov_deg": 60.0}
EIGHT_DEG = np.arange(8) * 45.0


class TestTextInPlaceOfANumber:
    @pytest.mark.parametrize(
        ("call", "name"),
        [
            (lambda: horizon(FLAT, lon="9.8", lat=46.8), "lon"),
            (lambda: horizon(FLAT, lon=9.8, lat=[46.8, "46.9"]), "lat"),
            (lambda: horizon(FLAT, lon=9.8, lat=46.8, eye_height_m="2"), "eye_height_m"),
            (lambda: stand_on(FLAT, easting_m=pd.Series(["0"]), northing_m=0.0), "easting_m"),
            (lambda: FLAT.height_at(easting_m="0", northing_m=0.0), "easting_m"),
            (lambda: FRAME.to_lonlat("0", 0.0), "easting_m"),
            (lambda: Curvature(refraction_k="0.1"), "refraction_k"),
            (lambda: sky_view_factor(EIGHT_DEG, ["0"] * 8), "elevation_deg"),
            (lambda: PhotoSkyline(["3"] * 8, np.ones(8), 8, 8), "row_px"),
            (lambda: PhotoSkyline(np.ones(8), np.ones(8), 8, 8, "60"), "fov_deg"),
            (lambda: MatchConfig(min_confidence="0.9"), "min_confidence"),
            (lambda: Orienter(FLAT, lon=9.8, lat=46.8, position_sd_m="9"), "position_sd_m"),
            (lambda: build_places(FLAT, "a.h5", "80"), "spacing_m"),
            *((partial(pose_with, name), name) for name in ANGLES),
        ],
        ids=str,
    )
    def test_of_a_library_call(self, call, name):
        assert_says(f"{name} has the text .*; expected numbers: convert it by float", call)

    @pytest.mark.parametrize(
        "given", [{"near": ("9.8", "46.8", "3")}, {"eye_height_m": "2"}], ids=str
    )
    def test_of_a_narrowing(self, given):
        assert_says("expected", lambda: Narrowing(**given))


class TestResults:
    @pytest.fixture(params=RESULTS)
    def path(self, request, tmp_path):
        """A file of the results of one search."""
        path = tmp_path / f"results{request.param}"
        with ResultsFile(path, "one") as kept:
            kept.add(RESULT.to_row(), "a.jpg")
        return path

    def test_that_another_process_writes(self, path):
        said = "is in use by another skyline; wait for its end"
        with ResultsFile(path, "one"):
            assert_says(said, lambda: ResultsFile(path, "one"), BusyError)

    def test_of_another_search(self, path):
        assert_says("another store or other options", lambda: ResultsFile(path, "another"))

    def test_in_a_file_of_another_kind(self, path):
        path.write_bytes(b"column_px,row_px\n1,2\n")
        assert_says("--results", lambda: ResultsFile(path, "one"))
        said = r"expected \.csv or \.gpkg"
        assert_says(said, lambda: ResultsFile(path.with_suffix(".xlsx"), "one"))

    def test_with_too_many_cells(self, tmp_path):
        path = tmp_path / "results.csv"
        with ResultsFile(path, "one") as kept:
            kept.add(RESULT.to_row(), "a.jpg")
        path.write_text(path.read_text() + "long.jpg" + "," * 20 + "more\n")
        assert_says("line 3 has more than 20 cells", lambda: ResultsFile(path, "one"))

    def test_to_be_exported_to_a_format_that_is_none(self, tmp_path):
        said = r"expected one of \.geojson"
        assert_says(said, lambda: export_matches(tmp_path / "a.doc", [RESULT], FRAME))

    @pytest.mark.parametrize(
        ("kind", "name", "said"),
        [
            ("places", "places.shp", r"expected one of \.gpkg"),
            ("places", "s.h5/places.gpkg", "cannot be written"),
            ("renderings", "views.gpkg", "renderings"),
        ],
    )
    def test_of_a_store_as_a_geopackage(self, tmp_path, kind, name, said):
        with open_store(write_rows(tmp_path / "s.h5", 0, 9, HEADERS[kind])) as store:
            assert_says(said, lambda: write_geopackage(store, tmp_path / name))

    def test_without_the_packages_that_tables_need(self, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, "geopandas", None)
        monkeypatch.setitem(sys.modules, "xarray", None)
        assert_says("pip install geopandas", RESULT.to_geodataframe)
        assert_says("pip install geopandas", horizons_of(2).to_geodataframe)
        assert_says("pip install xarray", horizons_of(2).to_xarray)
        with open_store(write_rows(tmp_path / "s.h5", 0, 9, HEADERS["places"])) as store:
            assert_says("pip install xarray", store.to_xarray)
            assert_says("pip install geopandas", store.to_geodataframe)
