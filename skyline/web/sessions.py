"""Sessions of the page, each with its own photos and folder."""

import asyncio
import secrets
import shutil
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from skyline import InputError
from skyline.web.photos import PagePhoto

MAX_UPLOAD_BYTES = 100_000_000
MAX_SESSION_BYTES = 2_000_000_000


@dataclass(frozen=True)
class Stay:
    """How long a session stays after its page was closed."""

    unattended_s: float = 3.0
    """How long a match goes on without an open page."""
    gone_s: float = 900.0
    """How long a session is kept after its last page closed, since the page may be opened again."""


class GoneError(InputError):
    """A session has ended, or a photo was removed."""


class Session:
    """The photos and matches of one user, and their folder."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.id = folder.name
        self.folder = folder
        self.photos: dict[str, PagePhoto] = {}
        self.adding = asyncio.Lock()
        """Held while a photo is opened and added."""
        self.pages = 0
        self.closed_at = time.monotonic()

    def path_for(self, name: str) -> Path:
        """Return a new file's path: a random name with a suffix.

        ``name`` gives the suffix.
        """
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
        """Note that a page was closed."""
        self.pages -= 1
        self.closed_at = time.monotonic()

    @property
    def unattended_s(self) -> float:
        """Time since the last page closed; 0 while one is open."""
        return 0.0 if self.pages else time.monotonic() - self.closed_at


class Sessions:
    """All sessions.

    Their folders lie in one temporary folder that is deleted with the server.
    """

    def __init__(self, stay: Stay = Stay()) -> None:
        self._stay = stay
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
        """End matches that no page waits for, and sessions closed long ago."""
        for session in list(self._sessions.values()):
            if session.unattended_s > self._stay.unattended_s:
                for photo in list(session.photos.values()):
                    photo.cancel()
            if session.unattended_s > self._stay.gone_s:
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
