"""Sessions of the page: each has photos, their skylines and matches, and a folder of its own."""

import asyncio
import hashlib
import io
import secrets
import shutil
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
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
    Pose,
    SkylineError,
    Stroke,
    draw_labels,
    export_matches,
    read_photo,
    report_matches,
    write_located,
    write_trace,
)
from skyline.web.engine import Engine, shown_name

MAX_UPLOAD_BYTES = 100_000_000
MAX_SESSION_BYTES = 2_000_000_000
_GONE_S = 900.0
"""Time for which a session is kept after its last page closed: the page may be opened again."""
_UNATTENDED_S = 3.0
"""Time for which a match goes on without an open page."""
_SHOWN_PX = 6000
"""Longest side of the picture sent to the page."""
_KEPT = 4
"""Number of photos whose pixels and evidence stay in memory."""
_STEPS = {"screening": (0.0, 0.25), "fitting": (0.25, 0.5), "refining": (0.5, 1.0)}
"""Beginning and end of each step of a match, as shares of the whole."""
POSE = {
    "lon": "lon", "lat": "lat", "heading": "heading_deg", "pitch": "pitch_deg", "roll": "roll_deg",
    "fov": "fov_deg",
}  # fmt: skip
"""The numbers of a pose: their names on the page and in Skyline."""
KINDS = {
    "geojson": "geojson", "kml": "kml", "kmz": "kmz", "gpx": "gpx",
    "report": "html", "photo": "jpg", "names": "png",
}  # fmt: skip
"""Suffix of each kind of file that is saved with a place."""


class GoneError(InputError):
    """A session has ended, or a photo was removed."""


class PagePhoto:
    """A photo on the page, with its skyline, its strokes and its results.

    Its file at ``path`` is the session's own, never changed; ``name`` is the user's name of it.
    Raises `InputError` if the file cannot be used.
    """

    def __init__(self, path: Path, name: str) -> None:
        self.id = secrets.token_urlsafe(12)
        self.path, self.name = path, shown_name(name)
        with path.open("rb") as file:
            self.content = hashlib.file_digest(file, "sha256").hexdigest()
        self.query = opened(self)[1].solve()
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
        query, result = self.query, self.current_result
        state = "ready" if result is None else "answered" if result.answer else "no answer"
        return {
            "id": self.id,
            "name": self.name,
            "content": self.content,
            "state": "matching" if self.match and not self.match.done else state,
            "width": query.width_px,
            "height": query.height_px,
            # A field of view that is a guess from a cropped photo is not shown.
            "fov": None if query.lens and query.lens.most_fov_deg is not None else query.fov_deg,
            "lonlat": query.noted.lonlat_deg,
            "accuracy": query.noted.accuracy_m,
            "heading": query.noted.heading_deg,
            "strokes": [
                {"kind": str(one.kind), "radius": one.radius_px, "points": one.points_px}
                for one in self.strokes
            ],
            "trace": self.trace_text,
            "result": self.result_json,
        }

    def solve(self, strokes: Sequence[Stroke], trace: PhotoSkyline | None = None) -> None:
        """Find the skyline again under all strokes, from now on from a trace if one is given."""
        _, correction = opened(self)
        with self.lock:
            trace = self.trace if trace is None else trace
            self.query = correction.solve(strokes, trace)
            self.strokes, self.trace, self.fitted = tuple(strokes), trace, None

    def jpeg(self) -> bytes:
        """Return the picture that the page draws, without the file's metadata."""
        picture = Image.fromarray(opened(self)[0].rgb)
        picture.thumbnail((_SHOWN_PX, _SHOWN_PX))
        held = io.BytesIO()
        picture.save(held, format="JPEG", quality=90)
        return held.getvalue()

    def lines(self) -> bytes:
        """Return the skyline's rows, its confidences and the rows of other crests, as float32.

        Columns that are not trusted have NaN and 0, those without another crest NaN.
        """
        query = self.query
        lines = np.stack([query.row_px, query.confidence, query.other_crest_px()])
        return lines.astype("<f4").tobytes()

    @property
    def current_result(self) -> MatchResult | None:
        """The result of the search, None once the skyline has changed since."""
        searched = self.result_json
        return self.result if searched and searched["skyline"] == version_of(self.query) else None

    def result_of(self, asked: Mapping[str, Any]) -> MatchResult | None:
        """Return the result of a search, None unless the same one would be made now."""
        searched = self.result_json
        return self.current_result if searched and searched["asked"] == asked else None

    def cancel(self) -> None:
        """End the photo's match, if one runs, at its next report of progress."""
        if self.match is not None:
            self.match.cancelled.set()


def version_of(query: PhotoSkyline) -> str:
    """Return a digest that distinguishes a skyline from others of the same photo."""
    return hashlib.sha256(query.row_px.tobytes() + query.confidence.tobytes()).hexdigest()[:16]


@lru_cache(maxsize=_KEPT)
def opened(photo: PagePhoto) -> tuple[Photo, Correction]:
    """Return a photo and its correction, read from the file unless they are still in memory.

    Raises `InputError` if the photo cannot be used; the message has the user's name of the file.
    """
    try:
        read = read_photo(photo.path)
        return read, Correction(read)
    except SkylineError as error:
        message = str(error.args[0]).replace(str(photo.path), photo.name)
        named = message if photo.name in message else f"{photo.name}: {message}"
        raise InputError(named) from error


class _CancelledError(Exception):
    """Raised in the match's thread when the user cancels it."""


class Match:
    """One match of one photo, run in a thread; ``asked`` is the page's request."""

    def __init__(
        self, photo: PagePhoto, query: PhotoSkyline, narrowing: Narrowing, asked: Mapping[str, Any]
    ) -> None:
        self.photo = photo
        self._query, self._narrowing = query, narrowing
        self._question = {"asked": asked, "skyline": version_of(query)}
        self.cancelled = threading.Event()
        self.step, self.share = "waiting", 0.0
        self.error: str | None = None
        self.done = False

    def run(self, engine: Engine) -> None:
        """Match, and leave the result in the photo or a message in ``error``."""
        try:
            self._check()
            result = engine.matcher.match(
                self._query, narrowing=self._narrowing, report_progress=self._report
            )
        except _CancelledError:
            self.error = "cancelled"
        except SkylineError as error:
            self.error = str(error)
        except MemoryError:
            self.error = "there is not enough memory for this match; narrow the search"
        else:
            self.photo.result = result
            self.photo.result_json = self._question | outcome_json(result, engine)
        finally:
            self.step, self.share, self.done = "done", 1.0, True

    def progress(self) -> dict[str, Any]:
        """Return the progress as JSON for the page."""
        return {"photo": self.photo.id, "step": self.step, "share": self.share, "done": self.done}

    def _report(self, step: str, share: float) -> None:
        self._check()
        begins, ends = _STEPS.get(step, (0.0, 1.0))
        # A step may run twice, and the bar must not run back.
        self.share = max(self.share, begins + (ends - begins) * min(share, 1.0))
        self.step = step

    def _check(self) -> None:
        if self.cancelled.is_set():
            raise _CancelledError


def outcome_json(result: MatchResult, engine: Engine) -> dict[str, Any]:
    """Return the candidates of a search or a fit, and its verdict, as JSON for the page."""
    lens = "" if result.query.lens is None else result.query.lens.in_words
    return {
        "candidates": [candidate_json(one, engine) for one in result.candidates],
        "answered": result.answer is not None,
        "within": result.within_m,
        "chance": result.confidence,
        "refusal": result.refusal,
        "notes": [note for note in (result.exif_in_words(), lens, result.beyond) if note],
        "seconds": result.seconds,
    }


def candidate_json(candidate: Pose, engine: Engine) -> dict[str, Any]:
    """Return a candidate as JSON for the page; `POSE` gives the names of its numbers."""
    return {name: getattr(candidate, field) for name, field in POSE.items()} | {
        "distortion": candidate.distortion,
        "wander": candidate.wander,
        "rank": candidate.rank,
        "elevation": candidate.eye_elevation_m,
        "eyeHeight": engine.eye_height_m(candidate),
        "confidence": candidate.confidence,
        "refined": candidate.refined,
        "covariance": candidate.covariance_m2,
        "convergence": candidate.convergence_deg,
        "apart": candidate.residual_in_words,
    }


def trace_of(photo: PagePhoto, path: Path) -> bytes:
    """Return a photo's skyline as a trace; it is written to ``path`` and read back."""
    try:
        write_trace(photo.query, path)
        return path.read_bytes()
    finally:
        path.unlink(missing_ok=True)


def saved(kind: str, engine: Engine, photo: PagePhoto, result: MatchResult, folder: Path) -> bytes:
    """Return the content of a file of one of `KINDS`; it is written in a folder and read back.

    The first candidate of the result is the pose to save.
    """
    path, pose = folder / f"{secrets.token_hex(8)}.{KINDS[kind]}", result.candidates[0]
    matcher, beside = engine.matcher, path.with_suffix("")
    try:
        if kind == "photo":
            write_located(photo.path, path, pose)
        elif kind == "names":
            path.write_bytes(_named(engine, photo, pose))
        else:
            photos = [opened(photo)[0].rgb]
            if kind == "report":
                done = f"{pose.origin.capitalize()} on the page."
                report_matches(beside, matcher, [result], engine.peaks, photos, done).rename(path)
            else:
                export_matches(path, [result], matcher.frame, photos)
        return path.read_bytes()
    finally:
        path.unlink(missing_ok=True)
        shutil.rmtree(beside, ignore_errors=True)


def _named(engine: Engine, photo: PagePhoto, pose: Pose) -> bytes:
    """Return the photo with the names of the summits in it, as PNG."""
    if engine.peaks is None:
        raise InputError("no names are known; start skyline serve with --peaks FILE")
    picture = opened(photo)[0]
    seen = engine.viewer.summits(pose, picture.blank)
    return draw_labels(picture.blank, picture.rgb, seen)[0]


class Session:
    """The photos and matches of one user; the folder of the photos is made here."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.id, self.folder = folder.name, folder
        self.photos: dict[str, PagePhoto] = {}
        self.adding = asyncio.Lock()
        """Held while a photo is opened and added."""
        self.pages = 0
        self.closed_at = time.monotonic()

    def path_for(self, name: str) -> Path:
        """Return the path of a new file: a random name with the suffix of the given name."""
        suffix = Path(name).suffix.lower()
        plain = suffix if suffix[1:].isalnum() and len(suffix) <= 6 else ""
        return self.folder / (secrets.token_hex(12) + plain)

    @property
    def bytes(self) -> int:
        """Size of all files of the session."""
        return sum(path.stat().st_size for path in self.folder.iterdir() if path.is_file())

    def photo(self, photo_id: str) -> PagePhoto:
        """Return the photo of an id; raises `GoneError` if there is none."""
        if photo_id not in self.photos:
            raise GoneError("the server does not have this photo; remove it and add it again")
        return self.photos[photo_id]

    def remove(self, photo: PagePhoto) -> None:
        """Remove a photo from the page, and delete its file."""
        self.photos.pop(photo.id, None)
        photo.cancel()
        photo.path.unlink(missing_ok=True)

    def page_closed(self) -> None:
        """Count a page that was closed."""
        self.pages -= 1
        self.closed_at = time.monotonic()

    @property
    def unattended_s(self) -> float:
        """Time since the last page was closed; 0 while a page is open."""
        return 0.0 if self.pages else time.monotonic() - self.closed_at


class Sessions:
    """All sessions; their folders lie in one temporary folder that is deleted with the server."""

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="skyline-page-"))
        self._sessions: dict[str, Session] = {}

    def begin(self) -> Session:
        """Return a new session."""
        session = Session(self._folder / secrets.token_urlsafe(24))
        self._sessions[session.id] = session
        return session

    def of(self, session_id: str) -> Session:
        """Return the session of an id; raises `GoneError` if there is none."""
        if session_id not in self._sessions:
            raise GoneError("the server has ended this session and its photos; reload the page")
        return self._sessions[session_id]

    def sweep(self) -> None:
        """End matches that no open page awaits, and sessions that were closed long ago."""
        for session in list(self._sessions.values()):
            if session.unattended_s > _UNATTENDED_S:
                for photo in list(session.photos.values()):
                    photo.cancel()
            if session.unattended_s > _GONE_S:
                self._end(session)

    def close(self) -> None:
        """End all sessions and delete their files."""
        for session in list(self._sessions.values()):
            self._end(session)
        shutil.rmtree(self._folder, ignore_errors=True)

    def _end(self, session: Session) -> None:
        for photo in list(session.photos.values()):
            photo.cancel()
        self._sessions.pop(session.id, None)
        shutil.rmtree(session.folder, ignore_errors=True)
