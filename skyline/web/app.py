"""The server's addresses: the page, photos, skylines, matches and files."""

import asyncio
import contextlib
import json
import shutil
from collections.abc import AsyncIterator, Callable, Mapping
from functools import partial
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from skyline import InputError, Matcher, Projection, SkylineError, read_trace
from skyline.web.area import shown_name
from skyline.web.engine import Engine
from skyline.web.live import LiveChannel
from skyline.web.messages import (
    known_of,
    narrowing_of,
    outcome_json,
    pose_of,
    skyline_of,
    strokes_of,
)
from skyline.web.photos import Match, PagePhoto, skyline_digest
from skyline.web.saving import KINDS, chosen_of, saved, trace_of
from skyline.web.sessions import MAX_SESSION_BYTES, MAX_UPLOAD_BYTES, GoneError, Session, Sessions

_PAGE = Path(__file__).parent / "page"
_MAX_JSON_BYTES = 8_000_000
_SWEEP_S = 1.0
"""Interval between searches for sessions without an open page."""


class TooLargeError(InputError):
    """An upload exceeds the limit."""


class PageApp:
    """The web application of an engine.

    ``started`` is called once it answers requests. ``machine`` names the machine to which photos go
    from other machines; None if these cannot open the page.
    """

    def __init__(self, engine: Engine, machine: str | None, started: Callable[[], None]) -> None:
        self._engine = engine
        self._sessions = Sessions()
        self._machine = machine
        self._started = started

    def app(self) -> Starlette:
        """Return the application, with all addresses of the page."""
        try:
            leaflet = distribution("XStatic-Leaflet").locate_file("xstatic/pkg/leaflet/data")
        except PackageNotFoundError as error:
            raise InputError(
                "the page needs a package that is not installed; pip install XStatic-Leaflet"
            ) from error
        of_photo = "/session/{session}/photos/{photo}"
        routes = [
            Route("/", _page),
            Route("/state", self._state),
            Route("/relief/{area}/{zoom:int}/{x:int}/{y:int}.png", self._relief),
            Route("/names/{area}", self._names),
            Route("/session", self._begin, methods=["POST"]),
            Route("/session/{session}", self._all),
            WebSocketRoute("/session/{session}/live", self._live),
            Route("/session/{session}/photos", self._upload, methods=["POST"]),
            Route("/session/{session}/given/{index:int}", self._given, methods=["POST"]),
            Route(of_photo, self._remove, methods=["DELETE"]),
            Route(f"{of_photo}/picture", self._picture),
            Route(f"{of_photo}/skyline", self._skyline, methods=["POST"]),
            Route(f"{of_photo}/trace", self._trace),
            Route(f"{of_photo}/trace", self._load_trace, methods=["POST"]),
            Route(f"{of_photo}/trace", self._drop_trace, methods=["DELETE"]),
            Route(f"{of_photo}/match", self._match, methods=["POST"]),
            Route(f"{of_photo}/match", self._cancel, methods=["DELETE"]),
            Route(f"{of_photo}/fit", self._fit, methods=["POST"]),
            Route(f"{of_photo}/save/{{kind}}", self._save, methods=["POST"]),
            Mount("/page", StaticFiles(directory=_PAGE)),
            Mount("/leaflet", StaticFiles(directory=str(leaflet))),
        ]
        refused = dict.fromkeys((SkylineError, ClientDisconnect), _refused)
        return Starlette(routes=routes, exception_handlers=refused, lifespan=self._lifespan)

    @contextlib.asynccontextmanager
    async def _lifespan(self, _: Starlette) -> AsyncIterator[None]:
        sweeping = asyncio.create_task(self._sweep())
        self._started()
        yield
        sweeping.cancel()
        self._sessions.close()

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(_SWEEP_S)
            await asyncio.to_thread(self._sessions.sweep)

    async def _state(self, _: Request) -> Response:
        return JSONResponse(self._engine.about() | {"machine": self._machine})

    async def _relief(self, request: Request) -> Response:
        at = (request.path_params[name] for name in ("zoom", "x", "y"))
        area = self._engine.areas.get(request.path_params["area"])
        if area is None or area.relief is None:
            return Response(status_code=404)
        try:
            tile = await self._engine.work("live", area.relief.png, *at)
        except InputError:
            return Response(status_code=404)
        return Response(tile, media_type="image/png", headers={"Cache-Control": "max-age=3600"})

    async def _names(self, request: Request) -> Response:
        area = self._engine.areas.get(request.path_params["area"])
        return JSONResponse([] if area is None else area.names)

    async def _begin(self, _: Request) -> Response:
        session = self._sessions.begin()
        return JSONResponse({"session": session.id, "photos": []})

    async def _all(self, request: Request) -> Response:
        session = self._session(request)
        async with session.adding:  # A page that is loaded again shows the photo that is opened.
            pass
        return JSONResponse({"photos": [photo.record() for photo in session.photos.values()]})

    async def _live(self, socket: WebSocket) -> None:
        try:
            session = self._sessions.of(socket.path_params["session"])
        except GoneError:
            await socket.close(1008)
            return
        await LiveChannel(socket, self._engine, session).run()

    async def _upload(self, request: Request) -> Response:
        session = self._session(request)
        name = shown_name(request.query_params.get("name", ""))
        limit = min(MAX_UPLOAD_BYTES, max(0, MAX_SESSION_BYTES - session.bytes))
        body = await _body(request, limit, name, "save it smaller, or remove photos")
        return await self._opened(session, name, lambda path: path.write_bytes(body))

    async def _given(self, request: Request) -> Response:
        session = self._session(request)
        index = request.path_params["index"]
        if index >= len(self._engine.photos):
            return Response(status_code=404)
        name, given = list(self._engine.photos.items())[index]
        return await self._opened(session, name, partial(_copy, given))

    async def _opened(
        self, session: Session, name: str, write: Callable[[Path], object]
    ) -> Response:
        """Add a photo, which ``write`` writes to the session's own file."""
        path = session.path_for(name)
        try:
            await self._engine.work("photos", write, path)
            async with session.adding:
                photo = await self._engine.work("photos", PagePhoto, path, name, self._engine.area)
                session.photos[photo.id] = photo
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        return JSONResponse(photo.record())

    async def _remove(self, request: Request) -> Response:
        photo = self._photo(request)
        self._session(request).remove(photo)
        return JSONResponse({})

    async def _picture(self, request: Request) -> Response:
        photo = self._photo(request)
        jpeg = await self._engine.work("photos", photo.jpeg)
        return Response(jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    async def _skyline(self, request: Request) -> Response:
        photo = self._photo(request)
        asked = await _json(request)
        if "projection" in asked:
            projection = Projection(str(asked["projection"]))
            await self._engine.work("strokes", photo.project, projection)
        if "strokes" in asked:
            await self._engine.work("strokes", photo.solve, strokes_of(asked["strokes"]))
        return _lines(photo)

    async def _trace(self, request: Request) -> Response:
        photo = self._photo(request)
        path = self._session(request).path_for("trace.csv")
        text = await self._engine.work("files", trace_of, photo, path)
        return Response(text, media_type="text/csv")

    async def _load_trace(self, request: Request) -> Response:
        photo = self._photo(request)
        path = self._session(request).path_for("trace.csv")
        body = await _body(request, _MAX_JSON_BYTES, "the trace", "use a trace with fewer points")
        try:
            path.write_bytes(body)
            await self._engine.work("strokes", _load_trace, photo, path)
        finally:
            path.unlink(missing_ok=True)
        return _lines(photo)

    async def _drop_trace(self, request: Request) -> Response:
        photo = self._photo(request)
        await self._engine.work("strokes", photo.start_from, None, None)
        return _lines(photo)

    async def _match(self, request: Request) -> Response:
        """Match a photo, and answer when the match has ended."""
        photo = self._photo(request)
        asked = await _json(request)
        if photo.match is not None and not photo.match.done:
            raise InputError("this photo is being matched; wait, or cancel that match")
        match = Match(photo, skyline_of(asked, photo.skyline), narrowing_of(asked), asked)
        photo.match = match
        await self._engine.work("matches", match.run, self._engine)
        if match.error is not None:
            raise InputError(match.error)
        return JSONResponse(photo.result_json)

    async def _cancel(self, request: Request) -> Response:
        self._photo(request).cancel()
        return JSONResponse({})

    async def _fit(self, request: Request) -> Response:
        photo = self._photo(request)
        asked = await _json(request)
        return JSONResponse(await self._engine.work("matches", self._fitted, photo, asked))

    def _fitted(self, photo: PagePhoto, asked: Mapping[str, Any]) -> dict[str, Any]:
        skyline, area = photo.skyline, photo.area
        start = pose_of(asked.get("pose"), skyline, area.viewer)
        known = known_of(asked)
        searched = photo.result_of(known)
        if searched is None:
            found = area.matcher.fit(skyline_of(known, skyline), start, narrowing_of(known))
        else:
            found = area.matcher.fit(searched, start)
        if not found.candidates:
            raise InputError(f"{found.refusal}; bring the two skylines closer by hand")
        with photo.lock:
            photo.fitted = found if photo.skyline is skyline else None
        return outcome_json(found, area)

    async def _save(self, request: Request) -> Response:
        session = self._session(request)
        photo = self._photo(request)
        asked = await _json(request)
        kind = request.path_params["kind"]
        if kind not in KINDS:
            return Response(status_code=404)
        result = chosen_of(asked, photo)
        content = await self._engine.work("files", saved, kind, photo, result, session.folder)
        return Response(content, media_type="application/octet-stream")

    def _session(self, request: Request) -> Session:
        return self._sessions.of(request.path_params["session"])

    def _photo(self, request: Request) -> PagePhoto:
        return self._session(request).photo(request.path_params["photo"])


def _lines(photo: PagePhoto) -> Response:
    headers = {"ETag": f'"{skyline_digest(photo.skyline)}"'}
    lacks = Matcher.too_little(photo.skyline)
    if lacks is not None:
        headers["Skyline-Lacks"] = lacks
    return Response(photo.lines(), media_type="application/octet-stream", headers=headers)


def _copy(given: Path, path: Path) -> None:
    """Copy a user's photo, which may change while the page shows it."""
    try:
        shutil.copyfile(given, path)
    except OSError as error:
        raise InputError(
            f"{given.name} cannot be copied for the page ({error.strerror}); see that it is there "
            "and the disk has room"
        ) from error


def _load_trace(photo: PagePhoto, path: Path) -> None:
    """Take a photo's skyline from a trace.

    A message about the file calls it "the trace", as the user does not know its path.
    """
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
        photo.start_from(read_trace(path), text)
    except SkylineError as error:
        raise InputError(str(error).replace(str(path), "the trace")) from error


async def _page(_: Request) -> Response:
    return FileResponse(_PAGE / "index.html")


async def _refused(_: Request, error: Exception) -> Response:
    if isinstance(error, TooLargeError):
        return JSONResponse({"error": str(error)}, 413, {"Connection": "close"})
    return JSONResponse({"error": str(error)}, 404 if isinstance(error, GoneError) else 400)


async def _json(request: Request) -> Mapping[str, Any]:
    """Return the JSON object of a request; raises `InputError` for anything else."""
    body = await _body(request, _MAX_JSON_BYTES, "the request", "undo some strokes")
    try:
        asked = json.loads(body or b"{}")
    except (ValueError, RecursionError):
        asked = None
    if not isinstance(asked, dict):
        raise InputError("the request is not a JSON object; reload the page")
    return asked


async def _body(request: Request, limit: int, name: str, advice: str) -> bytearray:
    """Return a request's body; raises `TooLargeError` beyond a limit of bytes."""
    declared = request.headers.get("content-length", "0")
    size = int(declared) if declared.isdecimal() else 0
    body = bytearray()
    parts = request.stream()
    while size <= limit:
        part = await anext(parts, None)
        if part is None:
            return body
        body += part
        size = max(size, len(body))
    raise TooLargeError(
        f"{name} has {size / 1e6:.0f} MB or more; the page takes at most "
        f"{limit / 1e6:.0f} MB: {advice}"
    )
