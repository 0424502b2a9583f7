"""Pictures of what was rendered: depth images with their skyline."""

import io
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from skyline.arrays import Float32Array
from skyline.camera import HEADINGS
from skyline.files import write_whole, write_with_folders
from skyline.render.depth import DepthRenderer
from skyline.render.horizon import RenderConfig
from skyline.skylines import Views
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

HEADING_NAMES = ("grid north", "grid east", "grid south", "grid west")
DPI = 110
_OPTIONS: dict[str, dict[str, Any]] = {
    "png": {"pil_kwargs": {"compress_level": 4}},
    "jpeg": {"pil_kwargs": {"quality": 88, "subsampling": 0}},
}
"""A tenth more bytes in half the time; full colour resolution, or thin coloured lines fade."""


def save_depth_images(images: Float32Array, views: Views, path: Path) -> None:
    """Save the four depth images of one viewpoint side by side, their skylines drawn.

    Parameters
    ----------
    images : (4, W, W) float32, metres, top row first, inf = sky
    views : Views
        The four views of that viewpoint, in order of heading.
    path : Path
        A PNG.
    """
    size = images.shape[-1]
    finite = images[np.isfinite(images)]
    low, high = np.log10(np.percentile(finite, [1, 99])) if finite.size else (0.0, 1.0)
    figure = Figure(figsize=(16, 4.6), layout="constrained")
    axes = figure.subplots(1, len(HEADINGS))
    for heading, axis in enumerate(axes):
        depth = np.where(np.isfinite(images[heading]), images[heading], np.nan)
        shown = axis.imshow(
            np.log10(depth), cmap="viridis_r", vmin=low, vmax=high, interpolation="nearest"
        )
        axis.set_facecolor("#dfe9f5")
        rows = (1.0 - views.elevation_tan[heading]) * size / 2.0 - 0.5
        axis.plot(np.arange(size), rows, color="crimson", linewidth=1.0)
        axis.set(xlim=(-0.5, size - 0.5), ylim=(size - 0.5, -0.5), xticks=[], yticks=[])
        axis.set_title(f"heading {heading}: {HEADING_NAMES[heading]}")
    bar = figure.colorbar(shown, ax=axes, shrink=0.9, pad=0.01)
    ticks = np.array([10, 30, 100, 300, 1e3, 3e3, 1e4, 3e4, 1e5])
    ticks = ticks[(np.log10(ticks) >= low) & (np.log10(ticks) <= high)]
    bar.set_ticks(np.log10(ticks), labels=[f"{tick:g} m" for tick in ticks])
    bar.set_label("forward depth")
    save_figure(figure, path)


def save_figure(figure: Figure, path: Path) -> None:
    """Save a figure as PNG, with the folders it needs; raises `InputError` where it cannot."""
    write_with_folders(path, encode_figure(figure))


def encode_figure(figure: Figure, kind: str = "png", dpi: float = DPI) -> bytes:
    """Return a figure's picture as ``png``, ``jpeg``, ``svg`` or ``pdf``."""
    FigureCanvasAgg(figure)
    picture = io.BytesIO()
    figure.savefig(picture, format=kind, dpi=dpi, **_OPTIONS.get(kind, {}))
    return picture.getvalue()


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
            save_depth_images(images, views, folder / f"{index:04d}.png")
