"""Outputs whose names promise another format, and folders with files of other origin."""

import pytest
from commands import assert_refused, csv_of, full_name, lonlat_of
from PIL import Image

from skyline.store.read import is_store

PLACED = "--at {at} --dem {dem}"
POSED = "{photo} --pose {pose} --dem {dem}"
FETCH = "--bounds 9,46,10,47"
WRONG = {
    "build {dem} --spacing 900 -o new.tif": "tasks.build.read_terrain",
    "render {dem} --spacing 1500 -o new.png": "tasks.render.read_terrain",
    "render {dem} --planner lpov -o new.json": "tasks.render.read_terrain",
    "render {dem} --planner lpov -o ok.h5 --map new.pdf": "tasks.render.read_terrain",
    "render {dem} --spacing 1500 -o ok.h5 --depth-images new.tif": "tasks.render.read_terrain",
    "store merge {store} -o new.gpkg": "store._copied_in_words",
    "store repair {store} -o new.csv": "store._copied_in_words",
    "store export {store} -o new.geojson": "store.Terminal.line",
    "extract {photo} -o new.png": "tasks.extract.read_photo",
    "extract {photo} -o ok.csv --overlay new.jpg": "tasks.extract.read_photo",
    f"orient {{photo}} {PLACED} -o new.json": "tasks.orient.read_terrain",
    f"label {POSED} --peaks {{peaks}} -o new.gif": "tasks.label.read_terrain",
    f"pixels {POSED} -o new.csv": "tasks.pixels.read_terrain",
    f"draw {POSED} --vectors {{photo}} -o new.csv": "tasks.draw.read_vectors",
    f"ortho {POSED} -o new.jpg": "tasks.ortho.read_terrain",
    f"orient {{photo}} {PLACED} --points {{peaks}} --residuals new.json": (
        "tasks.points.read_terrain"
    ),
    "match {store} {photo} --export new.csv": "tasks.match.Matcher",
    "match {store} {photo} --results new.json": "tasks.match.Matcher",
    "match {store} {photo} --report new.html": "tasks.match.Matcher",
    "locate {photo} --near {at},1 --dem {dem} --report new.pdf": "tasks.locate.prepare_area",
    "locate {photo} --near {at},1 --dem {dem} --export new.csv": "tasks.locate.prepare_area",
    "panorama {dem} --at {at} -o new.jpg": "tasks.panorama.read_terrain",
    "horizon {dem} --at {at} -o new.png": "tasks.horizon.read_terrain",
    f"peaks {FETCH} --server http://localhost:9/ -o new.csv": "peaks.Terminal.written",
    f"dem fetch {FETCH} -o new.tif": "dem.Terminal.line",
}
"""Commands whose output has the name of another format, and a function that does their work."""


@pytest.fixture
def words(dem, store, photo, pose, tmp_path, monkeypatch):
    """Return a function that gives the words of a command, run in an empty folder."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    peaks = csv_of(tmp_path / "peaks.csv", ["A,602400,5177400"], "name,easting,northing")
    at = "{:.6f},{:.6f}".format(*lonlat_of(dem))
    given = {"dem": dem, "store": store, "photo": photo, "pose": pose, "peaks": peaks, "at": at}
    return lambda command: [word.format(**given) for word in command.split()]


@pytest.mark.parametrize("command", WRONG)
def test_a_name_that_promises_another_format_is_refused_before_any_work(
    run, words, tmp_path, monkeypatch, command
):
    def work(*_arguments, **_options):
        raise AssertionError("work is done for an output that will be refused")

    monkeypatch.setattr(full_name(WRONG[command]), work)
    asked = words(command)
    done = run(*asked)
    name = next(word for word in asked if word.startswith("new."))
    assert_refused(done, name)
    assert not list((tmp_path / "here").iterdir())


def test_names_without_a_suffix_promise_nothing(run, words, tmp_path):
    run(*words("build {dem} --spacing 900 -o places")).ok()
    assert is_store(tmp_path / "here" / "places")
    assert run(*words("extract {photo} -o -")).ok().out.startswith("# width=")
    run(*words("extract {photo} -o /dev/null")).ok()


REPORT = "match {store} {photo} --fov-deg 60 --matcher unrefined --report page"


@pytest.mark.parametrize("name", ["index.html", "01-map.png", "02-detail.png", "matches.geojson"])
@pytest.mark.parametrize(
    "command", [REPORT, "locate {photo} --near {at},1 --dem {dem} --report page"]
)
def test_a_report_replaces_no_file_of_other_origin(
    run, words, tmp_path, monkeypatch, command, name
):
    monkeypatch.setattr("skyline.tasks.match.Matcher", None)
    monkeypatch.setattr("skyline.tasks.locate.prepare_area", None)
    page = tmp_path / "here" / "page"
    page.mkdir()
    (page / name).write_text("mine")
    (page / "photo.jpg").write_text("mine")
    assert_refused(run(*words(command)))
    assert (page / name).read_text() == "mine"
    assert len(list(page.iterdir())) == 2


def test_a_report_replaces_an_earlier_one_and_leaves_other_files(run, words, tmp_path):
    page = tmp_path / "here" / "page"
    page.mkdir()
    (page / "notes.txt").write_text("mine")
    for fov_deg in ("60", "61"):
        run(*words(REPORT.replace("60", fov_deg))).ok()
        written = {path.name for path in page.iterdir()}
        assert written >= {"index.html", "01-overlay.jpg", "matches.geojson", "notes.txt"}
        pages = (page / "index.html").read_text()
    assert 'content="Skyline"' in pages
    assert (page / "notes.txt").read_text() == "mine"


def test_depth_images_replace_earlier_ones_alone(run, words, tmp_path):
    folder = tmp_path / "here" / "frames"
    folder.mkdir()
    render = "render {dem} --spacing 3000 --width 32 -o views.h5 --depth-images frames"
    Image.new("RGB", (9, 9)).save(folder / "0000.png")
    mine = (folder / "0000.png").read_bytes()
    assert_refused(run(*words(render)))
    assert (folder / "0000.png").read_bytes() == mine
    assert [path.name for path in (tmp_path / "here").iterdir()] == ["frames"]
    (folder / "0000.png").unlink()
    for _ in range(2):
        run(*words(render)).ok()
    assert {"0000.png", "0000_heading_3.tif"} <= {path.name for path in folder.iterdir()}
