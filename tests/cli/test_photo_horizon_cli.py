"""``skyline horizon --photo``: the horizon that a photo shows."""

import csv
import io

import numpy as np
from commands import assert_refused


def test_a_photos_horizon_is_the_models_where_nothing_else_stands(run, dem, photo, pose):
    done = run("horizon", dem, "--photo", photo, "--pose", pose).ok()
    assert "% of the horizon is the photo's skyline" in done.err
    rows = list(csv.DictReader(io.StringIO(done.out)))
    lon, lat = rows[0]["lon"], rows[0]["lat"]
    model = list(csv.DictReader(io.StringIO(run("horizon", dem, "--at", f"{lon},{lat}").ok().out)))
    off_deg = [
        float(one["elevation_deg"]) - float(other["elevation_deg"])
        for one, other in zip(rows, model, strict=True)
    ]
    from_photo = np.array([one["distance_m"] == "" for one in rows])
    # Of a field of view of 60 degrees.
    assert 50.0 < 0.5 * from_photo.sum() < 61.0
    assert np.median(np.abs(np.array(off_deg)[from_photo])) < 0.1
    assert np.abs(np.array(off_deg)[~from_photo]).max() < 0.1


def test_a_photo_needs_its_pose_and_no_position(run, dem, photo, pose):
    assert_refused(run("horizon", dem, "--photo", photo), "expected both or neither")
    assert_refused(
        run("horizon", dem, "--photo", photo, "--pose", pose, "--at", "9,46"), "give positions as"
    )
