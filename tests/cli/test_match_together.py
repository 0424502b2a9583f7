"""`skyline match --same-place`: photos of one place."""

import json

import pytest
from commands import assert_refused, off_m
from scenes import at_m, take_photo

from skyline import read_dem, stand_on


@pytest.fixture(scope="module")
def photos_of_one_place(dem, photo, tmp_path_factory):
    """The photo, one more from its place, and one from another place."""
    folder, terrain = tmp_path_factory.mktemp("photos"), read_dem([dem])
    here, there = (601_800.0, 5_178_000.0), (601_200.0, 5_178_600.0)

    def taken(name, place, heading_deg):
        eye = stand_on(terrain, **at_m(place))
        return take_photo(folder / name, terrain, eye, heading_deg, 1600)

    return [photo, taken("other_way.jpg", here, 30.0), taken("stranger.jpg", there, 200.0)]


@pytest.mark.slow
def test_photos_of_one_place_are_matched_together(run, store, photos_of_one_place, tmp_path):
    first, second, stranger = photos_of_one_place
    points, broken = tmp_path / "points.geojson", tmp_path / "broken.jpg"
    broken.write_bytes(b"no picture")
    done = run(
        *("match", store, first, second, stranger, broken, "--fov-deg", "60", "--same-place"),
        *("--json", "--export", points),
    )
    assert done.code == 2
    assert str(broken) in done.err
    record = json.loads(done.out)
    assert record["answer_within_m"] in (200.0, 1000.0)
    assert record["candidates"][0] == record["answer"]
    assert off_m(record["answer"]) < min(10.0, 3.0 * record["answer"]["radius_m"])
    assert [one["photo"] for one in record["photos"]] == [str(one) for one in photos_of_one_place]
    assert [one["agrees"] for one in record["photos"]] == [True, True, False]
    assert abs(record["photos"][0]["heading_deg"] - 141.0) < 1.0
    assert abs(record["photos"][1]["heading_deg"] - 31.0) < 1.0
    assert "heading_deg" not in record["photos"][2]
    features = json.loads(points.read_text())["features"]
    first = [one["geometry"] for one in features if one["properties"]["rank"] == 1]
    at, same = [one["coordinates"] for one in first if one["type"] == "Point"]
    assert at == same


def test_options_that_do_not_go_with_one_place_are_refused_at_once(run, photo, tmp_path):
    def refused(*arguments):
        return run("match", tmp_path / "no_store.h5", photo, *arguments, "--same-place")

    assert_refused(refused(), "needs two photos or more that can be read, and has 1")
    assert_refused(refused(photo, "--results", tmp_path / "r.csv"), "leave --results out")
    assert_refused(refused(photo, "--matcher", "unrefined"), "leave --matcher out")
    assert_refused(refused(photo, "--workers", 2), "leave --workers out")
