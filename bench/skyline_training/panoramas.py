"""Panoramas as phones make them, for `skyline-bench photos`.

They show a real elevation model: two thirds of a turn, 8240 x 1941 px, with haze, clouds behind the
ridges, a horizon that sags and the seams of stitching. Nothing is trained on them.
"""

import csv
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from skyline.camera.projection import Projection
from skyline.errors import InputError
from skyline.photo.skyline import PhotoSkyline
from skyline.photo.trace import write_trace
from skyline.progress import Progress
from skyline.render.depth import DepthRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline_bench.queries.made_photos import distance_along, drawn_scenery, scene_rgb
from skyline_bench.queries.manifest import LOCATE
from skyline_training.landscapes import GROUND, SKY, Drawing, TrainingPhoto
from skyline_training.photos import developed, stitch

FOV_DEG = 239.0
_DRAWN_PX, _TIMES = (2060, 485), 4
"""Size at which panoramas are drawn, and the factor by which they are enlarged."""
_RENDERED_PX = 2048
_WITHIN_M = 4_500.0
"""Greatest distance of eyes from the area's middle, since all are searched in one area."""
_TRIES = 400
_FAR_M = 2_000.0
"""Least median distance of the skyline: nobody sweeps a phone along a bank."""
_XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
    'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
    'xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" GPano:ProjectionType="cylindrical" '
    'GPano:CroppedAreaImageWidthPixels="{}" GPano:FullPanoWidthPixels="{}"/></rdf:RDF></x:xmpmeta>'
)


def draw_panorama(
    renderer: DepthRenderer, viewpoint: Viewpoints, heading_deg: float, rng: np.random.Generator
) -> TrainingPhoto | None:
    """Draw the view from one eye about a grid azimuth.

    Returns None if the skyline is near.
    """
    width, height = _DRAWN_PX
    focal_px = width / np.radians(FOV_DEG)
    azimuth = np.radians(heading_deg) + (np.arange(width) + 0.5 - width / 2.0) / focal_px
    up = (rng.uniform(0.35, 0.55) * height - np.arange(height) - 0.5) / focal_px
    across, above = np.meshgrid(azimuth, up)
    rays = np.stack([np.sin(across), above, np.cos(across)], axis=-1)
    distance = distance_along(renderer.depth_images(viewpoint, 0), rays)
    is_ground = np.isfinite(distance)
    row = is_ground.argmax(axis=0)
    if np.median(distance[row, np.arange(width)]) < _FAR_M:
        return None
    low, high = renderer.field.height_range_m
    tree_line_m = low, 0.5 * (low + high)
    scenery = drawn_scenery(rng, (20e3, 200e3), (low, high), tree_line_m, (0.1, 1.0))
    eye_m = float(viewpoint.easting_m[0]), float(viewpoint.northing_m[0])
    picture = scene_rgb(renderer, eye_m, rays, distance, is_ground.astype(float), scenery, rng)
    label = np.where(is_ground, GROUND, SKY).astype(np.uint8)
    seen = np.where((row > 1) & (row < height - 1), row, np.nan)
    haze = picture[0].mean(axis=0).astype(np.float32)
    drawing = Drawing(rng, picture.astype(np.float32), label, seen.astype(np.float32), haze)
    stitch(drawing)
    return TrainingPhoto(developed(rng, drawing.picture), drawing.label, drawing.row)


def write_panoramas(
    terrain: HeightField, folder: Path, count: int, seed: int, progress: Progress
) -> None:
    """Write panoramas, their skylines as traces and ``manifest.csv`` into a folder.

    Raises `InputError` if too few places about the model's middle see far.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    west, south, east, north = terrain.bounds_m
    middle = np.array([west + east, south + north]) / 2.0
    found = list[dict[str, object]]()
    with DepthRenderer(terrain, _RENDERED_PX) as renderer:
        for _ in range(_TRIES):
            place = middle + rng.uniform(-0.7, 0.7, 2) * _WITHIN_M
            eye = stand_on(terrain, easting_m=place[0], northing_m=place[1], summit_within_m=200.0)
            heading_deg = float(rng.uniform(0.0, 360.0))
            photo = draw_panorama(renderer, eye, heading_deg, rng)
            if photo is None:
                continue
            name = f"panorama{len(found) + 1:02d}"
            _write(photo, folder / name)
            at = {"easting_m": eye.easting_m, "northing_m": eye.northing_m}
            lon, lat = terrain.frame.to_lonlat(**at)
            true_deg = heading_deg + terrain.frame.convergence_deg(**at)
            found.append(
                {
                    "photo": f"{name}.jpg",
                    "kind": LOCATE,
                    "lon": float(lon[0]),
                    "lat": float(lat[0]),
                    "heading_deg": float(true_deg[0]) % 360.0,
                    "trace": f"{name}.csv",
                }
            )
            progress(len(found), count)
            if len(found) == count:
                break
    if len(found) < count:
        raise InputError(f"{len(found)} of {_TRIES} places see far; expected {count}: another DEM")
    with (folder / "manifest.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(found[0]))
        writer.writeheader()
        writer.writerows(found)


def _write(photo: TrainingPhoto, stem: Path) -> None:
    """Write a drawn panorama and its trace.

    The panorama is enlarged, and written as a JPEG that notes its turn.
    """
    width, height = (_TIMES * side for side in _DRAWN_PX)
    large = cv2.resize(photo.image, (width, height), interpolation=cv2.INTER_CUBIC)
    full_px = round(width * 360.0 / FOV_DEG)
    xmp = _XMP.format(width, full_px).encode()
    Image.fromarray(large).save(stem.with_suffix(".jpg"), quality=88, xmp=xmp)
    row_px = np.repeat(_TIMES * photo.row_px.astype(np.float64) - 0.5, _TIMES)
    known = np.isfinite(row_px).astype(float)
    query = PhotoSkyline(row_px, known, width, height, FOV_DEG, Projection.CYLINDRICAL)
    write_trace(query, stem.with_suffix(".csv"))
