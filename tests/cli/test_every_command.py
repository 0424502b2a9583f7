"""The end of every command after Ctrl-C, and when its output is no longer read."""

import json
import os
import shutil
import signal
import subprocess
import sys
import weakref
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest
from commands import csv_of, full_name, lonlat_of, trace_of

from skyline import Matcher, cli
from skyline.cli.terminal import Terminal
from skyline.fetch.dem_tiles import FetchResult
from skyline.store.read import open_store

IN_DEM, BOX = ("--dem", "{dem}"), ("--bounds", "9,46,10,47")
POSED, PLACED = ("{photo}", "--pose", "{pose}", *IN_DEM), ("--at", "{at}", *IN_DEM)
MIDDLES = ("--pixel", "511.5,383.5") * 2
COMMANDS = {
    "info": (("{dem}",), "info.read_terrain"),
    "explain": (("{dem}", "--at", "{at}"), "tasks.explain.read_terrain"),
    "horizon": (("{dem}", "--at", "{at}"), "tasks.horizon.read_terrain"),
    "sun": (("{dem}", "--at", "{at}", "--date", "2026-06-21"), "tasks.sun.read_terrain"),
    "panorama": (("{dem}", "--at", "{at}", "-o", "{out}.png"), "tasks.panorama.read_terrain"),
    "match": (("{store}", "{trace}", "--matcher", "unrefined"), "tasks.match.match_here"),
    "label": ((*POSED, "--peaks", "{peaks}", "-o", "{out}.png"), "tasks.label.read_terrain"),
    "pixels": ((*POSED, "--step", "40", "-o", "{out}.npz"), "tasks.pixels.read_terrain"),
    "cross": (
        ("{photo}", "{photo}", "--pose", "{pose}", "--pose", "{aside}", *MIDDLES, *IN_DEM),
        "tasks.cross.read_terrain",
    ),
    "when": (
        (*POSED, "--time", "2026-06-21T05:45Z", "--sun", "1,1", "-q"),
        "tasks.when.read_terrain",
    ),
    "draw": ((*POSED, "--vectors", "{drawn}", "-o", "{out}.kml"), "tasks.draw.read_terrain"),
    "ortho": ((*POSED, "-o", "{out}.tif"), "tasks.ortho.read_terrain"),
    "orient": (("{trace}", *PLACED, "-o", "{out}.csv"), "tasks.orient.read_terrain"),
    "locate": (
        ("{photo}", "--near", "{at},1", *IN_DEM, "--report", "{out}"),
        "tasks.locate.prepare_area",
    ),
    "cache": ((), "cache.cached_areas"),
    "extract": (("{photo}", "-o", "{out}.csv"), "tasks.extract.read_photo"),
    "build": (("{dem}", "--spacing", 900, "-o", "{out}.h5"), "tasks.build.read_terrain"),
    "render": (
        ("{dem}", "--spacing", 1500, "--width", 64, "-o", "{out}.h5"),
        "tasks.render.read_terrain",
    ),
    "store check": (("{store}",), "store.check_store"),
    "store repair": (("{store}", "-o", "{out}.h5"), "store.repair_store"),
    "store merge": (("{store}", "-o", "{out}.h5"), "store.merge_stores"),
    "store export": (("{store}", "-o", "{out}.gpkg"), "store.open_store"),
    "dem fetch": ((*BOX, "-o", "{tmp}"), "dem.fetch_dem"),
    "peaks": ((*BOX, "--server", "http://localhost/", "-o", "{out}.geojson"), "peaks.fetch_peaks"),
}
"""Each command's arguments, and a function of the package that it calls."""

_CONTINUES = "what was built is kept, and the same command continues from there"
KEPT = {
    "locate": (
        "cache/areas/dem-1/9.00_46.00_9.50_46.50/tiles/a.tif",
        "what was fetched and built is kept, and the same command continues from there",
    ),
    "build": ("out.h5.parts/0123/places-1-of-2.h5", _CONTINUES),
    "render": ("out.h5.parts/0123/views-1-of-2.h5", _CONTINUES),
    "dem fetch": (
        "N46E009.tif",
        "the tiles that were fetched are kept, and the same command continues with the others",
    ),
}
"""A file that a stopped command leaves, and the words of its error then."""


@pytest.fixture
def unread(monkeypatch):
    """Return a function that makes an output a pipe whose reader has gone."""
    pipes = []

    def close(name="sys.stdout"):
        read, write = os.pipe()
        os.close(read)
        pipes.append(os.fdopen(write, "w"))
        monkeypatch.setattr(name, pipes[-1])

    yield close
    for pipe in pipes:
        with suppress(BrokenPipeError):
            pipe.close()


@pytest.fixture
def trace(tmp_path):
    return trace_of(tmp_path / "trace.csv", 7.0, " fov_deg=60")


@pytest.fixture
def second(trace, tmp_path):
    """The same trace under another name."""
    return shutil.copy(trace, tmp_path / "second.csv")


@pytest.fixture
def peaks(tmp_path):
    return csv_of(tmp_path / "peaks.csv", ["A,602400,5177400"], "name,easting,northing")


@pytest.fixture
def poses(pose, tmp_path):
    """The photo's pose, and one of a camera 400 m to the left that looks across its view."""
    first = json.loads(pose.read_text())
    moved = {"lon": first["lon"] + 0.0039, "lat": first["lat"] + 0.00225}
    path = tmp_path / "aside.json"
    path.write_text(json.dumps(first | moved | {"heading_deg": first["heading_deg"] + 45.0}))
    return {"pose": pose, "aside": path}


@pytest.fixture
def command(store, photo, trace, poses, peaks, tmp_path, dem):
    """Return a function that gives a command's arguments."""
    at = "{:.6f},{:.6f}".format(*lonlat_of(dem))
    drawn = tmp_path / "drawn.svg"
    drawn.write_text('<svg><line x1="400" y1="600" x2="500" y2="620"/></svg>')
    given = {"dem": dem, "at": at, "out": tmp_path / "out", "tmp": tmp_path, "store": store}
    given |= {"photo": photo, "trace": trace, "peaks": peaks, "drawn": drawn, **poses}
    return lambda name: [*name.split(), *(str(one).format(**given) for one in COMMANDS[name][0])]


def test_each_command_is_tried():
    known = set()
    for names in cli.COMMANDS.values():
        for name in names:
            one = cli.loaded(name)
            known |= {f"{name} {sub}" for sub in getattr(one, "commands", ())} or {name}
    # `serve` ends with Ctrl-C alone, and prints when it is ready: tests/web has it.
    assert known == {*COMMANDS, "serve"}


@pytest.mark.parametrize("keeps", [False, True])
@pytest.mark.parametrize("name", COMMANDS)
def test_after_ctrl_c_it_says_what_is_kept(run, command, tmp_path, monkeypatch, name, keeps):
    def interrupted(*_args, **_options):
        if keeps and name in KEPT:
            path = tmp_path / KEPT[name][0]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        raise KeyboardInterrupt

    monkeypatch.setenv("SKYLINE_CACHE", str(tmp_path / "cache"))
    arguments = command(name)
    before = sorted(tmp_path.iterdir())
    monkeypatch.setattr(full_name(COMMANDS[name][1]), interrupted)
    done = run(*arguments)
    assert (done.code, done.out) == (130, "")
    said = f"; {KEPT[name][1]}" if keeps and name in KEPT else ""
    assert done.err == f"error: stopped{said}\n"
    if not keeps:
        assert sorted(tmp_path.iterdir()) == before


def test_quiet_has_errors_and_answers_alone(run, store, trace, tmp_path, monkeypatch):
    match = "match", store, trace, tmp_path / "none.csv", "--matcher", "unrefined"
    loud = run(*match, slow_s=0.0)
    quiet = run(*match, "--quiet", slow_s=0.0, every_s=0.0)
    assert quiet.out.splitlines()[1:] == loud.out.splitlines()[1:]
    assert loud.err.count("\n") > 1
    assert quiet.err.startswith("error: ")
    assert quiet.err.count("\n") == 1


@pytest.mark.parametrize("name", ["match", "orient"])
def test_a_batch_says_in_a_log_how_far_it_is(run, command, second, name):
    done = run(*command(name), second, every_s=0.001).ok()
    assert "ing photos: 1 of 2, about" in done.err


@pytest.mark.parametrize("name", COMMANDS)
def test_a_closed_pipe_is_no_failure(run, command, tmp_path, monkeypatch, unread, name):
    monkeypatch.setattr("skyline.cli.dem.fetch_dem", lambda *_, **__: FetchResult((), 0, ()))
    monkeypatch.setattr("skyline.cli.peaks.fetch_peaks", lambda *_: 0)
    arguments = command(name)
    unread()
    done = run(*arguments)
    assert done.code == 0
    # `locate` says what it keeps and where its report is.
    assert not done.err or (name == "locate" and "error" not in done.err)
    for made in (one for one in arguments if one.startswith(str(tmp_path / "out"))):
        assert Path(made).exists() or name == "peaks"


def test_files_are_written_all_the_same(run, store, trace, second, tmp_path, monkeypatch, unread):
    matched, match = [], Matcher.match
    monkeypatch.setattr(
        Matcher, "match", lambda *asked, **named: matched.append(1) or match(*asked, **named)
    )
    arguments = "match", store, trace, second, "--matcher", "unrefined"
    unread()
    assert run(*arguments).code == 0
    assert len(matched) == 1, "the second answer has no reader"
    files = [tmp_path / name for name in ("r.csv", "x.geojson", "page")]
    unread()
    options = "--results", files[0], "--export", files[1], "--report", files[2]
    assert run(*arguments, *options).code == 0
    assert len(matched) == 3
    assert all(file.exists() for file in files)
    assert files[0].read_text().count("\n") == 3


def test_in_a_shell(dem, tmp_path):
    """Python prints nothing at its end, and no file gets the number of a closed stream."""
    skyline = f"{sys.executable} -m skyline"

    def end_of(line):
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)
        return done.returncode, done.stdout, done.stderr

    assert end_of(f"{skyline} info {dem} | true; exit ${{PIPESTATUS[0]}}") == (0, "", "")
    build = f"{skyline} build {dem} --spacing 1500 -o {tmp_path / 's.h5'}"
    assert end_of(f"{build} <&- >&- 2>&-") == (0, "", "")
    with open_store(tmp_path / "s.h5") as store:
        assert len(store)
    said = "error: the system reports: [Errno 28] No space left on device\n"
    assert end_of(f"{skyline} --version >/dev/full") == (1, "", said)


def test_a_match_that_is_stopped_keeps_what_it_has_written(
    run, store, trace, second, tmp_path, monkeypatch
):
    match = partial(run, "match", store, trace, second, "--matcher", "unrefined", "--results")
    matched, results = Matcher.match, []

    def stopping(*arguments, **named):
        if results:
            raise KeyboardInterrupt
        results.append(matched(*arguments, **named))
        return results[0]

    with monkeypatch.context() as patch:
        patch.setattr(Matcher, "match", stopping)
        done = match(tmp_path / "r.csv")
    assert done.code == 130
    said = f"error: stopped; {tmp_path / 'r.csv'} has the answers so far, and the same command"
    assert done.err.startswith(said)
    assert "trace.csv" in done.out
    again = match(tmp_path / "r.csv")
    assert again.code == 0
    assert "trace.csv" not in again.out


@pytest.fixture
def listening():
    """Listen to Ctrl-C, which a shell lets the jobs in its background ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("listening")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interrupt_that_python_drops_ends_the_next_step_of_progress():
    """Python drops one that arrives while it clears away a dead weak reference."""

    class Thing:
        pass

    terminal = Terminal()
    thing = Thing()
    _ = weakref.ref(thing, lambda _: signal.raise_signal(signal.SIGINT))
    with terminal.interruptible(), terminal.progress("building") as step:
        step(1, 3)
        del thing
        with pytest.raises(KeyboardInterrupt):
            step(2, 3)
