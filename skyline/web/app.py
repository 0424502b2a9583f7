"""The addresses of the server: the page, photos, skylines, matches, files and a live channel."""

import asyncio
import contextlib
import json
import logging
import shutil
from collections.abc import AsyncIterator, Callable, Mapping
from functools import partial
from importlib.metadata import PackageNotFoundError, distribution
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from skyline import InputError, SkylineError, read_trace
from skyline.web.engine import Engine, shown_name
from skyline.web.requests import (
    chosen_of,
    known_of,
    narrowing_of,
    number,
    pose_of,
    query_of,
    strokes_of,
)
from skyline.web.session import (
    KINDS,
    MAX_SESSION_BYTES,
    MAX_UPLOAD_BYTES,
    GoneError,
    Match,
    PagePhoto,
    Session,
    Sessions,
    outcome_json,
    saved,
    trace_of,
    version_of,
)

_log = logging.getLogger(__name__)

_PAGE = Path(__file__).parent / "page"
_MAX_JSON_BYTES = 8_000_000
_SWEEP_S = 1.0
_MEGABYTE = 1_000_000
_PROGRESS_S = 0.15
"""Interval between two reports of the progress of matches."""
_GAPS = 240
"""Number of columns for which the live channel reports the gap between the skylines."""


class TooLargeError(InputError):
    """An upload exceeds the limit."""


class PageApp:
    """The web application of an engine; ``started`` is called once it answers requests.

    ``machine`` names the machine to which the photos of others go, None if there are no others.
    """

    def __init__(self, engine: Engine, machine: str | None, started: Callable[[], None]) -> None:
        self._engine, self._sessions = engine, Sessions()
        self._machine, self._started = machine, started

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
            Route("/relief/{zoom:int}/{x:int}/{y:int}.png", self._relief),
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
        if self._engine.relief is None:
            return Response(status_code=404)
        try:
            tile = await self._engine.work("live", self._engine.relief.png, *at)
        except InputError:
            return Response(status_code=404)
        return Response(tile, media_type="image/png", headers={"Cache-Control": "max-age=3600"})

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
        await _LiveChannel(socket, self._engine, session).run()

    async def _upload(self, request: Request) -> Response:
        session, name = self._session(request), shown_name(request.query_params.get("name", ""))
        limit = min(MAX_UPLOAD_BYTES, max(0, MAX_SESSION_BYTES - session.bytes))
        body = await _body(request, limit, name, "save it smaller, or remove photos")
        return await self._opened(session, name, lambda path: path.write_bytes(body))

    async def _given(self, request: Request) -> Response:
        session = self._session(request)
        index = request.path_params["index"]
        if index >= len(self._engine.photos):
            return Response(status_code=404)
        given = self._engine.photos[index]
        return await self._opened(session, given.name, partial(_copy, given))

    async def _opened(
        self, session: Session, name: str, write: Callable[[Path], object]
    ) -> Response:
        """Add a photo to a session; ``write`` writes it to the session's own file."""
        path = session.path_for(name)
        try:
            await self._engine.work("photos", write, path)
            async with session.adding:
                photo = await self._engine.work("photos", PagePhoto, path, name)
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
        photo, asked = self._photo(request), await _json(request)
        if "strokes" in asked:
            await self._engine.work("strokes", photo.solve, strokes_of(asked["strokes"]))
        return _lines(photo)

    async def _trace(self, request: Request) -> Response:
        photo, path = self._photo(request), self._session(request).path_for("trace.csv")
        text = await self._engine.work("files", trace_of, photo, path)
        return Response(text, media_type="text/csv")

    async def _load_trace(self, request: Request) -> Response:
        session, photo = self._session(request), self._photo(request)
        path = session.path_for("trace.csv")
        body = await _body(request, _MAX_JSON_BYTES, "the trace", "use a trace with fewer points")
        try:
            path.write_bytes(body)
            await self._engine.work("strokes", _load_trace, photo, path)
        finally:
            path.unlink(missing_ok=True)
        return _lines(photo)

    async def _match(self, request: Request) -> Response:
        """Match a photo; the response comes when the match has ended or was cancelled."""
        photo, asked = self._photo(request), await _json(request)
        if photo.match is not None and not photo.match.done:
            raise InputError("this photo is being matched; wait, or cancel that match")
        match = Match(photo, query_of(asked, photo.query), narrowing_of(asked), asked)
        photo.match = match
        await self._engine.work("matches", match.run, self._engine)
        if match.error is not None:
            raise InputError(match.error)
        return JSONResponse(photo.result_json)

    async def _cancel(self, request: Request) -> Response:
        self._photo(request).cancel()
        return JSONResponse({})

    async def _fit(self, request: Request) -> Response:
        photo, asked = self._photo(request), await _json(request)
        return JSONResponse(await self._engine.work("matches", self._fitted, photo, asked))

    def _fitted(self, photo: PagePhoto, asked: Mapping[str, Any]) -> dict[str, Any]:
        query, start = photo.query, pose_of(asked.get("pose"), self._engine.viewer)
        known = known_of(asked)
        searched, fit = photo.result_of(known), self._engine.matcher.fit
        if searched is None:
            found = fit(query_of(known, query), start, narrowing_of(known))
        else:
            found = fit(searched, start)
        if not found.candidates:
            raise InputError(f"{found.refusal}; bring the two skylines closer by hand")
        with photo.lock:
            photo.fitted = found if photo.query is query else None
        return outcome_json(found, self._engine)

    async def _save(self, request: Request) -> Response:
        session, photo, asked = self._session(request), self._photo(request), await _json(request)
        kind = request.path_params["kind"]
        if kind not in KINDS:
            return Response(status_code=404)
        result = chosen_of(asked, photo, self._engine)
        content = await self._engine.work(
            "files", saved, kind, self._engine, photo, result, session.folder
        )
        return Response(content, media_type="application/octet-stream")

    def _session(self, request: Request) -> Session:
        return self._sessions.of(request.path_params["session"])

    def _photo(self, request: Request) -> PagePhoto:
        return self._session(request).photo(request.path_params["photo"])


class _LiveChannel:
    """The channel to one open page: poses in, skylines and the progress of matches out.

    A marker that is dragged sends poses faster than skylines can be rendered, so only the latest
    request of each type is answered.
    """

    def __init__(self, socket: WebSocket, engine: Engine, session: Session) -> None:
        self._socket, self._engine, self._session = socket, engine, session
        self._asked: dict[str, Mapping[str, Any]] = {}
        self._arrived = asyncio.Event()

    async def run(self) -> None:
        """Answer requests until the page closes."""
        await self._socket.accept()
        self._session.pages += 1
        tasks = [asyncio.create_task(self._answer()), asyncio.create_task(self._report())]
        try:
            await self._listen()
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self._session.page_closed()

    async def _listen(self) -> None:
        while self._socket.application_state is not WebSocketState.DISCONNECTED:
            try:
                asked = await self._socket.receive_json()
            except (ValueError, KeyError, RecursionError):
                continue
            if isinstance(asked, Mapping) and asked.get("type") in ["look", "height"]:
                self._asked[str(asked["type"])] = asked
                self._arrived.set()

    async def _answer(self) -> None:
        """Answer requests one after another, of each type the latest only."""
        while True:
            await self._arrived.wait()
            self._arrived.clear()
            while self._asked:
                _, asked = self._asked.popitem()
                try:
                    answer = await self._engine.work("live", self._answered, asked)
                except Exception:
                    # The page reopens a closed channel, but would wait on a silent one.
                    _log.exception("the page asked for %s", asked.get("type"))
                    await self._socket.close(1011)
                    return
                await self._socket.send_json(answer)

    async def _report(self) -> None:
        """Send the progress of matches whenever it has changed."""
        sent: dict[str, Any] = {}
        while True:
            for photo in list(self._session.photos.values()):
                now = photo.match.progress() if photo.match else None
                if now and sent.get(photo.id) != now:
                    sent[photo.id] = now
                    with contextlib.suppress(RuntimeError):
                        await self._socket.send_json({"type": "progress", **now})
            await asyncio.sleep(_PROGRESS_S)

    def _answered(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        same = {"type": asked["type"], "seq": asked.get("seq")}
        try:
            if asked["type"] == "height":
                height_m = self._engine.height_m(number(asked, "lon"), number(asked, "lat"))
                return {**same, "height": height_m}
            return {**same, **self._looked(asked)}
        except SkylineError as error:
            return {**same, "error": str(error)}

    def _looked(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Return the skyline rendered at a pose, its gap to the photo's, and the summits."""
        viewer, photo = self._engine.viewer, self._session.photo(str(asked.get("photo")))
        pose = pose_of(asked.get("pose"), viewer)
        sight = viewer.look(pose, photo.query)
        seen: dict[str, Any] = {
            "column": _rounded(sight.column_px),
            "row": _rounded(sight.row_px),
            "sure": sight.is_sure.astype(int).tolist(),
            "gap": sight.median_gap_deg,
            "elevation": pose.eye_elevation_m,
            **_gaps(sight.gap_deg),
        }
        if asked.get("summits"):
            seen["summits"] = [
                {"label": one.label, "column": one.column_px, "row": one.row_px}
                for one in viewer.summits(pose, photo.query)
            ]
        return seen


def _rounded(values: np.ndarray[Any, np.dtype[np.float64]]) -> list[float | None]:
    """Return values for JSON, with None for NaN."""
    return [round(value, 1) if isfinite(value) else None for value in values.tolist()]


def _gaps(gap_deg: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, Any]:
    """Return evenly spaced columns and the gap in each, degrees."""
    step = max(1, len(gap_deg) // _GAPS)
    columns = np.arange(step // 2, len(gap_deg), step)
    known = columns[np.isfinite(gap_deg[columns])]
    return {"gapColumn": known.tolist(), "gapDeg": np.round(gap_deg[known], 3).tolist()}


def _lines(photo: PagePhoto) -> Response:
    headers = {"ETag": f'"{version_of(photo.query)}"'}
    return Response(photo.lines(), media_type="application/octet-stream", headers=headers)


def _copy(given: Path, path: Path) -> None:
    """Copy a photo of the user's, which may change while the page shows it."""
    try:
        shutil.copyfile(given, path)
    except OSError as error:
        raise InputError(
            f"{given.name} cannot be copied for the page ({error.strerror}); see that it is there "
            "and the disk has room"
        ) from error


def _load_trace(photo: PagePhoto, path: Path) -> None:
    """Take a photo's skyline from a trace; an error of the file calls it the trace."""
    try:
        photo.solve((), read_trace(path))
        photo.trace_text = path.read_text(encoding="utf-8", errors="replace")
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
    """Return the body of a request; raises `TooLargeError` beyond a limit, in bytes."""
    declared = request.headers.get("content-length", "0")
    size, body, parts = int(declared) if declared.isdecimal() else 0, bytearray(), request.stream()
    while size <= limit:
        part = await anext(parts, None)
        if part is None:
            return body
        body += part
        size = max(size, len(body))
    raise TooLargeError(
        f"{name} has {size / _MEGABYTE:.0f} MB or more; the page takes at most "
        f"{limit / _MEGABYTE:.0f} MB: {advice}"
    )
