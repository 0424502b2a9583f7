"""Figures small enough for a repository."""

import io

from matplotlib.figure import Figure
from PIL import Image

from skyline.report.pictures import DPI, encode_figure

SMALL_BYTES = 150_000
"""What a picture in a repository may take."""
_PALETTES = (256, 128)
_SHRINK = 0.85


def encode_small_png(figure: Figure, dpi: float = DPI) -> bytes:
    """Return a figure as a PNG of at most `SMALL_BYTES`: of as many colours as that takes.

    Where a hundred are still too many the picture gets smaller.
    """
    while True:
        with Image.open(io.BytesIO(encode_figure(figure, "png", dpi))) as drawn:
            whole = drawn.convert("RGB")
        for colours in _PALETTES:
            picture = io.BytesIO()
            # Spread over all colours there are, so that thin lines and marks keep theirs.
            quantized = whole.quantize(colours, Image.Quantize.MAXCOVERAGE)
            quantized.save(picture, "png", optimize=True)
            if picture.tell() <= SMALL_BYTES:
                return picture.getvalue()
        dpi *= _SHRINK
