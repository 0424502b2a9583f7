"""Names of peaks in pictures: drawn by the fonts that have them, or counted and left out."""

import math

import numpy as np
import pytest
from font_scenes import UNDRAWN
from scenes import candidate_at, field_from

from skyline import PanoramaConfig, Peaks, save_panorama, stand_on
from skyline.photo.skyline import PhotoSkyline
from skyline.report.figure_files import encode_figure
from skyline.report.labels import UnnamedPeaks
from skyline.report.maps import detail_area, draw_match_map
from skyline.report.overlay import draw_labels, draw_overlay
from skyline.report.panorama import draw_panorama
from skyline.report.panorama_view import panorama_view
from skyline.survey.plans import uniform_grid
from skyline.view.viewer import SeenPeak

NAMES = "Plain", f"{UNDRAWN} $1$"
EAST_M = np.array([-600.0, 600.0])
FIELD = field_from(
    lambda east, north: np.maximum(400.0 - np.hypot(np.abs(east) - 600.0, north - 1500.0), 0.0),
    121, 30.0,
)  # fmt: skip
"""A plain with two cones 1,500 m north of its middle."""
EYE = stand_on(FIELD, easting_m=0.0, northing_m=0.0)
PEAKS = Peaks(
    names=NAMES, easting_m=EAST_M, northing_m=np.full(2, 1500.0), height_m=np.full(2, math.nan)
)
NORTH = PanoramaConfig(0.0, 120.0)
SKYLINE = PhotoSkyline(np.full(900, np.nan), np.zeros(900), 900, 400, 60.0)
PHOTO = np.full((400, 900, 3), 90, np.uint8)
SEEN = [
    SeenPeak(
        name=name, easting_m=EAST_M[at], northing_m=600.0, surface_m=0.0,
        grid_azimuth_deg=0.0, elevation_tan=0.0, distance_m=600.0, column_px=200.0 + 400.0 * at,
        row_px=100.0,
    )
    for at, name in enumerate(NAMES)
]  # fmt: skip
WITHOUT = UnnamedPeaks(no_font=(NAMES[1],))


def panorama(kind):
    """Draw a panorama of both cones; return its texts."""
    figure, _ = draw_panorama(panorama_view(FIELD, EYE, PEAKS, NORTH))
    assert encode_figure(figure, kind)
    return "".join(text.get_text() for text in [*figure.texts, *figure.axes[0].texts])


def match_map(kind):
    """Draw a map with both cones; return its texts."""
    pose = candidate_at(0.0, 0.0)
    area = detail_area(pose, FIELD)
    figure = draw_match_map([pose], area, FIELD.frame, uniform_grid(FIELD, 600.0), FIELD, SEEN)
    assert encode_figure(figure, kind)
    (axis,) = figure.axes
    return axis.get_title(loc="left") + "".join(text.get_text() for text in axis.texts)


@pytest.mark.parametrize(
    ("draw", "kind"),
    [(panorama, "png"), (panorama, "svg"), (panorama, "pdf"), (match_map, "png")],
)
def test_a_name_is_drawn_by_the_font_that_has_it_or_counted(install_font, draw, kind):
    texts = draw(kind)
    assert "Plain" in texts
    assert NAMES[1] not in texts
    assert "no installed font draws 1 name" in texts
    install_font("Tiny", UNDRAWN)
    texts = draw(kind)  # Matplotlib's warning of a missing letter would be an error.
    assert NAMES[1] in texts
    assert "no installed font" not in texts


@pytest.mark.parametrize("kind", ["png", "jpeg", "svg"])
def test_names_on_a_photo_are_drawn_by_the_fonts_that_have_them(install_font, kind):
    bare, unnamed = draw_labels(SKYLINE, PHOTO, SEEN, kind=kind)
    assert unnamed == WITHOUT
    assert draw_overlay(SKYLINE, PHOTO, None, peaks=SEEN)[1] == WITHOUT
    install_font("Tiny", UNDRAWN)
    named, unnamed = draw_labels(SKYLINE, PHOTO, SEEN, kind=kind)
    assert unnamed == UnnamedPeaks()
    assert draw_overlay(SKYLINE, PHOTO, None, peaks=SEEN)[1] == UnnamedPeaks()
    if kind == "svg":
        assert NAMES[1] not in bare.decode()
        assert "no installed font draws 1 name" in bare.decode()
        assert NAMES[1] in named.decode()
        assert "no installed font" not in named.decode()


def test_a_title_that_says_all_fits_the_picture():
    """From beside the eastern summit, whose height the eye has, to the western one."""
    crowd = 40
    peaks = Peaks(
        names=tuple(f"Summit {index}" for index in range(crowd)) + (UNDRAWN,) * crowd,
        easting_m=np.full(2 * crowd, -600.0), northing_m=np.full(2 * crowd, 1500.0),
        height_m=np.full(2 * crowd, math.nan),
    )  # fmt: skip
    eye = stand_on(FIELD, easting_m=612.0, northing_m=1490.0, summit_within_m=None)
    west = PanoramaConfig(270.0, 120.0)
    figure, unnamed = draw_panorama(panorama_view(FIELD, eye, peaks, west, FIELD))
    assert (len(unnamed.no_room), len(unnamed.no_font)) == (crowd - 1, crowd)
    (title,) = figure.texts
    for words in (
        "as high as the summit",
        "trees and houses",
        "39 peaks have no",
        "draws 40 names",
    ):
        assert words in title.get_text()
    assert title.get_window_extent().x1 <= figure.bbox.x1
    assert title.get_fontsize() > 8.0


def test_peaks_without_a_name_in_words():
    assert UnnamedPeaks().named == ""
    two = UnnamedPeaks(("A", "B"))
    assert two.named == two.counted == "; 2 peaks have no room for a name"
    both = UnnamedPeaks(("A",), tuple(f"{UNDRAWN} {index}" for index in range(7)))
    assert both.counted == "; 1 peak has no room for a name; no installed font draws 7 names"
    listed = ", ".join(both.no_font[:5])
    assert both.named == f"{both.counted}: {listed} and 2 more"


def test_a_saved_panorama_warns_of_names_that_no_font_draws(tmp_path, caplog):
    lon, lat = map(float, FIELD.frame.to_lonlat(0.0, 0.0))
    path = tmp_path / "north.png"
    assert save_panorama(FIELD, path, lon=lon, lat=lat, peaks=PEAKS, config=NORTH) == 2
    assert len(caplog.records) == 1


def test_a_doubted_name_stands_with_its_probability():
    doubted = SEEN[0].doubted(0.74)
    assert doubted.name == "Plain (74 %)"
    assert doubted.column_px == SEEN[0].column_px
