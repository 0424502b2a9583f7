"""People at the page: each has a folder of photos, which goes when the person has gone."""

import secrets
import shutil
import tempfile
import time
from pathlib import Path

from skyline import InputError
from skyline.web.engine import shown_name
from skyline.web.match_jobs import Match
from skyline.web.photos import Opened, PagePhoto

MAX_UPLOAD_BYTES = 100_000_000
MAX_SESSION_BYTES = 2_000_000_000
MAX_PHOTOS = 300
MAX_SESSIONS = 50
_GONE_S = 900.0
"""How long photos are kept for somebody whose page is closed: it may be opened again."""
_UNATTENDED_S = 3.0
"""How long a match goes on for nobody."""


class Session:
    """One person's photos and matches, in a folder of their own that is not there yet."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.id, self.folder = folder.name, folder
        self.photos: dict[str, PagePhoto] = {}
        self.matches: dict[str, Match] = {}
        self.pages = 0
        self.bytes = 0
        self.left_at = time.monotonic()

    def path_for(self, name: str) -> Path:
        """Return where a new file goes: a name of ours, with the suffix of theirs."""
        suffix = Path(name).suffix.lower()
        plain = suffix if suffix[1:].isalnum() and len(suffix) <= 6 else ""
        return self.folder / (secrets.token_hex(12) + plain)

    def add(self, path: Path, name: str) -> PagePhoto:
        """Put a photo onto the page."""
        if len(self.photos) >= MAX_PHOTOS:
            raise InputError(f"there are {MAX_PHOTOS} photos on the page; remove some first")
        photo = PagePhoto(path, shown_name(name))
        self.photos[photo.id] = photo
        if path.parent == self.folder:
            self.bytes += path.stat().st_size
        return photo

    def remove(self, photo: PagePhoto) -> None:
        """Take a photo off the page, and delete its file where it was uploaded."""
        self.photos.pop(photo.id, None)
        match = self.matches.pop(photo.id, None)
        if match is not None:
            match.cancel()
        if photo.path.parent == self.folder:
            self.bytes -= photo.path.stat().st_size
            photo.path.unlink()

    def came(self) -> None:
        """Note that a page was opened."""
        self.pages += 1

    def left(self) -> None:
        """Note that a page was closed."""
        self.pages -= 1
        self.left_at = time.monotonic()

    @property
    def unattended_s(self) -> float:
        """For how long no page has been open."""
        return 0.0 if self.pages else time.monotonic() - self.left_at


class Sessions:
    """All people at the page. Their folders lie in one that ends with the server."""

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="skyline-page-"))
        self._sessions: dict[str, Session] = {}
        self.opened = Opened()

    def begin(self) -> Session:
        """Return a new person's session; where there are too many, who left first must go."""
        if len(self._sessions) >= MAX_SESSIONS:
            gone = max(list(self._sessions.values()), key=lambda session: session.unattended_s)
            if gone.pages:
                raise InputError(f"{MAX_SESSIONS} pages are open; close some of them")
            self._end(gone)
        session = Session(self._folder / secrets.token_urlsafe(24))
        self._sessions[session.id] = session
        return session

    def of(self, session_id: str) -> Session:
        """Return a person's session; raises `KeyError` where there is none."""
        return self._sessions[session_id]

    def sweep(self) -> None:
        """End matches that nobody waits for, and forget who has gone."""
        for session in list(self._sessions.values()):
            if session.unattended_s > _UNATTENDED_S:
                for match in session.matches.values():
                    match.cancel()
            if session.unattended_s > _GONE_S:
                self._end(session)

    def close(self) -> None:
        """End all sessions and delete their files."""
        for session in list(self._sessions.values()):
            self._end(session)
        shutil.rmtree(self._folder, ignore_errors=True)

    def _end(self, session: Session) -> None:
        for photo in list(session.photos.values()):
            session.remove(photo)
            self.opened.forget(photo)
        self._sessions.pop(session.id, None)
        shutil.rmtree(session.folder, ignore_errors=True)
