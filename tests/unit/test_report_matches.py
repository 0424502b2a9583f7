"""Reports of matches, looked at as pixels, as text and in a browser."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import candidate_at, field_of, fractal
from store_rows import VIEWS_HEADER

from skyline.errors import InputError
from skyline.match.result import MatchResult
from skyline.photo.skyline import PhotoSkyline
from skyline.report import exports
from skyline.report.figure_files import encode_figure
from skyline.report.labels import place_labels
from skyline.report.maps import detail_area, draw_match_map
from skyline.report.match_page import report_matches
from skyline.report.overlay import draw_overlay
from skyline.survey.plans import uniform_grid
from skyline.terrain.viewpoints import stand_on
from skyline.view.peaks import Peaks
from skyline.view.viewer import Viewer, sight_of
from skyline_bench.truth import oracle

FIELD = field_of(fractal(120, 120, seed=1), west_m=0.0, north_m=3600.0)
EYE = stand_on(FIELD, easting_m=1800.0, northing_m=1800.0)
EYE_M = float(EYE.eye_elevation_m[0])
BEST = candidate_at(
    1800.0, 1800.0, 350.0, 12.0, 4.0, 70.0, eye_elevation_m=EYE_M, confidence=0.9,
    covariance_m2=((1e4, 0.0), (0.0, 2e4)),
)  # fmt: skip
OTHER = candidate_at(900.0, 1800.0, 80.0, 12.0, 4.0, 70.0, eye_elevation_m=EYE_M, rank=2)
WIDTH_PX, HEIGHT_PX = 900, 600
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


VIEWS = oracle.skyline(FIELD, EYE, 256)
BLANK = PhotoSkyline(np.full(WIDTH_PX, np.nan), np.zeros(WIDTH_PX), WIDTH_PX, HEIGHT_PX, 70.0)


class OracleViewer(Viewer):
    """A viewer on one field, whose views are the oracle's."""

    def _views(self, eye, pose):
        return oracle.skyline(self.terrain, eye, 256)


@pytest.fixture(autouse=True)
def oracle_viewer(monkeypatch):
    monkeypatch.setattr("skyline.report.match_page.Viewer", OracleViewer)


SIGHT = sight_of(BEST, BLANK, VIEWS)
ORDER = np.argsort(SIGHT.column_px)
ROW_PX = np.interp(np.arange(WIDTH_PX), SIGHT.column_px[ORDER], SIGHT.row_px[ORDER])
ROW_PX[200:380] = np.nan
ROW_PX[(ROW_PX < 0.0) | (ROW_PX > HEIGHT_PX)] = np.nan
SKYLINE = replace(BLANK, row_px=ROW_PX, trust=np.isfinite(ROW_PX) * 1.0)
"""The skyline that the best candidate would take, a fifth of its columns masked."""
MATCHER = SimpleNamespace(
    frame=FIELD.frame, viewpoints=uniform_grid(FIELD, 600.0), terrain=FIELD, header=VIEWS_HEADER,
    render_thread=None,
)  # fmt: skip


def pixels(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).astype(int)


def like(image, rgb, within=90):
    return np.abs(image[..., ::-1] - np.array(rgb)).sum(axis=-1) < within


def test_the_overlay_draws_both_skylines_where_they_are():
    photo = np.full((HEIGHT_PX, WIDTH_PX, 3), 40, np.uint8)
    image = pixels(draw_overlay(SKYLINE, photo, BEST, SIGHT)[0])
    assert image.shape[1] == WIDTH_PX
    assert HEIGHT_PX < len(image) < HEIGHT_PX + 60
    found, rendered = like(image, (255, 210, 63)), like(image, (53, 208, 255))
    columns = np.flatnonzero(SKYLINE.trusted)[::25]
    rows = np.rint(SKYLINE.row_px[columns]).astype(int)
    near = [found[max(r - 3, 0) : r + 4, c].any() for r, c in zip(rows, columns, strict=True)]
    assert np.mean(near) > 0.9
    assert not found[:450, 215:365].any()
    # Where the found skyline is masked, the rendered one is there alone, and the ground is veiled.
    assert rendered[:450, 215:365].any(axis=0).mean() > 0.8
    assert image[450:470, 230:350].mean() > image[450:470, 600:700].mean() + 5.0
    bare = pixels(draw_overlay(SKYLINE, photo, BEST)[0])
    assert not like(bare, (53, 208, 255)).any()


def report(folder, results, matcher=MATCHER, peaks=None, photos=None, done=""):
    page = report_matches(folder, matcher, results, peaks, photos or [None] * len(results), done)
    assert page == folder / "index.html"
    return page.read_text()


@pytest.fixture
def shown(tmp_path):
    """The page of a report of one photo, whose name and whose peak's are markup."""
    place_m = {"easting_m": np.array([1500.0]), "northing_m": np.array([3000.0])}
    peaks = Peaks(
        names=("<i>Top</i> $ \u5bcc\u58eb\u5c71",), **place_m, height_m=np.array([np.nan])
    )
    photo = np.full((HEIGHT_PX, WIDTH_PX, 3), 120, np.uint8)
    found = MatchResult(SKYLINE, (BEST, OTHER), 1.5, name="a/<script>.jpg")
    return report(tmp_path, [found], MATCHER, peaks, [photo], "Matched & refined.")


def test_a_report_says_where_the_photo_was_taken(shown):
    assert f"{BEST.lat:.5f}" in shown
    assert f"{BEST.lon:.5f}" in shown
    assert "confidence 90\N{NO-BREAK SPACE}%" in shown
    assert "Matched &amp; refined. It took 1.50 s." in shown
    assert "0.0" in shown.split("they are ")[1][:4]


def test_a_report_takes_no_name_for_markup(shown):
    assert "&lt;script&gt;.jpg" in shown
    assert "<script" not in shown
    assert "<i>" not in shown


def test_a_report_holds_its_pictures_and_loads_nothing(shown):
    assert shown.count('src="data:image/') == 2
    assert not re.search(r'src="(?!data:)|url\(|@import|<link|<iframe', shown)
    assert "default-src 'none'" in shown


@pytest.mark.usefixtures("shown")
def test_a_report_shows_its_map_in_a_file_of_its_own(tmp_path):
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "01-map.png", "01-overlay.jpg", "index.html", "matches.geojson",
    ]  # fmt: skip
    assert len(json.loads((tmp_path / "matches.geojson").read_text())["features"]) == 5
    picture = pixels((tmp_path / "01-map.png").read_bytes())
    assert picture.std() > 20.0
    assert like(picture, (209, 16, 61)).sum() > 100
    assert like(picture, (31, 95, 191)).sum() > 100


def test_many_viewpoints_hide_no_relief():
    area, light = detail_area(BEST, FIELD), []
    for spacing_m in (1500.0, 30.0):
        eyes = uniform_grid(FIELD, spacing_m)
        figure = draw_match_map([BEST], area, FIELD.frame, eyes, FIELD, [])
        light.append(pixels(encode_figure(figure)).mean())
    assert light[1] > 0.9 * light[0]
    places = np.stack([eyes.easting_m, eyes.northing_m], axis=1)
    shown = np.count_nonzero(((area.min <= places) & (places <= area.max)).all(axis=1))
    assert 1000 < shown < len(places)
    title = figure.axes[0].get_title(loc="left")
    assert title == f"{shown:,} of the store's viewpoints (dots)"


def test_a_report_without_room_leaves_no_new_folder(tmp_path, monkeypatch):
    def full(path, _):
        raise InputError(f"{path} cannot be written: no space")

    monkeypatch.setattr(exports, "write_whole", full)
    (tmp_path / "old").mkdir()
    for name in ("new", "old"):
        with pytest.raises(InputError):
            report(tmp_path / name, [MatchResult(SKYLINE, (), 0.1, "fog")])
    assert [one.name for one in tmp_path.iterdir()] == ["old"]


def test_a_report_distinguishes_abstention_from_failure(tmp_path):
    results = [
        MatchResult(SKYLINE, (replace(OTHER, rank=1),), 0.1, "not sure", name="unsure.jpg"),
        MatchResult(SKYLINE, (), 0.1, "too little skyline", name="nothing.jpg"),
        MatchResult(SKYLINE, (replace(BEST, easting_m=-5000.0),), 0.1, name="off.jpg"),
    ]
    html = report(tmp_path, results)
    assert "1 of 3 photos answered" in html
    assert "Not answered: not sure (latitude" in html
    assert "Not answered: too little skyline." in html
    without_terrain = SimpleNamespace(**{**vars(MATCHER), "terrain": None})
    bare = report(tmp_path, results[2:], without_terrain)
    assert "no elevation model" in bare
    assert "no skyline was rendered" in bare


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium to look at the page with")
def test_a_browser_shows_the_page(tmp_path):
    report(tmp_path / "report", [MatchResult(SKYLINE, (BEST, OTHER), 1.5, name="photo.jpg")])
    shot = tmp_path / "shot.png"
    flags = "--headless --no-sandbox --disable-gpu --hide-scrollbars --window-size=1000,1900"
    paths = f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={shot}"
    command = [CHROMIUM, *flags.split(), *paths, (tmp_path / "report" / "index.html").as_uri()]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    seen = pixels(shot.read_bytes())
    # The overlay's canvas and both its lines, then the map below it, then the table's text.
    overlay, below = seen[150:750], seen[850:1600]
    assert like(overlay, (255, 210, 63), 120).sum() > 300
    assert like(overlay, (53, 208, 255), 120).sum() > 300
    assert below.std() > 20.0
    assert like(below, (209, 16, 61)).sum() > 100


LABELS_PX = 1000.0
PEAKS = st.lists(st.tuples(st.floats(0.0, LABELS_PX), st.floats(5.0, 300.0)), max_size=25)


@given(PEAKS)
def test_labels_and_leaders_keep_apart(peaks):
    placed = place_labels(
        [at for at, _ in peaks], [w for _, w in peaks], LABELS_PX, rows=4, gap=8.0
    )
    for label in placed:
        assert 0.0 <= label.left <= label.anchor <= label.right <= LABELS_PX
        assert 0 <= label.row < 4
    for one, other in combinations(placed, 2):
        if one.row == other.row:
            assert one.right <= other.left or other.right <= one.left
        low, high = sorted((one, other), key=lambda label: label.row)
        if low.row < high.row:
            assert not low.left <= high.anchor <= low.right


def test_summits_nearer_than_half_a_label_are_both_named():
    placed = place_labels([342.0, 385.0], [130.0, 140.0], LABELS_PX, rows=6, gap=8.0)
    assert [label.row for label in placed] == [1, 0]
