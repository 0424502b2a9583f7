"""Matplotlib figures as files, and the placing of labels without overlaps."""

import io
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from matplotlib.figure import Figure
from matplotlib.text import Text

_OPTIONS: dict[str, dict[str, Any]] = {
    "png": {"pil_kwargs": {"compress_level": 4}},
    "jpeg": {"pil_kwargs": {"quality": 88, "subsampling": 0}},
}
"""Options of JPEG: without optimization a file has a tenth more bytes, but takes half the time; at
reduced colour resolution thin coloured lines fade."""


@contextmanager
def _boxes_for_letters() -> Iterator[None]:
    """Draw letters that the font lacks as boxes, without Matplotlib's warning."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"Glyph .* missing from")
        yield


@_boxes_for_letters()
def encode_figure(figure: Figure, kind: str = "png") -> bytes:
    """Return a figure, at its own resolution, encoded as ``png``, ``jpeg``, ``svg`` or ``pdf``."""
    picture = io.BytesIO()
    figure.savefig(picture, format=kind, dpi="figure", **_OPTIONS.get(kind, {}))
    return picture.getvalue()


@dataclass(frozen=True, slots=True)
class PlacedLabel:
    """A label in a band of rows above a picture; its leader line descends at ``anchor_px``."""

    index: int
    """Index of the label in the order given."""
    anchor_px: float
    left_px: float
    right_px: float
    row: int
    """0 is the lowest row, next to the picture."""

    def disturbs(self, other: "PlacedLabel") -> bool:
        """Return whether two labels overlap, or the leader of one runs through the other."""
        if self.row == other.row:
            return self.left_px < other.right_px and other.left_px < self.right_px
        low, high = (self, other) if self.row < other.row else (other, self)
        return low.left_px <= high.anchor_px <= low.right_px


@_boxes_for_letters()
def extent_px(figure: Figure, text: str, size_pt: float) -> tuple[float, float]:
    """Return the width and height in pixels of a text that a figure draws horizontally."""
    drawn = Text(0, 0, text, fontsize=size_pt, parse_math=False, figure=figure)
    box = drawn.get_window_extent()
    return float(box.width), float(box.height)


def place_labels(
    anchors_px: Sequence[float],
    widths_px: Sequence[float],
    picture_px: float,
    rows: int,
    gap_px: float = 8.0,
) -> list[PlacedLabel]:
    """Place labels centred on the columns of their leader lines, in the order given.

    A label lies in the lowest row with room for it, within the picture's width and with a gap on
    either side. Where leader lines are too near for that, the label begins or ends at its own line
    in the lowest row, and all others move up a row. A label that fits in none of the rows is left
    out.
    """
    placed: list[PlacedLabel] = []
    for index, (anchor, width) in enumerate(zip(anchors_px, widths_px, strict=True)):
        half = width / 2.0 + gap_px
        wanted = (anchor, anchor + half - gap_px, anchor - half + gap_px)
        middles = (min(max(at, half), max(picture_px - half, half)) for at in wanted)
        lowest = [PlacedLabel(index, anchor, at - half, at + half, 0) for at in middles]
        raised = [replace(old, row=old.row + 1) for old in placed]
        tries = [(replace(lowest[0], row=row), placed) for row in range(rows)]
        if all(old.row < rows for old in raised):
            tries += [(new, raised) for new in lowest]
        for new, others in tries:
            if not any(new.disturbs(old) for old in others):
                placed = [*others, new]
                break
    return placed


def unnamed_in_words(count: int) -> str:
    """Return how many peaks have no room for their names, to end a sentence; empty for none."""
    if count == 0:
        return ""
    return f"; {count} {'peak has' if count == 1 else 'peaks have'} no room for a name"
