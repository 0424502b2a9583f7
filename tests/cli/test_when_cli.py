"""``skyline when`` and ``label --time``: the sun in a photo, there and back."""

import json
from datetime import datetime

import pytest
from commands import assert_refused

TIME = "2026-01-10T08:50:00+00:00"


@pytest.fixture
def label(run, dem, photo, pose, tmp_path):
    """Return a function that labels a photo with its sun, and returns the file."""

    def labelled(name):
        options = "--pose", pose, "--dem", dem, "--time", TIME
        done = run("label", photo, *options, "-o", tmp_path / name).ok()
        assert done.out == f"{tmp_path / name}: in the photo: the sun\n"
        assert "the moon is outside the photo, at azimuth" in done.err
        return tmp_path / name

    return labelled


def test_the_sun_is_drawn_into_a_photo(label):
    assert "#ffd23f" in label("sun.svg").read_text()


def test_a_label_without_peaks_and_without_a_time_names_both(run, dem, photo, pose, tmp_path):
    done = run("label", photo, "--pose", pose, "--dem", dem, "-o", tmp_path / "a.png")
    assert_refused(done, "give the summits as --peaks FILE, or the photo's --time")


def test_the_sun_in_a_photo_gives_back_the_time_and_the_heading(run, dem, photo, pose, label):
    sun = json.loads(label("sun.json").read_text())[-1]
    assert sun["name"] == "sun"
    assert 100.0 < sun["azimuth_deg"] < 180.0
    common = "when", photo, "--pose", pose, "--dem", dem
    pixel = "--sun", f"{sun['column_px']},{sun['row_px']}"
    done = run(*common, *pixel, "--date", TIME[:10], "--json").ok()
    (found,) = json.loads(done.out)["times"]
    off = datetime.fromisoformat(found["time"]) - datetime.fromisoformat(TIME)
    assert abs(off.total_seconds()) < 2.0
    # A degree of the sun's azimuth takes some four minutes, and the heading is good to half of one.
    assert 60.0 < found["sd_s"] < 400.0
    assert "heading 0.5, pitch 6 and roll 3 degrees" in json.loads(done.out)["assumed"]
    told = run(*common, *pixel, "--date", TIME[:10]).ok().out
    assert "give or take" in told
    assert "errors assumed, since no covariance is given: place 10 m" in told
    turned = json.loads(run(*common, *pixel, "--time", TIME, "--json").ok().out)
    heading_deg = json.loads(pose.read_text())["heading_deg"]
    assert turned["heading_deg"] == pytest.approx(heading_deg, abs=0.01)
    assert "0.0 standard errors away" in run(*common, *pixel, "--time", TIME).ok().out
