"""README and docs/ are true: commands run, names exist, numbers are those of records and code.

All commands and Python run in one folder, README first, as they stand, over made terrain; a command
that several pages show runs once. A server on this machine stands in for the public server of
elevation tiles.
"""

import io
import json
import re
import shlex
import shutil
import tomllib
from contextlib import chdir, redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import rasterio
import typer
from documents import DOCUMENTS, ROOT, blocks_of, defined_in, links, references, table_under
from PIL import Image
from range_server import Behaviour, serve
from scenes import candidate_at, degree_tile, fractal, take_photo

import skyline
from skyline import Curvature, PhotoSkyline, cli, read_dem, stand_at
from skyline.fetch.dem_tiles import SOURCES
from skyline.store.read import open_store
from skyline_bench import cli as bench
from skyline_bench.documents.results import Results
from skyline_bench.documents.sentences import SENTENCES
from skyline_bench.documents.writing import written

README, *DOCS = DOCUMENTS

SMALLER = {
    "--bounds 9.8,46.7,9.9,46.8": "--spacing 400 --bounds 9.8,46.7,9.9,46.8",
    "--bounds 9.89,46.7,": "--spacing 400 --bounds 9.89,46.7,",
    "--bounds 9.8,46.79,": "--spacing 400 --bounds 9.8,46.79,",
    "bounds_deg=(9.8, 46.7, 9.9, 46.8)": "spacing_m=400.0, bounds_deg=(9.8, 46.7, 9.9, 46.8)",
    "--threshold-px 3 --coverage 0.98": "--threshold-px 9 --coverage 0.5 --site-spacing 200",
}
"""Text of the documents -> the smaller run that stands for it."""

LEFT = {
    "dem-formats.md": ("own.h5", "heights.tif", "same.h5"),
    "photos.md": ("report/index.html", "candidates.geojson", "candidates.kml"),
    "surfaces.md": ("both.csv", "trees.png"),
    "searching.md": ("map.tif", "map.kml"),
    "scripts.md": ("pictures/0000.png", "python.h5"),
}
"""Page -> files that its commands leave."""

PROGRAMS = {"skyline": cli, "skyline-bench": bench}

_PER_DEGREE = 240
_BASIN_LON = 9.86
_BASIN_LAT = 46.76
_BASIN_RADIUS_DEG = 0.1
"""Radius of a basin's floor in the made terrain, in degrees of latitude: 11 km."""
_FOCAL_LENGTH_35MM = 31


def tiles():
    """Make four degrees of terrain, by the path a server has them under.

    Mountains stand round a wide basin, in which the pages build. There skylines are far, so plans
    have few viewpoints and builds take seconds.
    """
    count = _PER_DEGREE
    lat = 48.0 - np.arange(2 * count)[:, np.newaxis] / count
    lon = 9.0 + np.arange(2 * count) / count
    east_deg = (lon - _BASIN_LON) * np.cos(np.radians(_BASIN_LAT))
    radii = np.hypot(lat - _BASIN_LAT, east_deg) / _BASIN_RADIUS_DEG
    relief = fractal(2 * count, 2 * count, 1200.0, seed=5) * np.clip(radii - 1.0, 0.0, 1.0)
    heights = (1500.0 + relief).astype(np.float32)
    for row, lat in enumerate((47, 46)):
        for col, lon in enumerate((9, 10)):
            part = heights[row * count :, col * count :][:count, :count]
            yield f"/N{lat}E{lon:03d}.tif", degree_tile(part, lon, lat)


def matching(word):
    """Return the files that a word of a command stands for, else the word."""
    return sorted(str(path) for path in Path().glob(word)) if "*" in word else [word]


@cache
def run_command(line):
    """Run one line of a document, if it has not run yet; return its output."""
    program, *words = shlex.split(line, comments=True)
    assert program in PROGRAMS, f"{line}: only this repository's commands are run"
    out = io.StringIO()
    target = None
    if ">" in words:
        cut = words.index(">")
        words, target = words[:cut], words[cut + 1]
    arguments = [path for word in words for path in matching(word)]
    err = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr("sys.argv", [program, *arguments])
        with pytest.raises(SystemExit) as stop:
            PROGRAMS[program].main()
    assert not stop.value.code, f"{line}: {err.getvalue()}"
    if target:
        Path(target).write_text(out.getvalue())
    return out.getvalue()


def run_block(block):
    """Run a block of commands or Python."""
    if block.language == "python":
        with redirect_stdout(io.StringIO()):
            exec(compile(block.text, f"{block.document}:{block.line}", "exec"), {})
        return
    for line in block.commands():
        run_command(line)


def page_id(path):
    return str(path.relative_to(ROOT))


def to_run(document):
    blocks = (block for block in blocks_of(document) if block.language in ("sh", "python"))
    return [block for block in blocks if block.not_run is None]


def shown(part):
    """Return the first command of the documents that a part of it identifies."""
    return next(
        line
        for document in DOCUMENTS
        for block in to_run(document)
        for line in block.commands()
        if part in line
    )


@pytest.fixture(scope="module")
def world(refined_quickly, tmp_path_factory):
    """A folder in which the README's blocks have run, and what pages share has been made."""
    folder = tmp_path_factory.mktemp("world")
    with serve(Behaviour(files=dict(tiles()))) as address, pytest.MonkeyPatch.context() as patch:
        patch.setitem(SOURCES, "copernicus", address + "/{ns}{lat:02d}{ew}{lon:03d}.tif")
        with chdir(folder):
            assert "4 tiles, 4 fetched now" in run_command(shown("dem fetch"))
            make_files()
            for block in to_run(README):
                run_block(block)
            for part in ("skyline extract", "--planner lpov"):
                run_command(shown(part))
        yield folder


def make_files():
    """Write the photos, lists and models that the documents name."""
    with rasterio.open("alps/N46E009.tif") as tile:
        np.save("heights.npy", tile.read(1))
    terrain = read_dem(matching("alps/*.tif"))
    eye = stand_at(terrain, lon=9.85, lat=46.75, summit_within_m=0.0)
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = _FOCAL_LENGTH_35MM
    take_photo("photo.jpg", terrain, eye, exif=exif)
    Path("photos").mkdir()
    shutil.copy("photo.jpg", "photos/a.jpg")
    Path("viewpoints.csv").write_text("lon,lat\n9.85,46.75\n")
    Path("peaks.csv").write_text("name,lon,lat\nGrat,9.87,46.72\n")
    Path("points.csv").write_text(control_points(terrain, eye))
    lake = [[400.0, 560.0], [460.0, 560.0], [460.0, 600.0]]
    shapes = [{"label": "lake", "points": lake, "shape_type": "polygon"}]
    size = {"imageWidth": 960, "imageHeight": 640}
    Path("lake.json").write_text(json.dumps({"shapes": shapes, **size}))
    corners = (9.78, 46.69), (9.92, 46.69), (9.92, 46.81), (9.78, 46.81), (9.78, 46.69)
    points = "".join(f'<trkpt lon="{lon}" lat="{lat}"/>' for lon, lat in corners)
    Path("tour.gpx").write_text(f"<gpx><trk><trkseg>{points}</trkseg></trk></gpx>")
    trees = np.where(fractal(_PER_DEGREE, _PER_DEGREE, seed=6) > 0.0, 20.0, 0.0)
    Path("canopy.tif").write_bytes(degree_tile(trees.astype(np.float32), 9, 46))


def control_points(terrain, eye):
    """Return a table of points that the photo shows, heading 140, 60 degrees wide."""
    away_m, turns_deg = (
        (3000.0, 9000.0, 15_000.0, 12_000.0, 5000.0),
        (-24.0, -12.0, 1.0, 13.0, 25.0),
    )
    rows = ["column_px,row_px,lon,lat"]
    for distance_m, turn_deg in zip(away_m, turns_deg, strict=True):
        azimuth = np.radians(140.0 + turn_deg)
        east_m = eye.easting_m + distance_m * np.sin(azimuth)
        north_m = eye.northing_m + distance_m * np.cos(azimuth)
        up_m = terrain.height_at(easting_m=east_m, northing_m=north_m) - eye.eye_elevation_m
        tan = (up_m - Curvature().drop_m(distance_m)) / distance_m
        camera = candidate_at(0.0, 0.0, 140.0).camera(PhotoSkyline(*np.zeros((2, 960)), 960, 640))
        column_px, row_px = camera.pixels(np.degrees(azimuth), tan)
        lon, lat = terrain.frame.to_lonlat(east_m, north_m)
        rows.append(",".join(str(one.item()) for one in (column_px, row_px, lon, lat)))
    return "\n".join(rows) + "\n"


def test_the_files_that_pages_share_are_made(world):
    for name in ("report/index.html", "overlay.png", "trace.csv", "planned.png"):
        assert (world / name).stat().st_size > 0, name
    with open_store(world / "davos.h5") as store:
        assert store.header.holds == "places"
        assert store.places().take(np.array([0])).rise.nbytes == 360
    with open_store(world / "planned.h5") as store:
        assert store.header.config["planner"] == "lpov"


@pytest.mark.slow
@pytest.mark.parametrize("document", DOCS, ids=page_id)
def test_the_commands_of_a_page_run(world, document):
    with chdir(world):
        for block in to_run(document):
            run_block(block)
    for name in LEFT.get(document.name, ()):
        assert (world / name).stat().st_size > 0, name
    if document.name == "scripts.md":
        found = [json.loads(line) for line in (world / "matches.jsonl").read_text().splitlines()]
        assert [each["photo"] for each in found] == ["photos/a.jpg"]


@pytest.mark.parametrize("document", DOCUMENTS, ids=page_id)
def test_every_block_has_a_language_and_a_reason_if_it_is_not_run(document):
    for block in blocks_of(document):
        assert block.language in ("sh", "python", "text", "toml"), f"{block.document}:{block.line}"
        assert block.not_run is None or len(block.not_run) > 10


def parse(line):
    """Hold a command line to its program's options without running it."""
    program, *words = shlex.split(line, comments=True)
    command = typer.main.get_command(PROGRAMS[program].app)
    while hasattr(command, "commands"):
        assert words[0] in command.commands, line
        _, command, words = command.resolve_command(typer.Context(command), words)
    command.make_context(program, words)


def test_commands_that_are_not_run_are_commands():
    lines = [
        line
        for document in DOCUMENTS
        for block in blocks_of(document)
        if block.not_run and block.language == "sh"
        for line in block.commands()
    ]
    ours = [line for line in lines if line.split()[0] in PROGRAMS]
    for line in ours:
        parse(line)
    targets = {line.split()[1] for line in lines if line.startswith("make ")}
    known = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert targets <= set(known)
    assert len(ours) > 5
    assert targets


@pytest.mark.parametrize("document", DOCUMENTS, ids=page_id)
def test_files_and_names_the_documents_point_to_exist(document):
    for path, names in references(document):
        assert (ROOT / path).exists(), path
        for name in names:
            assert name in defined_in(ROOT / path), f"{path}: {name}"
    for target in links(document):
        assert target.exists(), target


def test_modules_that_the_documents_name_by_the_end_of_their_path_exist():
    modules = [f"/{path.relative_to(ROOT)}" for path in ROOT.glob("*/**/*.py")]
    for document in DOCUMENTS:
        for name in re.findall(r"`([\w/]+\.py)`", document.read_text(encoding="utf-8")):
            assert any(path.endswith(f"/{name}") for path in modules), f"{document.name}: {name}"


def test_the_readme_links_every_page_of_the_site():
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    docs, from_root = ROOT / "docs", {"index", "contributing", "changelog"}
    targets = (target for target in links(README) if docs in target.parents)
    linked = {target.relative_to(docs).with_suffix("").as_posix() for target in targets}
    left = set(re.findall(r": (\S+)\.md$", nav, re.MULTILINE)) - linked - from_root
    assert {page for page in left if not page.startswith("api/")} == set()


def test_the_api_pages_show_every_public_name_once():
    pages = [page.read_text(encoding="utf-8") for page in (ROOT / "docs" / "api").glob("*.md")]
    named = re.findall(r"^::: skyline\.(\w+)$", "\n".join(pages), re.MULTILINE)
    assert sorted(named) == sorted(skyline.__all__)


def test_the_version_is_one_everywhere():
    versions = [
        tomllib.loads((ROOT / file).read_text(encoding="utf-8"))["project"]["version"]
        for file in ("pyproject.toml", "bench/pyproject.toml")
    ]
    first = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.M)
    assert {first[1], *versions} == {versions[0]}


@pytest.mark.parametrize("document", DOCUMENTS, ids=page_id)
def test_the_numbers_of_a_page_are_those_of_the_records_and_the_code(document):
    text, page = document.read_text(encoding="utf-8"), document.relative_to(ROOT).as_posix()
    records = Results(ROOT / "bench" / "results")
    assert written(text, page, records, SENTENCES) == text, "run `skyline-bench figures`"


def test_the_readme_says_what_its_plans_were_held_to():
    rows = table_under(README, "terrain")
    assert {"km2", "queries", "n", "adaptive", "uniform", "difference, points"} <= rows[0].keys()
    about = {(row["terrain"].partition("]")[0], row["queries"], row["km2"]) for row in rows}
    assert ("[Owens Valley", "plain", "1,194") in about
    assert ("[Owens Valley", "aligned", "56") in about


def test_every_record_is_linked_from_a_page():
    linked = {target.name for document in DOCUMENTS for target in links(document)}
    records = (ROOT / "bench" / "results").glob("*.json")
    assert {record.name for record in records} <= linked
