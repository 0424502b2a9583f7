"""Records: what they name, and ``skyline-bench repeat``."""

import json
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from commands import assert_refused
from scenes import fractal, write_dem

from skyline import __version__, open_store, read_dem
from skyline_bench.records import data_digest

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "bench" / "results"
QUICK = (
    "--spacing", 600, "--matcher", "correlation", "--kind", "plain", "--queries", 2, "--seed", 7,
)  # fmt: skip


@pytest.fixture
def home(dem, tmp_path, monkeypatch):
    """A folder with data/a/dem.tif, in which commands are run."""
    (tmp_path / "data" / "a").mkdir(parents=True)
    shutil.copy(dem, tmp_path / "data" / "a" / "dem.tif")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def record(run_bench, home, monkeypatch):
    """The record of a search that was started in the folder of the data."""
    monkeypatch.chdir(home / "data")
    run_bench("matching", "a/dem.tif", *QUICK, "--json", home / "found.json").ok()
    monkeypatch.chdir(home)
    return home / "found.json"


def read(path):
    return json.loads(Path(path).read_text())


def test_a_record_names_command_data_area_seed_code_and_machine(record, home):
    written, dem = read(record), home / "data" / "a" / "dem.tif"
    assert written["command"] == (
        "skyline-bench matching a/dem.tif --spacing 600 --matcher correlation --kind plain "
        "--queries 2 --json found.json --seed 7"
    )
    assert written["seed"] == 7
    sha256 = subprocess.run(["sha256sum", dem], capture_output=True, text=True, check=True).stdout
    assert written["inputs"] == [{"path": "a/dem.tif", "digest": sha256.split()[0]}]
    terrain = read_dem([dem])
    assert written["dem"] == {"digest": terrain.digest, "bounds_deg": list(terrain.box_deg)}
    west, south, east, north = written["bounds_deg"]
    assert terrain.box_deg[0] <= west < east <= terrain.box_deg[2]
    assert terrain.box_deg[1] <= south < north <= terrain.box_deg[3]
    assert list(written["stores"]) == ["uniform-600"]
    assert written["code"]["skyline"] == __version__
    commit = subprocess.run(
        ["git", "-C", ROOT, "rev-parse", "HEAD"], capture_output=True, text=True, check=False
    )
    assert written["code"].get("commit") == (commit.stdout.strip() or None)
    assert set(written["machine"]) == {
        "date", "processor", "cores", "os", "python", "numpy", "renderer", "driver",
    }  # fmt: skip
    assert all(written["machine"].values())


def test_a_record_is_made_again_from_its_command(run_bench, record, home):
    done = run_bench("repeat", record, "--data", "data", "--output", "new").ok()
    before, after = read(record), read(home / "new" / "found.json")
    for name in ("command", "seed", "inputs", "dem", "bounds_deg", "stores"):
        assert after[name] == before[name], name
    for old, new in zip(before["rows"], after["rows"], strict=True):
        timed = {name for name in old if name.endswith("_s")}
        assert {k: old[k] for k in old.keys() - timed} == {k: new[k] for k in new.keys() - timed}
    assert "rows: 3 before, 3 now" in done.out
    assert "within_200m" not in done.out.split("rows: 3 before")[1]
    # Nothing is replaced unless --output says so.
    run_bench("repeat", record, "--data", "data").ok()
    assert read(record) == before
    assert (home / "repeated" / "found.json").is_file()


def test_what_differs_is_shown(run_bench, record, home):
    changed = read(record)
    changed["rows"][0]["within_1km"] = 0.25
    record.write_text(json.dumps(changed | {"seed": 8}))
    out = run_bench("repeat", record, "--data", "data").ok().out
    assert "within_1km" in out
    assert "0.25" in out
    assert "seed: 8 before, 7 now" in out


def test_data_are_found_by_the_ends_of_their_paths(run_bench, home):
    dem = home / "data" / "a" / "dem.tif"
    run_bench("matching", dem, *QUICK, "--json", "found.json").ok()
    assert str(dem) in shlex.split(read("found.json")["command"])
    run_bench("repeat", "found.json").ok()
    (home / "data").rename(home / "moved")
    for folder in ("moved", "moved/a"):
        run_bench("repeat", "found.json", "--data", folder).ok()
    assert read("repeated/found.json")["inputs"][0]["path"] == "dem.tif"
    assert_refused(run_bench("repeat", "found.json", "--data", home), "1 of the 1 files")


def test_other_data_are_refused(run_bench, record, home):
    write_dem(home / "data" / "a" / "dem.tif", fractal(110, 120, 250.0, seed=12))
    refused = run_bench("repeat", record, "--data", "data")
    assert_refused(refused, "data/a/dem.tif has the digest")
    assert read(record)["inputs"][0]["digest"][:12] in refused.err
    assert not (home / "repeated").exists()


def test_a_missing_folder_of_data_is_refused(run_bench, record, home):
    refused = run_bench("repeat", record, "--data", "/nosuch")
    assert_refused(refused, "--data /nosuch is no folder; name the folder of the record's data")


def test_a_photograph_that_a_manifest_names_is_data_too(run_bench, photo, home):
    shutil.copy(photo, home / "data" / "a.jpg")
    (home / "data" / "held.csv").write_text("photo,kind\na.jpg,extract\n")
    run_bench("photos", "data/held.csv", "--page", "page.html", "--json", "found.json").ok()
    written = read("found.json")
    assert [one["path"] for one in written["inputs"]] == ["data/held.csv", "data/a.jpg"]
    assert written["outputs"] == ["page.html", "found.json"]
    run_bench("repeat", "found.json", "--output", "new").ok()
    assert (home / "new" / "page.html").is_file()
    (home / "data" / "a.jpg").write_bytes(photo.read_bytes() + b"\0")
    assert_refused(run_bench("repeat", "found.json"), "data/a.jpg has the digest")


def test_a_record_of_before_says_what_is_missing(run_bench, tmp_path):
    old = tmp_path / "old.json"
    old.write_text('{"bench": "matching", "machine": {}, "rows": []}')
    message = "has no command, no inputs, no outputs: it is older than `repeat`; measure matching"
    assert_refused(run_bench("repeat", old), message)
    other = {"bench": "confidence", "command": "python -m skyline_training confidence data"}
    old.write_text(json.dumps(other | {"rows": [], "inputs": [], "outputs": []}))
    assert_refused(run_bench("repeat", old), "another program: python -m skyline_training")
    old.write_text(json.dumps(other | {"bench": "table1", "rows": [], "inputs": 3, "outputs": []}))
    assert_refused(run_bench("repeat", old), "is damaged")
    for text in ("{", "[]", '{"bench": "table1", "rows": 3}', '{"bench": "table1", "rows": [3]}'):
        old.write_text(text)
        assert_refused(run_bench("repeat", old), "is no record; expected")
    assert_refused(run_bench("repeat", tmp_path / "none.json"), "does not exist")


def test_a_store_s_digest_is_of_its_rows(store, dem, tmp_path):
    copied = shutil.copy(store, tmp_path / "other.h5")
    with open_store(store) as one, open_store(copied) as other:
        assert one.digest == other.digest == data_digest(Path(copied))
    assert data_digest(Path(dem)) != data_digest(Path(store))


@pytest.mark.parametrize("path", sorted(RESULTS.glob("*.json")), ids=lambda path: path.stem)
def test_no_committed_record_names_a_folder_of_somebody_s_machine(path):
    record = read(path)
    words = shlex.split(record.get("command", ""))
    words += [one["path"] for one in record.get("inputs", ())]
    assert not [word for word in words if word.startswith("/") or ".." in Path(word).parts]
