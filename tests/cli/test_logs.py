"""``SKYLINE_LOG=json``: standard error as JSON lines for a service."""

import json
import os
import subprocess
import sys
from datetime import UTC, datetime, timedelta


def run_logged(*arguments, log="json"):
    """Run a command; return its exit code, its output, and the lines of standard error."""
    done = subprocess.run(
        [sys.executable, "-c", "from skyline.cli import main; main()", *map(str, arguments)],
        env=os.environ | {"SKYLINE_LOG": log},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr.splitlines()


def test_every_line_is_json(store, photo, tmp_path):
    empty = tmp_path / "empty.jpg"
    empty.write_bytes(b"")
    common = ("--fov-deg", "60", "--matcher", "unrefined", "--json")
    code, out, lines = run_logged("match", store, photo, empty, *common)
    assert code == 2
    assert [set(json.loads(line)) >= {"query"} for line in out.splitlines()] == [True, True]
    records = [json.loads(line) for line in lines]
    for record in records:
        age = datetime.now(UTC) - datetime.fromisoformat(record["time"])
        assert timedelta() < age < timedelta(minutes=10)
        assert record["level"] in {"info", "warning", "error"}
        assert record["message"]
    (failed,) = [one["message"] for one in records if one["level"] == "error"]
    assert str(empty) in failed
    progress = [one for one in records if "done" in one]
    assert {one["doing"] for one in progress} == {"matching"}
    assert progress[-1]["done"] == progress[-1]["total"] == 2


def test_an_unknown_kind_of_log_is_one_line(dem):
    code, out, lines = run_logged("info", dem, log="xml")
    assert (code, out) == (2, "")
    assert lines == ["error: SKYLINE_LOG is 'xml'; expected json, or nothing"]
