"""``skyline cross``: something that two photos show."""

import json

from commands import assert_refused

from skyline import NotedPose, Projection, Viewer, read_dem, read_photo


def test_a_thing_in_two_photos_is_placed(run, dem, photo, pose, tmp_path):
    first = json.loads(pose.read_text())
    picture = read_photo(photo)
    with Viewer(read_dem([dem])) as viewer:
        here, _ = viewer.pose_of(NotedPose.from_dict(first, Projection.PERSPECTIVE))
        # The first looks to the south-east; the second, 400 m to its left, more to the right.
        place_m = here.easting_m + 300.0, here.northing_m + 250.0
        lon, lat = map(float, viewer.frame.to_lonlat(*place_m))
        second = first | {"lon": lon, "lat": lat, "heading_deg": first["heading_deg"] + 45.0}
    other = tmp_path / "other.json"
    other.write_text(json.dumps(second))
    middle = f"{picture.width_px / 2 - 0.5},{picture.height_px / 2 - 0.5}"
    common = "cross", photo, photo, "--pose", pose, "--pose", other, "--dem", dem
    done = run(*common, "--pixel", middle, "--pixel", middle, "--json").ok()
    found = json.loads(done.out)
    assert {"lon", "lat", "elevation_m", "above_ground_m", "meets"} <= found.keys()
    assert found["assumed"].startswith("place 10 m, elevation 7 m, heading 0.5")
    told = run(*common, "--pixel", middle, "--pixel", middle).ok().out
    assert "give or take" in told
    assert "errors assumed, since no covariance is given: place 10 m" in told
    assert_refused(run(*common, "--pixel", middle), "one --pose and one --pixel for each photo")


def test_one_photo_is_refused(run, dem, photo, pose):
    done = run("cross", photo, "--pose", pose, "--pixel", "1,1", "--dem", dem)
    assert_refused(done, "skyline pixels")
