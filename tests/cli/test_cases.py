"""Made photos and files of public bug reports, each held to its truth in the cases' own table."""

import csv
import io
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from scenes import field_of

from skyline.match.config import MatchConfig
from skyline.match.rays import Rays
from skyline.photo.read import read_skyline
from skyline.report.figure_files import encode_figure
from skyline.report.labels import labels_of
from skyline.view.peaks import read_peaks

TRIED = {
    "cone_web_mercator.tif", "crop_mode.jpg", "digital_zoom_2.jpg", "drone_120m.jpg",
    "fisheye_118.jpg", "peaks_many_scripts.csv", "sphere_renamed_xmp_prefix.jpg",
    "unmarked_panorama_110.jpg",
}  # fmt: skip
_ROW = re.compile(r"\| (\S+\.\w+) \| (.*) \| (.*) \|")
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cases(shared_data):
    """The folder of the cases, and what the table says is true of each file."""
    folder = shared_data / "cases"
    rows = _ROW.findall((folder / "README.md").read_text())
    return folder, {name: (about, truth) for name, about, truth in rows}


@pytest.fixture(scope="module")
def davos(shared_data):
    return shared_data / "davos" / "davos_srtm1_30m.tif"


def numbers_in(text):
    return [float(one) for one in _NUMBER.findall(text)]


@pytest.fixture
def oriented(run, cases, davos):
    """Return a function that orients a photo at the place of the cases, as a user would."""
    folder, truths = cases
    lat_lon = numbers_in(truths["unmarked_panorama_110.jpg"][1])[:2]

    def orient(name, *options):
        at = ",".join(map(str, lat_lon))
        done = run("orient", folder / name, "--at", at, "--dem", davos, *options, "--json")
        return json.loads(done.ok().out)

    return orient


def test_every_case_is_tried(cases):
    assert set(cases[1]) == TRIED


@pytest.mark.parametrize(
    ("name", "projection"),
    [("unmarked_panorama_110.jpg", "cylindrical"), ("fisheye_118.jpg", "fisheye")],
)
def test_a_projection_that_nothing_notes_is_named_and_not_trusted(
    cases, oriented, name, projection
):
    found = oriented(name)
    assert not found["trusted"]
    assert "--projection" in found["refusal"]
    assert projection in found["refusal"]
    width_deg = numbers_in(cases[1][name][0])[0]
    _, _, kind = found["refusal"].rpartition("the skyline is bent as by ")
    assert abs(numbers_in(kind)[0] - width_deg) < 0.1 * width_deg


def test_a_fisheye_that_is_said_to_be_one_is_oriented(cases, oriented):
    width_deg = numbers_in(cases[1]["fisheye_118.jpg"][0])[0]
    found = oriented("fisheye_118.jpg", "--projection", "fisheye", "--fov-deg", width_deg)
    assert found["trusted"]
    assert found["heading_deg"] == pytest.approx(180.0, abs=0.3)
    assert found["fov_deg"] == pytest.approx(width_deg, rel=0.02)


def test_an_eye_aloft_stands_at_the_noted_height(cases, oriented):
    found = oriented("drone_120m.jpg")
    (eye_m,) = numbers_in(cases[1]["drone_120m.jpg"][1])
    assert found["trusted"]
    assert found["eye_elevation_m"] == pytest.approx(eye_m, abs=10.0)
    assert found["heading_deg"] == pytest.approx(180.0, abs=0.2)
    assert abs(found["pitch_deg"]) < 0.2


@pytest.mark.parametrize("name", ["digital_zoom_2.jpg", "crop_mode.jpg"])
def test_a_zoomed_or_cropped_field_of_view_is_searched_and_found(cases, oriented, name):
    folder, truths = cases
    fov_deg = numbers_in(truths[name][1])[0]
    skyline = read_skyline(folder / name)
    low_deg, high_deg = Rays.of(skyline, MatchConfig().fov_sd_share, finds_fov=True).fov_bounds_deg
    assert low_deg < fov_deg < high_deg
    assert abs(skyline.fov_deg - fov_deg) < 2.0 * skyline.lens.fov_sd_deg
    found = oriented(name)
    assert found["trusted"]
    assert found["fov_deg"] == pytest.approx(fov_deg, rel=0.02)


def test_a_sphere_is_read_whatever_the_prefix_of_its_namespace(cases):
    folder, truths = cases
    name = "sphere_renamed_xmp_prefix.jpg"
    projection, fov_deg = truths[name][1].removesuffix(" degrees").split(", ")
    skyline = read_skyline(folder / name)
    assert (skyline.projection, skyline.fov_deg) == (projection, float(fov_deg))


def test_names_in_many_scripts_are_each_drawn_or_named(cases):
    """Whatever fonts are installed; a letter that is drawn as a box would be an error."""
    peaks = read_peaks(cases[0] / "peaks_many_scripts.csv", field_of(np.zeros((4, 4))).frame)
    named = [SimpleNamespace(name=name) for name in peaks.names]
    labels, no_font = labels_of(named, peaks.names)
    assert len(labels) + len(no_font) == len(peaks) == 14
    figure = Figure()
    for label in labels:
        figure.text(0.1, 0.1, label.text, **label.style)
    for kind in ("png", "svg", "pdf"):
        assert encode_figure(figure, kind)


def test_a_cone_on_the_web_s_map_is_as_high_as_on_the_ground(cases, run):
    folder, truths = cases
    about, truth = truths["cone_web_mercator.tif"]
    lon, lat = numbers_in(about.partition("from")[2])[:2]
    elevation_deg, azimuth_deg = numbers_in(truth)
    done = run(
        "horizon", folder / "cone_web_mercator.tif", "--at", f"{lon},{lat}", "--step-deg", 0.1
    )
    rows = list(csv.DictReader(io.StringIO(done.ok().out)))
    highest = max(rows, key=lambda row: float(row["elevation_deg"]))
    assert float(highest["elevation_deg"]) == pytest.approx(elevation_deg, abs=0.15)
    assert float(highest["azimuth_deg"]) == pytest.approx(azimuth_deg, abs=0.3)
