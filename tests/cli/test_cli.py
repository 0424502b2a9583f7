"""The command line: the files it makes, and one line for every mistake."""

import json
import math
import os
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from commands import assert_refused, csv_of, lonlat_of
from scenes import NORTH_M, WEST_M, across_antimeridian, fractal, write_dem

from skyline import read_dem, stand_on
from skyline.store.read import open_store
from skyline.survey.build import build_store
from skyline.survey.part_files import PartSize
from skyline.survey.plans import JobSize
from skyline_bench.truth import oracle

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture
def viewpoints_csv(dem, tmp_path):
    """Three places 300 m apart, in degrees, 12 m above the ground."""
    places = [lonlat_of(dem, WEST_M + 900 + 300 * i, NORTH_M - 1500) for i in range(3)]
    rows = [f"{lon:.9f},{lat:.9f},12,site/{i}" for i, (lon, lat) in enumerate(places)]
    return csv_of(tmp_path / "viewpoints.csv", rows, "lon,lat,eye_height_m,id")


def test_version_and_help(run):
    assert run("--version").out.startswith("skyline 0.")
    for arguments, code in ((["match", "--help"], 0), (["store"], 2), (["dem"], 2)):
        shown = run(*arguments)
        assert shown.code == code
        assert "Usage" in shown.out + shown.err
        assert "error:" not in shown.err


@pytest.mark.parametrize(
    ("typed", "at", "completed"),
    [
        ("skyline ma", 1, "match"),
        ("skyline match --fov-", 2, "--fov-deg"),
        ("skyline match --matcher un", 3, "unrefined"),
        ("skyline match --matcher pa", 3, "paper"),
        ("skyline match --projection cyl", 3, "cylindrical"),
        ("skyline render --planner lp", 3, "lpov"),
        ("skyline locate --source cop", 3, "copernicus"),
        ("skyline dem fetch --source cop", 4, "copernicus"),
    ],
)
def test_a_shell_completes_commands_options_and_values(run, monkeypatch, typed, at, completed):
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(at))
    monkeypatch.setenv("_SKYLINE_COMPLETE", "complete_bash")
    assert completed in run().out.split()


@pytest.fixture
def rendered(run, dem, viewpoints_csv, tmp_path):
    """A folder with a store of the three viewpoints, 160 columns wide, and their pictures."""
    listed = "--viewpoints", viewpoints_csv, "--width", "160"
    pictures = "--depth-images", tmp_path / "pictures"
    run("render", dem, *listed, *pictures, "-o", tmp_path / "out.h5").ok()
    return tmp_path


def test_the_views_of_a_list_are_seen_from_its_viewpoints(dem, rendered):
    terrain = read_dem([dem])
    easting_m = WEST_M + 900 + 300 * np.arange(3)
    eyes = stand_on(terrain, easting_m=easting_m, northing_m=NORTH_M - 1500, eye_height_m=12.0)
    truth = oracle.skyline(terrain, eyes, 160)
    with open_store(rendered / "out.h5") as opened:
        views = opened.views()
        assert opened.header.config["eye_height_m"] is None  # Each viewpoint has its own.
    assert len(views) == 12
    np.testing.assert_allclose(views.easting_m[::4], easting_m, atol=1e-3)
    np.testing.assert_allclose(views.eye_elevation_m[::4], eyes.eye_elevation_m, atol=1e-2)
    unflagged = views.flags == 0
    assert unflagged.mean() > 0.3
    error_px = (views.v - truth.v)[unflagged] * 80.0
    assert np.abs(error_px).max() < 0.51


def test_the_pictures_of_a_list_have_the_names_of_its_viewpoints(rendered):
    pictures = rendered / "pictures"
    depth = cv2.imread(str(pictures / "0001_site-1_heading_2.tif"), cv2.IMREAD_UNCHANGED)
    assert depth.shape == (160, 160)
    assert depth.dtype == np.float32
    assert cv2.imread(str(pictures / "0001_site-1.png")).std() > 20.0


def test_a_store_holds_one_kind_of_rows(run, dem, store, renderings, viewpoints_csv, tmp_path):
    before = store.read_bytes(), renderings.read_bytes()
    assert_refused(run("build", dem, "-o", renderings))
    for which in (("--spacing", 600), ("--planner", "lpov"), ("--viewpoints", viewpoints_csv)):
        assert_refused(run("render", dem, "-o", store, *which))
    assert_refused(run("store", "merge", store, renderings, "-o", tmp_path / "both.h5"))
    assert (store.read_bytes(), renderings.read_bytes()) == before
    assert not (tmp_path / "both.h5").exists()


@dataclass(frozen=True)
class Stopping:
    """A command that builds a store, and where it is stopped."""

    options: tuple[object, ...]
    builds: str
    """The module that calls `build_store`."""
    job_size: JobSize
    rows: int
    """It is stopped after so many."""
    there: str
    """What is there then."""
    new: str
    """What the same command then adds."""


STOPPED = {
    "build": Stopping(
        ("--spacing", 80),
        "skyline.tasks.build",
        JobSize(4096, 300),
        600,
        "600 of about 1804 places",
        " 1204 of them new",
    ),
    "render": Stopping(
        ("--spacing", 900, "--width", 64),
        "skyline.tasks.render",
        JobSize(1024, 3),
        24,
        "24 of about 64 renderings",
        " 40 of them new",
    ),
}


@pytest.fixture
def stop(run, monkeypatch):
    """Return a function that runs a command that builds a store, and stops it by Ctrl-C."""

    def run_until(stopping, *command):
        def interrupt(done, _total):
            if done >= stopping.rows:
                raise KeyboardInterrupt

        def build_until_stopped(terrain, path, plan, runner, _):
            plan = replace(plan, job_size=stopping.job_size)
            return build_store(terrain, path, plan, runner, interrupt, PartSize(seconds=0.0))

        with monkeypatch.context() as patch:
            patch.setattr(f"{stopping.builds}.build_store", build_until_stopped)
            return run(*command)

    return run_until


@pytest.mark.parametrize("name", STOPPED)
def test_a_build_stopped_by_ctrl_c_is_no_store_yet(run, stop, dem, photo, tmp_path, name):
    out = tmp_path / "store.h5"
    done = stop(STOPPED[name], name, dem, "-o", out, *STOPPED[name].options)
    assert done.code == 130
    for reading in (("info", out), ("store", "check", out), ("match", out, photo)):
        assert_refused(run(*reading))


@pytest.mark.parametrize("name", STOPPED)
def test_a_build_stopped_by_ctrl_c_is_continued(run, stop, dem, tmp_path, name):
    stopping, out, whole = STOPPED[name], tmp_path / "store.h5", tmp_path / "all.h5"
    command = name, dem, "-o", out, *stopping.options
    stop(stopping, *command)
    again = run(*command).ok()
    assert again.err == f"{out}: {stopping.there} are there already\n"
    assert stopping.new in again.out
    run(name, dem, "-o", whole, *stopping.options).ok()
    assert out.read_bytes() == whole.read_bytes()
    assert not (tmp_path / "store.h5.parts").exists()


def test_a_finished_build_renders_nothing_again(run, dem, tmp_path):
    command = "render", dem, "-o", tmp_path / "store.h5", *STOPPED["render"].options
    run(*command).ok()
    assert "complete: nothing was left to render" in run(*command).ok().out


def test_info_of_a_dem_and_of_a_store(run, dem, store, renderings):
    facts = json.loads(run("info", dem, "--json").out)
    assert facts["samples"] == "120 x 110"
    assert facts["frame"] == "EPSG:32632"
    assert facts["spacing_m"] == [30.0, 30.0]
    assert facts["height_unit"].startswith("metre, assumed")
    assert "\nvertical_datum " in run("info", dem).out
    facts = json.loads(run("info", renderings, "--json").out)
    assert facts["kind"] == "store"
    assert facts["renderings"] == 4 * 30
    assert facts["locations"] == 30
    facts = json.loads(run("info", store, "--json").out)
    assert facts["places"] == facts["locations"] == 1804
    assert facts["config"]["spacing_m"] == 80.0
    assert facts["dem_files"] == [str(dem)]
    assert "places" in run("info", store).out


def test_bounds_across_the_antimeridian_are_shown_and_accepted(run, tmp_path):
    dem = across_antimeridian(tmp_path / "dem.tif")
    west, south, east, north = json.loads(run("info", dem, "--json").out)["bounds_deg"]
    assert (west, east) == pytest.approx((179.983, -179.983), abs=1e-3)
    assert (south, north) == pytest.approx((-17.015, -16.985), abs=1e-3)
    whole, bounds = tmp_path / "whole.h5", f"{west!r},{south!r},{east!r},{north!r}"
    assert run("build", dem, "-o", whole, "--spacing", "300", "--bounds", bounds).code == 0
    facts = json.loads(run("info", whole, "--json").out)
    assert facts["places"] == 12 * 11
    assert facts["bounds_deg"][0] > 179.98
    assert -180.0 < facts["bounds_deg"][2] < -179.98
    done = run("build", dem, "-o", tmp_path / "no.h5", "--bounds", "-179.9,-17,-179.8,-16.9")
    assert_refused(done)


@pytest.mark.slow
def test_examples_run(dem, store, photo, viewpoints_csv, tmp_path):
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:/usr/bin:/bin"}

    def run_example(*command):
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    batch = run_example(EXAMPLES / "render_batch.sh", dem, viewpoints_csv, tmp_path / "batch.h5")
    assert "12 renderings" in batch
    printed = run_example(sys.executable, EXAMPLES / "match_photo.py", store, photo)
    line = r": (\S+) (\S+) heading (\S+) from true north confidence [01]\.\d\d$"
    places = re.findall(line, printed, re.MULTILINE)
    assert 1 <= len(places) <= 3
    lat, lon, heading_deg = map(float, places[0])
    assert abs(heading_deg - 140.95) < 1.5  # the grid's 140, and 0.95 of convergence
    (east_m,), (north_m,) = read_dem([dem]).frame.from_lonlat([lon], [lat])
    assert math.hypot(east_m - 601_800.0, north_m - 5_178_000.0) < 200.0


def test_a_store_of_another_dem_is_refused_and_kept(run, store, photo, tmp_path):
    other = write_dem(tmp_path / "other.tif", fractal(110, 120, seed=99))
    before = store.read_bytes()
    assert_refused(run("build", other, "-o", store))
    assert_refused(run("match", store, photo, "--fov-deg", "60", "--dem", other))
    assert store.read_bytes() == before


def test_explain_gives_the_model_and_its_errors(dem, run):
    at = "{:.9f},{:.9f}".format(*lonlat_of(dem))
    done = run("explain", dem, "--at", at, "--json")
    facts = json.loads(done.out)
    assert facts["easting_m"] == pytest.approx(601_800.0, abs=0.01)
    assert facts["northing_m"] == pytest.approx(5_178_000.0, abs=0.01)
    assert facts["data_reach_m"] > 0.0
    assert "sight_m" in run("explain", dem, "--at", at).out
