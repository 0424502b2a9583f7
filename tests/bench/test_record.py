"""Benchmark records: what is in them, and that they are whole or absent."""

import json

import pytest

from skyline import __version__
from skyline_bench.measuring import record
from skyline_bench.measuring.record import machine, write_record


def test_the_machine_is_named():
    facts = machine()
    assert set(facts) == {
        "date", "processor", "cores", "os", "python", "numpy", "renderer", "driver", "skyline",
    }  # fmt: skip
    assert all(facts.values())
    assert facts["skyline"] == __version__


def test_a_record_is_what_the_contract_says(tmp_path):
    path = tmp_path / "record.json"
    write_record(path, "speed-error", [{"path": "oracle", "rms_px": 0.0, "tolerance_px": None}])
    written = json.loads(path.read_text())
    assert set(written) == {"bench", "machine", "rows"}
    assert written["bench"] == "speed-error"
    assert written["machine"]["cores"] >= 1
    assert written["rows"] == [{"path": "oracle", "rms_px": 0.0, "tolerance_px": None}]
    assert [each.name for each in tmp_path.iterdir()] == ["record.json"]


def test_a_record_that_cannot_be_written_leaves_the_old_one(tmp_path):
    path = tmp_path / "record.json"
    write_record(path, "stability", [])
    before = path.read_bytes()
    with pytest.raises(TypeError, match="JSON"):
        write_record(path, "stability", [{"error_px": object()}])
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["record.json"]


def test_numbers_that_json_cannot_say_are_null(tmp_path):
    path = tmp_path / "record.json"
    write_record(path, "stability", [{"error_px": float("inf"), "bound_px": float("nan"), "n": 1}])
    rows = json.loads(path.read_text())["rows"]
    assert rows == [{"error_px": None, "bound_px": None, "n": 1}]


def test_a_machine_without_opengl_is_described(monkeypatch):
    def none():
        raise record.ContextError("no OpenGL")

    monkeypatch.setattr(record, "acquire_context", none)
    assert (machine()["renderer"], machine()["driver"]) == ("none", "none")
