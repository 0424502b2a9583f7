"""Draw docs/match.png: python bench/readme_picture.py STORE.h5 DEM [--seed N].

A photo is made from the terrain at a place drawn from the store's area, and matched; the picture
is the report's: the photo with both skylines, and the map of the candidates.
"""

import argparse
import io
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from skyline import Matcher, read_dem, stand_on
from skyline.experiments.photographs import photograph
from skyline.experiments.pinhole import Camera
from skyline.pipeline import matched, report_matches
from skyline.render.depth import DepthRenderer

RESULT = Path(__file__).resolve().parents[1] / "docs" / "match.png"
HEIGHT_PX = 560
COLOURS = 128


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("dem", type=Path)
    parser.add_argument("--seed", type=int, default=7)
    options = parser.parse_args()
    terrain = read_dem([options.dem])
    with tempfile.TemporaryDirectory() as name, Matcher(options.store, terrain) as matcher:
        folder = Path(name)
        random = np.random.default_rng(options.seed)
        places = matcher.viewpoints
        eye = stand_on(
            terrain,
            random.uniform(places.easting_m.min(), places.easting_m.max()),
            random.uniform(places.northing_m.min(), places.northing_m.max()),
        )
        camera = Camera(random.uniform(0.0, 360.0), pitch_deg=2.0, roll_deg=1.0, fov_deg=60.0)
        with DepthRenderer(terrain, 2048) as renderer:
            picture = photograph(renderer, eye, 0, camera, seed=options.seed)
        photo = folder / "photo.jpg"
        Image.fromarray(picture).save(photo, quality=92)
        result = matcher.match(photo, fov_deg=60.0)
        for place in result.candidates[:1]:
            off = np.hypot(place.easting_m - eye.easting_m, place.northing_m - eye.northing_m)
            print(f"{off[0]:.0f} m off, confidence {place.confidence:.2f}")
        report_matches(folder / "report", matcher, [matched(photo, result)], terrain)
        side_by_side(sorted((folder / "report").glob("*.[jp][pn]g"))).save(RESULT, optimize=True)


def side_by_side(paths: list[Path]) -> Image.Image:
    """Return pictures in one row, of one height, in few colours."""
    parts = [Image.open(io.BytesIO(path.read_bytes())).convert("RGB") for path in paths]
    parts = [part.resize((part.width * HEIGHT_PX // part.height, HEIGHT_PX)) for part in parts]
    row = Image.new("RGB", (sum(part.width for part in parts), HEIGHT_PX), "white")
    for index, part in enumerate(parts):
        row.paste(part, (sum(each.width for each in parts[:index]), 0))
    return row.quantize(COLOURS)


if __name__ == "__main__":
    main()
