"""Photos on the page, with their skylines, strokes and matches."""

import hashlib
import io
import secrets
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from skyline import (
    Correction,
    InputError,
    MatchResult,
    Narrowing,
    Photo,
    PhotoSkyline,
    Projection,
    SkylineError,
    Stroke,
    read_photo,
)
from skyline.location import area_of
from skyline.progress import Step
from skyline.web.area import PageArea, shown_name
from skyline.web.engine import Engine
from skyline.web.messages import outcome_json

_SHOWN_PX = 6000
"""Longest side of the picture sent to the page."""
_IN_MEMORY = 4
"""Number of photos whose pixels and evidence stay in memory."""
_STEPS: Mapping[str, tuple[float, float]] = {
    Step.SCREENING: (0.0, 0.25),
    Step.FITTING: (0.25, 0.5),
    Step.REFINING: (0.5, 0.9),
    Step.SURROUNDINGS: (0.9, 1.0),
}
"""Beginning and end of each step of a match, as shares of the whole."""
_MAKING: Mapping[str, tuple[float, float]] = {
    Step.FETCHING: (0.0, 0.3),
    Step.READING: (0.3, 0.35),
    Step.BUILDING: (0.35, 0.85),
}
"""Beginning and end of each step in which an area is made, as shares of these steps and the
match."""


class PagePhoto:
    """A photo on the page, with its skyline, strokes and results.

    Its file at ``path`` is the session's own, and never changes; ``name`` is the user's name for
    it. ``area`` is None until the place is searched, unless the command names stores. Raises
    `InputError` if the file cannot be used.
    """

    def __init__(self, path: Path, name: str, area: PageArea | None) -> None:
        self.id = secrets.token_urlsafe(12)
        self.path = path
        self.name = shown_name(name)
        with path.open("rb") as file:
            self.content = hashlib.file_digest(file, "sha256").hexdigest()
        self.projection: Projection | None = None
        self.skyline = opened(self)[1].solve()
        self._area = area
        self.near = self._noted_circle() if area is None else None
        self.strokes: tuple[Stroke, ...] = ()
        self.trace: PhotoSkyline | None = None
        self.trace_text: str | None = None
        self.result: MatchResult | None = None
        self.result_json: dict[str, Any] | None = None
        self.fitted: MatchResult | None = None
        self.match: Match | None = None
        self.lock = threading.Lock()

    def record(self) -> dict[str, Any]:
        """Return the photo as JSON for the page's list."""
        skyline = self.skyline
        # A field of view that is a guess from a cropped photo is not shown.
        is_guess = skyline.lens is not None and skyline.lens.most_fov_deg is not None
        result = self.current_result
        state = "ready" if result is None else "answered" if result.answer else "no answer"
        return {
            "id": self.id,
            "name": self.name,
            "content": self.content,
            "state": "matching" if self.match and not self.match.done else state,
            "width_px": skyline.width_px,
            "height_px": skyline.height_px,
            "fov_deg": None if is_guess else skyline.fov_deg,
            "lonlat_deg": skyline.noted.lonlat_deg,
            "accuracy_m": skyline.noted.accuracy_m,
            "heading_deg": skyline.noted.heading_deg,
            "near": self.near,
            "area": self._area and self._area.about,
            "projection": str(skyline.projection),
            "strokes": [
                {"kind": str(one.kind), "radius": one.radius_px, "points": one.points_px}
                for one in self.strokes
            ],
            "trace": self.trace_text,
            "result": self.result_json,
        }

    @property
    def area(self) -> PageArea:
        """Where the photo is searched; raises `InputError` without an area."""
        if self._area is None:
            raise InputError("there is no elevation for this photo yet; find the place first")
        return self._area

    def search_in(self, area: PageArea) -> None:
        """Search the photo in an area from now on."""
        self._area = area

    def _noted_circle(self) -> tuple[float, float, float] | None:
        """Return the circle that `skyline.locate` searches, or None."""
        with suppress(InputError):
            return area_of([self.path], Narrowing())[1].near
        return None

    def solve(self, strokes: Sequence[Stroke]) -> None:
        """Find the skyline again under all strokes."""
        _, correction = opened(self)
        with self.lock:
            self.skyline = correction.solve(strokes, self.trace)
            self.strokes = tuple(strokes)
            self.fitted = None

    def start_from(self, trace: PhotoSkyline | None, text: str | None) -> None:
        """Take the skyline from a trace, or anew from the photo, without strokes."""
        _, correction = opened(self)
        with self.lock:
            self.skyline = correction.solve((), trace)
            self.strokes = ()
            self.trace = trace
            self.trace_text = text
            self.fitted = None

    def project(self, projection: Projection) -> None:
        """Give the photo another projection.

        Its field of view is then unknown, unless the file notes it for that projection.
        """
        before, self.projection = self.projection, projection
        try:
            self.solve(self.strokes)
        except InputError:
            self.projection = before
            raise

    def jpeg(self) -> bytes:
        """Return the picture that the page draws, without the file's metadata."""
        picture = Image.fromarray(opened(self)[0].rgb)
        picture.thumbnail((_SHOWN_PX, _SHOWN_PX))
        held = io.BytesIO()
        picture.save(held, format="JPEG", quality=90)
        return held.getvalue()

    def lines(self) -> bytes:
        """Return the skyline's rows, trust and other crests, as float32.

        Columns that are not trusted have NaN and 0; those without another crest have NaN.
        """
        skyline = self.skyline
        lines = np.stack([skyline.row_px, skyline.trust, skyline.other_crest_px()])
        return lines.astype("<f4").tobytes()

    @property
    def current_result(self) -> MatchResult | None:
        """The result of the search; None if the skyline has changed since."""
        searched = self.result_json
        is_same = searched and searched["skyline"] == skyline_digest(self.skyline)
        return self.result if is_same else None

    def result_of(self, asked: Mapping[str, Any]) -> MatchResult | None:
        """Return a search's result, unless a search now would differ."""
        searched = self.result_json
        return self.current_result if searched and searched["asked"] == asked else None

    def cancel(self) -> None:
        """End the photo's match at its next report of progress."""
        if self.match is not None:
            self.match.cancelled.set()


def skyline_digest(skyline: PhotoSkyline) -> str:
    """Return a digest that distinguishes skylines of one photo."""
    seen = skyline.row_px.tobytes() + skyline.trust.tobytes() + skyline.projection.encode()
    return hashlib.sha256(seen).hexdigest()[:16]


def opened(photo: PagePhoto) -> tuple[Photo, Correction]:
    """Return a photo and its correction, from memory or its file.

    Raises `InputError` if the photo cannot be used; the message has the user's name for the file.
    """
    return _opened(photo, photo.projection)


@lru_cache(maxsize=_IN_MEMORY)
def _opened(photo: PagePhoto, projection: Projection | None) -> tuple[Photo, Correction]:
    try:
        read = read_photo(photo.path, projection=projection)
        return read, Correction(read)
    except SkylineError as error:
        message = str(error.args[0]).replace(str(photo.path), photo.name)
        named = message if photo.name in message else f"{photo.name}: {message}"
        raise InputError(named) from error


class _CancelledError(Exception):
    """Raised in the match's thread when the user cancels it."""


class Match:
    """A match of a photo, run in a thread.

    ``asked`` is the page's request.
    """

    def __init__(
        self,
        photo: PagePhoto,
        skyline: PhotoSkyline,
        narrowing: Narrowing,
        asked: Mapping[str, Any],
    ) -> None:
        self.photo = photo
        self._skyline = skyline
        self._narrowing = narrowing
        self._question = {"asked": asked, "skyline": skyline_digest(skyline)}
        self.cancelled = threading.Event()
        self.step = "waiting"
        self.share = 0.0
        self._begun = 0.0  # share at which the match begins, after its area was made
        self.error: str | None = None
        self.done = False

    def run(self, engine: Engine) -> None:
        """Match, and leave the result in the photo or an ``error``."""
        try:
            self._check()
            area = self._area(engine)
            result = area.matcher.match(
                self._skyline, narrowing=self._narrowing, report_progress=self._report
            )
        except _CancelledError:
            self.error = "cancelled"
        except SkylineError as error:
            self.error = str(error)
        except MemoryError:
            self.error = "there is not enough memory for this match; narrow the search"
        else:
            self.photo.result = result
            about = {"area": area.about}
            self.photo.result_json = self._question | outcome_json(result, area) | about
        finally:
            self.step = "done"
            self.share = 1.0
            self.done = True

    def _area(self, engine: Engine) -> PageArea:
        """Return the photo's area, made if it is missing."""
        # The circle round the photo's own position may lie in an area that is there.
        is_noted = self._narrowing.near == self.photo.near
        asked = replace(self._narrowing, near=None) if is_noted else self._narrowing
        if asked.near is None and self.photo.near is None and engine.area is None:
            raise InputError(
                f"{self.photo.name} does not note where it was taken; say where to search: give a "
                "place, and tick “In the circle”"
            )
        area = engine.area_for(self.photo.path, asked, self._report)
        self.photo.search_in(area)
        self._begun = self.share
        return area

    def progress(self) -> dict[str, Any]:
        """Return the progress as JSON for the page."""
        return {"photo": self.photo.id, "step": self.step, "share": self.share, "done": self.done}

    def _report(self, step: str, share: float) -> None:
        self._check()
        begins, ends = _MAKING.get(step) or self._after_making(step)
        # A step may run twice, and the bar must not run back.
        self.share = max(self.share, begins + (ends - begins) * min(share, 1.0))
        self.step = step

    def _after_making(self, step: str) -> tuple[float, float]:
        begins, ends = _STEPS.get(step, (0.0, 1.0))
        left = 1.0 - self._begun
        return self._begun + left * begins, self._begun + left * ends

    def _check(self) -> None:
        if self.cancelled.is_set():
            raise _CancelledError
