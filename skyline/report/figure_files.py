"""Matplotlib figures as files."""

import io
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from skyline.files.disk import has_mark

_MARK = "Software", "Skyline"
"""Name and content of a text in all PNG files that are written here."""
_OPTIONS: dict[str, dict[str, Any]] = {
    "png": {"pil_kwargs": {"compress_level": 4}, "metadata": dict([_MARK])},
    "jpeg": {"pil_kwargs": {"quality": 88, "subsampling": 0}},
}
"""JPEG options: without optimization a file has a tenth more bytes, but takes half the time; with
reduced colour resolution, thin coloured lines would fade."""


def encode_figure(figure: Figure, kind: str = "png") -> bytes:
    """Return a figure at its resolution as ``png``, ``jpeg``, ``svg`` or ``pdf``."""
    picture = io.BytesIO()
    figure.savefig(picture, format=kind, dpi="figure", **_OPTIONS.get(kind, {}))
    return picture.getvalue()


def is_figure(path: Path) -> bool:
    """Return whether a file is a PNG made by `encode_figure`."""
    return has_mark(path, b"\0".join(text.encode() for text in _MARK))
