"""Labels of peaks, placed without overlaps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic

from matplotlib.figure import Figure
from matplotlib.text import Text

from skyline.errors import some_of
from skyline.fonts import fonts_for, packages_with, undrawn_letters
from skyline.view.sightings import S, Sighting


@dataclass(frozen=True, slots=True)
class PlacedLabel:
    """A label above a picture, in the unit of the lengths given."""

    index: int
    """Index of the label in the order given."""
    anchor: float
    """Where the label's leader line descends."""
    left: float
    """Left end of the label and its gap."""
    right: float
    """Right end of the label and its gap."""
    row: int
    """0 is the lowest row, next to the picture."""

    def disturbs(self, other: "PlacedLabel") -> bool:
        """Return whether two labels, or one and the other's leader, overlap."""
        if self.row == other.row:
            return self.left < other.right and other.left < self.right
        low, high = (self, other) if self.row < other.row else (other, self)
        return low.left <= high.anchor <= low.right


@dataclass(frozen=True, slots=True)
class Label(Generic[S]):
    """The label of a peak, and the fonts that draw it."""

    peak: S
    text: str
    families: tuple[str, ...]
    """Names of the fonts, the first choice first."""

    def extent_px(self, figure: Figure, size_pt: float) -> tuple[float, float]:
        """Return the width and height in pixels of the label, drawn horizontally."""
        box = Text(0, 0, self.text, figure=figure, fontsize=size_pt, **self.style)
        extent = box.get_window_extent()
        return float(extent.width), float(extent.height)

    @property
    def style(self) -> dict[str, Any]:
        """Options with which a Matplotlib text draws the label."""
        return {"fontfamily": self.families, "parse_math": False}


def with_distance(peak: Sighting) -> str:
    """Return a peak's label, and its distance from the eye."""
    return f"{peak.label}  {peak.distance_m / 1000.0:.1f} km"


def labels_of(peaks: Sequence[S], texts: Sequence[str]) -> tuple[list[Label[S]], tuple[str, ...]]:
    """Return the labels that installed fonts draw, and the other peaks' names."""
    labels = [Label(*one) for one in zip(peaks, texts, fonts_for(texts), strict=True)]
    no_font = tuple(one.peak.name for one in labels if not one.families)
    return [one for one in labels if one.families], no_font


def place_labels(
    anchors: Sequence[float],
    widths: Sequence[float],
    picture_width: float,
    rows: int,
    gap: float,
) -> list[PlacedLabel]:
    """Place labels, in the order given, over their leader lines.

    Lengths have one unit, such as pixels or inches. A label is centred on its line, and lies in the
    lowest row with room for it, within the picture's width and with a gap on either side. Where
    leader lines are too near for that, the label begins or ends at its own line in the lowest row,
    and all others move up a row. A label that fits in none of the rows is left out.
    """
    placed: list[PlacedLabel] = []
    for index, (anchor, width) in enumerate(zip(anchors, widths, strict=True)):
        half = width / 2.0 + gap
        wanted = (anchor, anchor + half - gap, anchor - half + gap)
        middles = (min(max(at, half), max(picture_width - half, half)) for at in wanted)
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


@dataclass(frozen=True, slots=True)
class UnnamedPeaks:
    """The peaks in a picture that are left unnamed.

    Attributes
    ----------
    no_room : tuple of str
        Names that would overlap others.
    no_font : tuple of str
        Names that no installed font draws.
    """

    no_room: tuple[str, ...] = ()
    no_font: tuple[str, ...] = ()

    @property
    def counted(self) -> str:
        """The number of missing names, to end a sentence, or ""."""
        words = ""
        if self.no_room:
            have = "peak has" if len(self.no_room) == 1 else "peaks have"
            words += f"; {len(self.no_room)} {have} no room for a name"
        if self.no_font:
            names = "name" if len(self.no_font) == 1 else "names"
            words += f"; no installed font draws {len(self.no_font)} {names}"
        return words

    @property
    def named(self) -> str:
        """As `counted`, with undrawn names and font packages for them."""
        if not self.no_font:
            return self.counted
        packages = packages_with(undrawn_letters(self.no_font))
        advice = f"; install {', '.join(packages)} (Debian) or other fonts" if packages else ""
        return f"{self.counted}: {some_of(self.no_font)}{advice}"
