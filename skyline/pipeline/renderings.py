"""Rendering viewpoints into memory, and onto pictures."""

from pathlib import Path

import cv2

from skyline import report
from skyline.camera import HEADINGS
from skyline.files import write_whole
from skyline.render.depth import DepthRenderer
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views


def render_views(
    terrain: HeightField, viewpoints: Viewpoints, config: RenderConfig | None = None
) -> Views:
    """Render the skylines of viewpoints to grid north, east, south, west (4 N views)."""
    config = config or RenderConfig()
    with HorizonRenderer.of(terrain, config) as renderer:
        return renderer.render(viewpoints)


def save_depth_pictures(
    terrain: HeightField, viewpoints: Viewpoints, folder: Path, config: RenderConfig
) -> None:
    """Save depth images (TIFF, float32 metres, inf = sky) and a picture of each viewpoint.

    The files are ``NNNN_heading_H.tif`` and ``NNNN.png``, numbered in the viewpoints' order.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with DepthRenderer(terrain, config.width, config.curvature) as renderer:
        for index in range(len(viewpoints)):
            images = renderer.depth_images(viewpoints, index)
            for heading in HEADINGS:
                picture = cv2.imencode(".tif", images[heading])[1].tobytes()
                write_whole(folder / f"{index:04d}_heading_{heading}.tif", picture)
            views = renderer.render(viewpoints[index : index + 1])
            report.save_depth_images(images, views, folder / f"{index:04d}.png")
