"""Draw docs/match.jpg: python bench/readme_picture.py STORE.h5 DAVOS_DEM.

A photo is made from the terrain beside the store's viewpoints, and matched; the picture is the
report's: the photo with both skylines, and the map of the candidates.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from skyline import Matcher, read_dem, stand_on
from skyline.pipeline import matched, report_matches
from skyline.render.depth import DepthRenderer
from skyline_bench.queries.photographs import photograph
from skyline_bench.queries.pinhole import Camera

RESULT = Path(__file__).resolve().parents[1] / "docs" / "match.jpg"
LON_DEG, LAT_DEG = 9.90673, 46.82570
CAMERA = Camera(160.0, pitch_deg=9.0, roll_deg=1.0, fov_deg=60.0)
HEIGHT_PX = 560


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("store", type=Path)
    parser.add_argument("dem", type=Path)
    options = parser.parse_args()
    terrain = read_dem([options.dem])
    eye = stand_on(terrain, *terrain.frame.from_lonlat(LON_DEG, LAT_DEG))
    with tempfile.TemporaryDirectory() as name, Matcher(options.store, terrain) as matcher:
        photo, report = Path(name) / "photo.jpg", Path(name) / "report"
        with DepthRenderer(terrain, 2048) as renderer:
            Image.fromarray(photograph(renderer, eye, 0, CAMERA, seed=1)).save(photo, quality=92)
        result = matcher.match(photo, fov_deg=CAMERA.fov_deg)
        best = result.candidates[0]
        off_m = np.hypot(best.easting_m - eye.easting_m[0], best.northing_m - eye.northing_m[0])
        print(f"{off_m:.0f} m off, confidence {best.confidence:.2f}, {result.seconds:.1f} s")
        report_matches(report, matcher, [matched(photo, result)], terrain)
        pictures = [Image.open(path) for path in (report / "01-overlay.jpg", report / "01-map.png")]
        side_by_side(pictures).save(RESULT, quality=85, optimize=True)


def side_by_side(pictures: list[Image.Image]) -> Image.Image:
    """Return pictures in one row, all as high."""
    parts = [
        picture.convert("RGB").resize((picture.width * HEIGHT_PX // picture.height, HEIGHT_PX))
        for picture in pictures
    ]
    return Image.fromarray(np.concatenate([np.asarray(part) for part in parts], axis=1))


if __name__ == "__main__":
    main()
