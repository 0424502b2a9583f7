"""One photo on the page: its file, the skyline under its strokes, and what was found for it."""

import hashlib
import io
import secrets
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from skyline import (
    Correction,
    InputError,
    MatchResult,
    Photo,
    QuerySkyline,
    SkylineError,
    Stroke,
    read_photo,
)

MAX_PIXELS = 120_000_000
"""A browser shows no larger picture."""
_SHOWN_PX = 6000
"""Longest side of the picture that the page draws."""
_KEPT = 4
"""Photos whose pixels and evidence stay in memory."""


class PagePhoto:
    """A photo that somebody has put onto the page.

    Parameters
    ----------
    path : Path
        Its file, which is not changed.
    name : str
        What the person calls it.
    """

    def __init__(self, path: Path, name: str) -> None:
        self.id = secrets.token_urlsafe(12)
        self.path, self.name = path, name
        self.seen: Photo | None = None
        self.query: QuerySkyline | None = None
        self.strokes: tuple[Stroke, ...] = ()
        self.trace: QuerySkyline | None = None
        self.result: MatchResult | None = None
        self.told: dict[str, Any] | None = None
        self.fitted: MatchResult | None = None
        self.state = "waiting"
        self.lock = threading.Lock()

    def record(self) -> dict[str, Any]:
        """Return the photo as the page's list shows it."""
        is_of_other = self.result is not None and self.found is None
        state = "ready" if is_of_other and self.state != "matching" else self.state
        said: dict[str, Any] = {"id": self.id, "name": self.name, "state": state}
        query, seen = self.query, self.seen
        if query is not None and seen is not None:
            said |= {
                "width": query.width_px,
                "height": query.height_px,
                "fov": None if _is_guess(query) else seen.fov_deg,
                "projection": str(seen.projection),
                "lonlat": seen.place.lonlat_deg,
                "accuracy": seen.place.accuracy_m,
                "elevation": seen.place.elevation_m,
                "heading": seen.place.heading_deg,
                "strokes": [
                    {"kind": str(one.kind), "radius": one.radius_px, "points": one.points_px}
                    for one in self.strokes
                ],
                "trusted": float(query.trusted.mean()),
                "result": self.told,
            }
        return said

    def lines(self) -> bytes:
        """Return rows and confidences of the skyline as float32, those not trusted NaN and 0."""
        query = self.known()
        both = np.stack([query.row_px, query.confidence])
        return both.astype("<f4").tobytes()

    @property
    def found(self) -> MatchResult | None:
        """The result of the search, as long as the skyline is the one that was searched for."""
        is_of_this = self.told and self.told["skyline"] == version_of(self.known())
        return self.result if is_of_this else None

    def known(self) -> QuerySkyline:
        """Return the skyline; raises `InputError` while the photo is not open yet."""
        if self.query is None:
            raise InputError(f"{self.name} is not open yet; wait until its skyline is found")
        return self.query


class Opened:
    """The photos that were looked at last, with what their skylines are found from."""

    def __init__(self) -> None:
        self._kept: OrderedDict[str, tuple[Photo, Correction]] = OrderedDict()
        self._lock = threading.Lock()

    def open(self, photo: PagePhoto) -> tuple[Photo, Correction]:
        """Read a photo, or return it as it was read before.

        Raises `SkylineError` where it cannot be used; the message has the photo's name and no path.
        """
        with self._lock:
            if photo.id in self._kept:
                self._kept.move_to_end(photo.id)
                return self._kept[photo.id]
        with photo.lock:
            opened = _read(photo)
        with self._lock:
            self._kept[photo.id] = opened
            while len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return opened

    def forget(self, photo: PagePhoto) -> None:
        """Free the memory of a photo."""
        with self._lock:
            self._kept.pop(photo.id, None)

    def first_look(self, photo: PagePhoto) -> None:
        """Open a photo and find its skyline; raises as `open`."""
        read, correction = self.open(photo)
        query = correction.solve()
        photo.seen = replace(read, rgb=read.rgb[:0])
        photo.query, photo.state = query, "ready"

    def solve(self, photo: PagePhoto, strokes: Sequence[Stroke]) -> QuerySkyline:
        """Find a photo's skyline again under all of its strokes."""
        _, correction = self.open(photo)
        if photo.trace is not None:
            correction = correction.restarted(photo.trace)
        with photo.lock:
            photo.query, photo.strokes = correction.solve(strokes), tuple(strokes)
            photo.fitted = None
            return photo.query

    def jpeg(self, photo: PagePhoto) -> bytes:
        """Return the picture that the page draws, without anything its file says beside it."""
        read, _ = self.open(photo)
        picture = Image.fromarray(read.rgb)
        picture.thumbnail((_SHOWN_PX, _SHOWN_PX))
        held = io.BytesIO()
        picture.save(held, format="JPEG", quality=90)
        return held.getvalue()


def version_of(query: QuerySkyline) -> str:
    """Return what tells a skyline from others of the same photo."""
    return hashlib.sha256(query.row_px.tobytes() + query.confidence.tobytes()).hexdigest()[:16]


def _is_guess(query: QuerySkyline) -> bool:
    """Whether the field of view is that of a crop, which nobody would give as known."""
    return query.lens is not None and query.lens.most_deg is not None


def _read(photo: PagePhoto) -> tuple[Photo, Correction]:
    too_many = _too_many(photo.path)
    if too_many is not None:
        raise InputError(
            f"{photo.name} has {too_many} pixels; the page takes at most "
            f"{MAX_PIXELS // 1_000_000} million: scale it down, 12 million are plenty"
        )
    try:
        read = read_photo(photo.path)
        return read, Correction(read)
    except SkylineError as error:
        said = str(error.args[0]).replace(str(photo.path), photo.name)
        raise InputError(said if photo.name in said else f"{photo.name}: {said}") from error


def _too_many(path: Path) -> str | None:
    """Return how many pixels a picture has, where they are too many."""
    try:
        with Image.open(path) as image:
            width, height = image.size
    except Image.DecompressionBombError:
        return "more than 170 million"
    except Exception:  # What is no picture is said when it is read.
        return None
    return f"{width} x {height}" if width * height > MAX_PIXELS else None
