"""Where labels stand so that none hides another or another's leader line."""

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure
from matplotlib.text import Text


@dataclass(frozen=True, slots=True)
class Placed:
    """A label in a band of rows above a picture; its leader line falls from it at ``anchor_px``."""

    index: int
    """Which label."""
    anchor_px: float
    left_px: float
    right_px: float
    row: int
    """0 is the lowest, next to the picture."""

    def disturbs(self, other: "Placed") -> bool:
        """Whether two labels overlap, or the leader of one runs through the other."""
        if self.row == other.row:
            return self.left_px < other.right_px and other.left_px < self.right_px
        low, high = (self, other) if self.row < other.row else (other, self)
        return low.left_px <= high.anchor_px <= low.right_px


def extent_px(figure: Figure, text: str, size_pt: float) -> tuple[float, float]:
    """Return the width and the height of a text, as a figure draws it lying, px."""
    drawn = Text(0, 0, text, fontsize=size_pt, parse_math=False, figure=figure)
    box = drawn.get_window_extent()
    return float(box.width), float(box.height)


def place_labels(
    anchors_px: Sequence[float],
    widths_px: Sequence[float],
    picture_px: float,
    rows: int,
    gap_px: float = 8.0,
) -> list[Placed]:
    """Place labels centred on their anchors, within the picture, the lowest row first.

    Labels are placed in the order given; one that fits in none of the rows is left out.

    Parameters
    ----------
    anchors_px, widths_px : sequence of float
        Where each leader meets its target, and how wide each text is.
    picture_px : float
        Width of the picture.
    rows : int
        How many rows there are.
    gap_px : float
        Kept free to either side of a text.
    """
    placed: list[Placed] = []
    for index, (anchor, width) in enumerate(zip(anchors_px, widths_px, strict=True)):
        half = width / 2.0 + gap_px
        middle = min(max(anchor, half), max(picture_px - half, half))
        tries = (Placed(index, anchor, middle - half, middle + half, row) for row in range(rows))
        free = (new for new in tries if not any(new.disturbs(old) for old in placed))
        if (first := next(free, None)) is not None:
            placed.append(first)
    return placed


def unnamed_in_words(count: int, before: str = "") -> str:
    """Return how many peaks have no room for their names; nothing where all have."""
    if count == 0:
        return ""
    return f"{before}{count} {'peak has' if count == 1 else 'peaks have'} no room for a name"
