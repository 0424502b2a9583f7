"""The server's addresses: the page and its parts, photos, skylines, matches, files to save."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable, Mapping
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from skyline import InputError, SkylineError, read_trace
from skyline.web.asked import chosen_of, narrowing_of, pose_of, query_of, strokes_of
from skyline.web.engine import Engine, shown_name
from skyline.web.live import LiveChannel
from skyline.web.match_jobs import Match, candidate_json
from skyline.web.photos import PagePhoto, version_of
from skyline.web.saving import KINDS, saved
from skyline.web.sessions import MAX_SESSION_BYTES, MAX_UPLOAD_BYTES, Session, Sessions

_PAGE = Path(__file__).parent / "page"
_MAX_JSON_BYTES = _MAX_TRACE_BYTES = 8_000_000
_SWEEP_S = 1.0
_MEGABYTE = 1_000_000


class TooLargeError(InputError):
    """An upload beyond the limit."""


def make_app(engine: Engine, started: Callable[[], None]) -> Starlette:
    """Return the application over an opened store; ``started`` is called when it can be used."""
    return _Pages(engine, started).app()


def leaflet_folder() -> Path:
    """Return where the map viewer's files are installed; raises `InputError` without them."""
    try:
        folder = distribution("XStatic-Leaflet").locate_file("xstatic/pkg/leaflet/data")
    except PackageNotFoundError as error:
        raise InputError(
            "the page needs packages that are not installed; pip install 'skyline[web]'"
        ) from error
    return Path(str(folder))


class _Pages:
    def __init__(self, engine: Engine, started: Callable[[], None]) -> None:
        self._engine, self._sessions = engine, Sessions()
        self._started = started
        self._running: set[asyncio.Task[None]] = set()

    def app(self) -> Starlette:
        of_photo = "/session/{session}/photos/{photo}"
        routes = [
            Route("/", _page),
            Route("/state", self._state),
            Route("/relief/{zoom:int}/{x:int}/{y:int}.png", self._relief),
            Route("/session", self._begin, methods=["POST"]),
            Route("/session/{session}", self._all),
            WebSocketRoute("/session/{session}/live", self._live),
            Route("/session/{session}/photos", self._upload, methods=["POST"]),
            Route("/session/{session}/given/{index:int}", self._given, methods=["POST"]),
            Route(of_photo, self._remove, methods=["DELETE"]),
            Route(f"{of_photo}/picture", self._picture),
            Route(f"{of_photo}/skyline", self._skyline, methods=["POST"]),
            Route(f"{of_photo}/trace", self._trace, methods=["POST"]),
            Route(f"{of_photo}/match", self._match, methods=["POST"]),
            Route(f"{of_photo}/match", self._cancel, methods=["DELETE"]),
            Route(f"{of_photo}/fit", self._fit, methods=["POST"]),
            Route(f"{of_photo}/save/{{kind}}", self._save, methods=["POST"]),
            Mount("/page", StaticFiles(directory=_PAGE)),
            Mount("/leaflet", StaticFiles(directory=leaflet_folder())),
        ]
        refused = dict.fromkeys((SkylineError, KeyError, IndexError, ClientDisconnect), _refused)
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
        return JSONResponse(self._engine.about())

    async def _relief(self, request: Request) -> Response:
        at = (request.path_params[name] for name in ("zoom", "x", "y"))
        if self._engine.relief is None:
            return Response(status_code=404)
        try:
            tile = await self._engine.work("live", self._engine.relief.png, *at)
        except InputError:
            return Response(status_code=404)
        return Response(tile, media_type="image/png", headers={"Cache-Control": "max-age=3600"})

    async def _begin(self, _: Request) -> Response:
        session = self._sessions.begin()
        return JSONResponse({"session": session.id})

    async def _all(self, request: Request) -> Response:
        session = self._session(request)
        return JSONResponse({"photos": [photo.record() for photo in session.photos.values()]})

    async def _live(self, socket: WebSocket) -> None:
        try:
            session = self._sessions.of(socket.path_params["session"])
        except KeyError:
            await socket.close(1008)
            return
        await LiveChannel(socket, self._engine, session).run()

    async def _upload(self, request: Request) -> Response:
        session, name = self._session(request), shown_name(request.query_params.get("name", ""))
        path = session.path_for(name)
        left = MAX_SESSION_BYTES - session.bytes
        try:
            await _received(request, path, name, min(MAX_UPLOAD_BYTES, left))
            photo = session.add(path, name)
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        return await self._first_look(session, photo)

    async def _given(self, request: Request) -> Response:
        session = self._session(request)
        path = self._engine.given.photos[request.path_params["index"]]
        return await self._first_look(session, session.add(path, path.name))

    async def _first_look(self, session: Session, photo: PagePhoto) -> Response:
        try:
            await self._engine.work("photos", self._sessions.opened.first_look, photo)
        except SkylineError:
            session.remove(photo)
            raise
        return JSONResponse(photo.record())

    async def _remove(self, request: Request) -> Response:
        photo = self._photo(request)
        self._session(request).remove(photo)
        self._sessions.opened.forget(photo)
        return JSONResponse({})

    async def _picture(self, request: Request) -> Response:
        photo = self._photo(request)
        jpeg = await self._engine.work("photos", self._sessions.opened.jpeg, photo)
        return Response(jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    async def _skyline(self, request: Request) -> Response:
        photo, asked = self._photo(request), await _json(request)
        if "strokes" in asked:
            strokes = strokes_of(asked["strokes"])
            await self._engine.work("strokes", self._sessions.opened.solve, photo, strokes)
        return _lines(photo)

    async def _trace(self, request: Request) -> Response:
        session, photo = self._session(request), self._photo(request)
        path = session.path_for("trace.csv")
        try:
            await _received(request, path, "the trace", _MAX_TRACE_BYTES)
            await self._engine.work("strokes", self._load_trace, photo, path)
        finally:
            path.unlink(missing_ok=True)
        return _lines(photo)

    def _load_trace(self, photo: PagePhoto, path: Path) -> None:
        try:
            trace = read_trace(path)
            _, correction = self._sessions.opened.open(photo)
            correction.restarted(trace)
        except SkylineError as error:
            raise InputError(str(error).replace(str(path), "the trace")) from error
        photo.trace = trace
        self._sessions.opened.solve(photo, ())

    async def _match(self, request: Request) -> Response:
        """Match a photo; the answer comes when the match has ended, however it did."""
        session, photo, asked = self._session(request), self._photo(request), await _json(request)
        before = session.matches.get(photo.id)
        if before is not None and not before.done:
            raise InputError("this photo is being matched; wait, or cancel that match")
        match = Match(photo, query_of(asked, photo.known()), narrowing_of(asked), asked)
        session.matches[photo.id] = match
        photo.state = "matching"
        await self._engine.work("matches", match.run, self._engine)
        if match.error is not None:
            raise InputError(match.error)
        return JSONResponse(photo.told)

    async def _cancel(self, request: Request) -> Response:
        match = self._session(request).matches.get(self._photo(request).id)
        if match is not None:
            match.cancel()
        return JSONResponse({})

    async def _fit(self, request: Request) -> Response:
        photo, asked = self._photo(request), await _json(request)
        return JSONResponse(await self._engine.work("matches", self._fitted, photo, asked))

    def _fitted(self, photo: PagePhoto, asked: Mapping[str, Any]) -> dict[str, Any]:
        if self._engine.viewer is None or photo.query is None:
            raise InputError("there is nothing to render with: the store's DEM is not at hand")
        query, start = photo.query, pose_of(asked.get("pose"), self._engine.viewer)
        found = self._engine.matcher.fit(query, start)
        if not found.candidates:
            raise InputError(f"{found.refusal}; bring the two skylines closer by hand")
        with photo.lock:
            photo.fitted = found if photo.query is query else None
        return {**candidate_json(found.candidates[0], self._engine), "refusal": found.refusal}

    async def _save(self, request: Request) -> Response:
        session, photo, asked = self._session(request), self._photo(request), await _json(request)
        kind = request.path_params["kind"]
        if kind not in KINDS:
            return Response(status_code=404)
        candidates = () if kind == "trace" else chosen_of(asked, photo, self._engine.viewer)
        what = kind, self._engine, self._sessions.opened, photo, candidates, session.folder
        content = await self._engine.work("files", saved, *what)
        return Response(content, media_type=KINDS[kind][1])

    def _session(self, request: Request) -> Session:
        return self._sessions.of(request.path_params["session"])

    def _photo(self, request: Request) -> PagePhoto:
        return self._session(request).photos[request.path_params["photo"]]


def _lines(photo: PagePhoto) -> Response:
    headers = {"ETag": f'"{version_of(photo.known())}"'}
    return Response(photo.lines(), media_type="application/octet-stream", headers=headers)


async def _page(_: Request) -> Response:
    return FileResponse(_PAGE / "index.html")


async def _refused(_: Request, error: Exception) -> Response:
    """Answer an error with one line; an unknown session or photo is a key that is not there."""
    if isinstance(error, ClientDisconnect):
        return Response(status_code=400)
    if not isinstance(error, SkylineError):
        return JSONResponse({"error": "this is not on the page any more; reload it"}, 404)
    if isinstance(error, TooLargeError):
        return JSONResponse({"error": str(error)}, 413, {"Connection": "close"})
    return JSONResponse({"error": str(error)}, 400)


async def _json(request: Request) -> Mapping[str, Any]:
    """Return the object that a request brings; raises `InputError` for anything else."""
    held = bytearray()
    async for part in request.stream():
        held += part
        if len(held) > _MAX_JSON_BYTES:
            raise TooLargeError("the request is too large; undo some strokes")
    try:
        asked = json.loads(held or b"{}")
    except (ValueError, RecursionError):
        asked = None
    if not isinstance(asked, dict):
        raise InputError("the request is not a JSON object; reload the page")
    return asked


async def _received(request: Request, path: Path, name: str, limit: int) -> None:
    """Write what a request brings to a new file; raises `TooLargeError` beyond a limit."""

    def check(size: int) -> None:
        if size > limit:
            raise TooLargeError(
                f"{name} has {size / _MEGABYTE:.0f} MB or more; the page takes at most "
                f"{limit / _MEGABYTE:.0f} MB: save it smaller, or remove other photos"
            )

    told = request.headers.get("content-length", "0")
    check(int(told) if told.isdecimal() else 0)
    with path.open("xb") as file:
        size = 0
        async for part in request.stream():
            size += len(part)
            check(size)
            file.write(part)
