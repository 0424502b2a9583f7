"""The whole way, on a real DEM: build stores, take pictures, find where they were taken.

The elevation model is the one that matplotlib ships (Jacksboro fault, Tennessee; SRTM). The
pictures are made from it at random places; the matchers see only the JPEG files. The full matcher
searches a store of places, the paper's matcher and plain correlation a store of renderings.
"""

import argparse
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from rich.console import Console
from rich.table import Table

from skyline.match.matcher import FULL, Matcher
from skyline.match.result import MatchResult
from skyline.render.depth import DepthRenderer
from skyline.render.horizon import RenderConfig
from skyline.report.match_page import report_matches
from skyline.report.panorama import save_panorama
from skyline.report.paper_pictures import save_depth_pictures
from skyline.report.skyline_overlay import write_overlay
from skyline.survey.build import build_places, build_uniform
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import stand_at, stand_on
from skyline_bench.geotiff import write_sample_dem
from skyline_bench.queries.made_photos import photograph
from skyline_bench.queries.pinhole import Camera

BOUNDS_DEG = (-84.29, 36.55, -84.20, 36.62)
RENDERINGS_M = 400.0
"""How far apart the eyes of the renderings are."""
QUERIES = 5
SEED = 2014
FOCAL_LENGTH_35MM = 31
FOV_DEG = float(2.0 * np.degrees(np.arctan(18.0 / FOCAL_LENGTH_35MM)))


@dataclass(frozen=True, slots=True)
class Query:
    """A picture, and the truth about it, which the matcher does not get."""

    path: Path
    easting_m: float
    northing_m: float
    heading_deg: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder for all files")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    console = Console()
    started = time.perf_counter()

    terrain = read_dem([write_sample_dem(out / "jacksboro.tif")])
    console.print(f"DEM: {terrain.cols} x {terrain.rows} samples, {terrain.spacing_m:.0f} m apart")

    places, renderings = out / "places.h5", out / "renderings.h5"
    for store in (places, renderings):
        store.unlink(missing_ok=True)
    built = build_places(terrain, places, bounds_deg=BOUNDS_DEG, places=10_000)
    console.print(f"{built.rows} places in {built.seconds:.0f} s -> {places}")
    built = build_uniform(terrain, renderings, RENDERINGS_M, BOUNDS_DEG)
    console.print(f"{built.rows} renderings in {built.seconds:.0f} s -> {renderings}")

    queries = take_pictures(terrain, out / "queries")
    matchers = {
        name: Matcher(places if name == FULL else renderings, matcher=name)
        for name in (FULL, "paper", "correlation")
    }
    results = {name: [m.match(query.path) for query in queries] for name, m in matchers.items()}
    for query, result in zip(queries, results[FULL], strict=True):
        picture = np.asarray(Image.open(query.path))
        write_overlay(picture, result.skyline, query.path.with_suffix(".skyline.png"))

    draw(terrain, queries[0], out)
    page = report_matches(out / "report", matchers[FULL], results[FULL])
    for name, found in results.items():
        console.print(table_of(name, queries, found))
    console.print(f"all in {time.perf_counter() - started:.0f} s; report and pictures:")
    for path in [page, *sorted(out.rglob("*.png"))]:
        console.print(f"  {path}")
    console.print("\nTo find them with the mouse, run this and open the address that it prints:")
    skyline = os.path.relpath(Path(sys.executable).parent / "skyline")
    photos = " ".join(str(query.path) for query in queries)
    console.print(f"  {skyline} serve {places} {photos}", soft_wrap=True)


def take_pictures(terrain: HeightField, folder: Path) -> list[Query]:
    """Photograph the terrain at random places inside the bounds, in random directions."""
    folder.mkdir(exist_ok=True)
    random = np.random.default_rng(SEED)
    west, south, east, north = BOUNDS_DEG
    lon, lat = random.uniform(west, east, QUERIES), random.uniform(south, north, QUERIES)
    eyes = stand_at(terrain, lon=lon, lat=lat)
    headings = random.uniform(0.0, 360.0, QUERIES)
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = FOCAL_LENGTH_35MM
    queries = []
    with DepthRenderer(terrain, 2048) as renderer:
        for index, heading in enumerate(headings):
            camera = Camera(heading, pitch_deg=random.uniform(-2.0, 2.0), fov_deg=FOV_DEG)
            picture = photograph(renderer, eyes, index, camera, seed=SEED + index)
            path = folder / f"query{index + 1}.jpg"
            Image.fromarray(picture).save(path, quality=92, exif=exif)
            place_m = float(eyes.easting_m[index]), float(eyes.northing_m[index])
            queries.append(Query(path, *place_m, heading))
    return queries


def draw(terrain: HeightField, first: Query, out: Path) -> None:
    """Save depth images and the panorama of where the first picture was taken."""
    eye = stand_on(terrain, easting_m=first.easting_m, northing_m=first.northing_m)
    save_depth_pictures(terrain, eye, out / "depth", RenderConfig())
    lon, lat = terrain.frame.to_lonlat(eye.easting_m, eye.northing_m)
    save_panorama(terrain, out / "panorama.png", lon=float(lon[0]), lat=float(lat[0]))


def table_of(matcher: str, queries: list[Query], results: list[MatchResult]) -> Table:
    """Return a table of where each picture was put, and how far off that is."""
    searched = "places" if matcher == FULL else f"renderings {RENDERINGS_M:.0f} m apart"
    table = Table(title=f"{len(queries)} pictures, {searched}, matcher: {matcher}")
    for name in ("query", "put at (E, N)", "off by", "heading", "off by", "sure", "seconds"):
        table.add_column(name, justify="right")
    for query, result in zip(queries, results, strict=True):
        answer = result.answer
        if answer is None:
            table.add_row(query.path.name, result.refusal, "", "", "", "", f"{result.seconds:.1f}")
            continue
        away = np.hypot(answer.easting_m - query.easting_m, answer.northing_m - query.northing_m)
        turn = (answer.grid_heading_deg - query.heading_deg + 180.0) % 360.0 - 180.0
        table.add_row(
            query.path.name,
            f"{answer.easting_m:.0f}, {answer.northing_m:.0f}",
            f"{away:.0f} m",
            f"{answer.heading_deg:.1f}",
            f"{abs(turn):.1f} deg",
            "-" if answer.confidence is None else f"{answer.confidence:.2f}",
            f"{result.seconds:.1f}",
        )
    return table


if __name__ == "__main__":
    main()
