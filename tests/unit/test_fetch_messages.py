"""What is said where elevation tiles cannot be fetched, each in one line."""

import pytest
from range_server import serve_apart
from refusals import assert_says
from tile_scenes import (
    EAST,
    IN_THE_EAST,
    NAMES,
    ONCE_MORE,
    SAMPLES,
    VRT,
    fetch,
    geotiff,
    masked_tile,
)

from skyline.errors import FetchError
from skyline.fetch import remote
from skyline.fetch.dem_tiles import MAX_TILES
from skyline.fetch.remote import Patience


class TestServers:
    @pytest.mark.parametrize(
        ("trouble", "said"),
        [
            ({"truncate": 10_000}, "breaks off or is damaged"),
            ({"delay_s": 30.0}, r"no answer \(.*\), tried 2 times"),
            ({"failures": 10_000}, "answers HTTP 500, tried 2 times; give the same command again"),
            ({"status": {EAST: 403}}, "HTTP 403, not tried again; check that the source is open"),
            ({"failing_get": 10_000}, "HTTP 503, tried 2 times; give the same command again"),
            ({"files": {EAST: VRT}}, "not a GeoTIFF"),
        ],
    )
    def test_that_fail(self, template, server, tmp_path, trouble, said):
        vars(server).update(trouble)
        # The address is named as the user knows it.
        said = rf"^(?!.*vsicurl).*http://127\.0\.0\.1.*\.tif.*{said}"
        assert_says(said, lambda: fetch(template, tmp_path, patience=ONCE_MORE), FetchError)

    def test_that_fail_are_tried_as_often_as_asked_for(self, template, server, tmp_path):
        server.failures = 10_000
        assert_says("HTTP 500, tried 3 times", lambda: fetch(template, tmp_path), FetchError)

    def test_that_are_not_found(self, tmp_path, monkeypatch):
        monkeypatch.setattr(remote.time, "sleep", lambda _: None)
        address = "http://127.0.0.1:9/{lat}{lon}.tif"
        said = r"no answer \(.*\), tried 3 times; check the address"
        assert_says(said, lambda: fetch(address, tmp_path, patience=Patience()), FetchError)

    def test_that_refuse_one_tile(self, template, server, tmp_path):
        server.status = {EAST: 403}
        said = r"^1 of 2 tiles could not be fetched, N46E010: http:"
        assert_says(said, lambda: fetch(template, tmp_path), FetchError)

    def test_that_refuse_many_tiles(self, template, server, tmp_path):
        server.status = {f"/N46E{lon:03d}.tif": 403 for lon in range(9, 16)}
        bounds = (9.8, 46.6, 15.1, 46.8)
        said = r"^7 of 7 tiles .*, N46E009, N46E010, N46E011, N46E012, N46E013 and 2 more: .*403"
        assert_says(said, lambda: fetch(template, tmp_path, bounds), FetchError)

    def test_whose_address_has_secrets(self, template, server, tmp_path):
        server.failures = 10_000
        secret = template.replace("http://", "http://me:secret@") + "?sig=secret"
        said = r"^(?!.*secret).*http://.*HTTP 500"
        assert_says(said, lambda: fetch(secret, tmp_path), FetchError)

    def test_that_have_nothing_of_the_bounds(self, template, tmp_path):
        bounds = (30.2, 20.2, 30.4, 20.4)
        assert_says("none of N20E030", lambda: fetch(template, tmp_path, bounds))


@pytest.mark.parametrize(
    "template",
    [
        "file:///etc/{lat}.tif",
        "coprenicus",
        "http://host/{lat.__class__}.tif",
        "http://host/a.tif",
        "http://h/{lat:{lon}}{lon}",
        "http://h/{lat:9999999999d}{lon}",
        "http://h/{lat!r}{lon}",
        "http://h/{lat}{lon}{",
        "",
    ],
)
def test_a_template_that_is_none(template, tmp_path):
    said = "expected copernicus, or an http or https address"
    assert_says(said, lambda: fetch(template, tmp_path))


def test_too_large_bounds(tmp_path):
    said = rf"need 400 tiles, about 20\.7 GB.*at most {MAX_TILES}"
    assert_says(said, lambda: fetch("copernicus", tmp_path, (0.0, 30.0, 20.0, 50.0)))


class TestTiles:
    @pytest.mark.parametrize(
        ("options", "said"),
        [
            ({"west": 10.0, "crs": "EPSG:32632"}, "expected degrees"),
            ({"west": 20.0}, "no part of the bounds"),
            ({"west": 9.0}, "no part of the bounds in the cell of one degree at 10,46"),
        ],
    )
    def test_that_do_not_fit(self, template, server, heights, tmp_path, options, said):
        server.files[EAST] = geotiff(heights[:, SAMPLES:], **options)
        assert_says(said, lambda: fetch(template, tmp_path))

    @pytest.mark.parametrize("kind", ["mask", "alpha"])
    def test_with_a_mask(self, heights, tmp_path, kind):
        files = masked_tile(kind, heights[:, SAMPLES:], tmp_path / "masked.tif")
        with serve_apart(files) as server:
            template = server.address + NAMES
            said = "marks its voids by a mask"
            assert_says(said, lambda: fetch(template, tmp_path / "new", IN_THE_EAST))

    def test_of_someone_else(self, template, tmp_path):
        (tmp_path / "N46E009.tif").write_bytes(b"mine")
        said = "was not fetched by skyline from"
        assert_says(said, lambda: fetch(template, tmp_path))

    def test_of_another_source(self, template, tmp_path):
        fetch(template, tmp_path)
        other = template.replace("127.0.0.1", "localhost")
        said = "was not fetched by skyline from"
        assert_says(said, lambda: fetch(other, tmp_path))
