"""The page without a store: the area of a photo is fetched and built when its place is searched."""

import math

import pytest
from commands import gps_of, noting
from pages import Page, serving
from PIL.ExifTags import Base

from skyline import Frame

PLACE = 9.5, 46.5


@pytest.mark.usefixtures("tile_server")
def test_a_photo_with_gps_is_found_without_a_store(chromium, one_degree, tmp_path, monkeypatch):
    monkeypatch.setenv("SKYLINE_CACHE", str(tmp_path / "cache"))
    camera = {Base.FocalLengthIn35mmFilm: 31}
    noted = noting(one_degree / "photo.jpg", tmp_path / "noted.jpg", camera, gps_of(*PLACE))
    with serving() as server:
        page = Page(chromium, server)
        page.open(one_degree / "photo.jpg")
        page.click("#find")
        assert "does not note where it was taken" in page.until(page.alerts)[0]
        page.open(noted)
        assert page.of("known", "it.known().near") == pytest.approx([*PLACE, 10.0], abs=1e-5)
        # A small area is quickly built. Its model has a sample every 460 m.
        page.script("const it = document.getElementById('radius'); it.value = 0.21; it.oninput()")
        page.match()
        assert "Found" in page.find("#answer").text
        pose = page.state("state.pose")
        frame = Frame.local(lon=PLACE[0], lat=PLACE[1])
        assert math.hypot(*frame.from_lonlat(pose["lon"], pose["lat"])) < 1500.0
        page.settled()
        tiles = "return document.querySelectorAll('.leaflet-tile-loaded').length"
        page.until(lambda: page.script(tiles) > 0)
        # The circle is this photo's alone. The other is searched where a place is given for it.
        page.click("#photos li:first-child .pick")
        page.until(lambda: page.state("state.photo.name") == "photo.jpg")
        page.until(lambda: page.of("known", "it.known().near") is None)
        assert page.state("state.area") is None
        page.script("document.getElementById('known').open = true")
        page.find("#near-place").send_keys("46.51 N, 9.52° E\n")
        assert page.of("known", "it.known().near") == [9.52, 46.51, 1.5]
        assert page.alerts() == []
    assert len(list((tmp_path / "cache").rglob("places-*.h5"))) == 1
