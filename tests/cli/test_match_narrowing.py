"""`skyline match`: narrowing a search by what is known of where a photo was taken."""

import json
import math

import pytest
from commands import assert_refused, csv_of, lonlat_of, off_m

from skyline import read_dem
from skyline.terrain.heightfield import ground_of

CELL_M = 40.0 * math.sqrt(2.0)
"""No place of a grid of 80 m is farther off than this."""


def retrieved(run, store, photo, *options):
    """Return what was found for a photo taken at (601800, 5178000), looking 141 degrees."""
    common = "match", store, photo, "--fov-deg", "60", "--matcher", "unrefined", "--json"
    found = run(*common, *options).ok()
    candidates = json.loads(found.out)["candidates"]
    assert candidates
    return candidates


def test_match_within_bounds(run, store, dem, photo):
    west, south = lonlat_of(dem, 600_800.0, 5_177_500.0)
    east, north = lonlat_of(dem, 601_500.0, 5_178_500.0)
    options = ("--bounds", f"{west},{south},{east},{north}", "--matcher", "full")
    for place in retrieved(run, store, photo, *options):
        # Meridians are not parallel to the map's north.
        assert 600_800.0 - 20.0 < place["easting_m"] < 601_500.0 + 20.0
        assert 5_177_500.0 - 20.0 < place["northing_m"] < 5_178_500.0 + 20.0


@pytest.mark.parametrize("heading", [141.0, 300.0])
def test_match_along_a_heading(run, store, photo, heading):
    found = retrieved(run, store, photo, "--heading", heading, "--heading-slack", 8)
    for place in found:
        assert abs(place["heading_deg"] - heading) <= 8.0
    assert (off_m(found[0]) < CELL_M) == (heading == 141.0)


def test_match_between_elevations(run, store, dem, photo, tmp_path):
    def between(low_m, high_m):
        rows, header = [f"{photo},{low_m},{high_m}"], "path,lowest_m,highest_m"
        return retrieved(run, store, csv_of(tmp_path / "list.csv", rows, header))

    ground_m = ground_of(read_dem([dem]))
    true_m = float(ground_m(601_800.0, 5_178_000.0))
    assert off_m(between(true_m - 20.0, true_m + 20.0)[0]) < CELL_M
    # A retrieved eye stands where the slope of its place says that the ground is.
    for place in between(true_m + 40.0, true_m + 400.0):
        assert ground_m(place["easting_m"], place["northing_m"]) > true_m + 30.0


def test_a_search_narrowed_to_nothing_writes_no_report(run, store, photo, tmp_path):
    command = ["match", store, photo, "--fov-deg", "60"]
    for area in (("--bounds", "9.0,46.0,9.1,46.1"), ("--near", "9.0,46.0,5")):
        done = run(*command, *area, "--report", tmp_path / "report")
        assert_refused(done)
    assert not (tmp_path / "report").exists()


def test_places_near_photo_spots_are_preferred(run, store, dem, photo, tmp_path):
    lon, lat = lonlat_of(dem, 601_800.0, 5_178_000.0)
    spots = csv_of(tmp_path / "spots.csv", [f"{lon},{lat}"], "lon,lat")
    plain, preferred = (
        retrieved(run, store, photo, "--matcher", "full", *options)[0]
        for options in ((), ("--photo-spots", spots))
    )
    assert off_m(preferred) < 20.0
    assert preferred["cost"] < plain["cost"] - 8.0


@pytest.mark.parametrize(
    ("spot", "error"),
    [
        ("9.0,46.0", "near one of the photo spots; give spots of that area\n"),
        ("46.75,10.33", "longitude and latitude seem to be swapped: give 10.33,46.75"),
    ],
)
def test_photo_spots_far_from_the_places_searched_are_refused(
    run, store, photo, tmp_path, spot, error
):
    spots = csv_of(tmp_path / "spots.csv", [spot], "lon,lat")
    assert_refused(run("match", store, photo, "--fov-deg", "60", "--photo-spots", spots), error)


def test_photo_spots_need_refinement(run, store, photo, tmp_path):
    spots = csv_of(tmp_path / "spots.csv", ["10.33,46.75"], "lon,lat")
    done = run("match", store, photo, "--matcher", "unrefined", "--photo-spots", spots)
    assert_refused(done, "--photo-spots works in refinement; leave --matcher unrefined out")
