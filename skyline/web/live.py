"""The channel between a page and the server: poses in, skylines out, the latest alone.

A person who drags a marker asks faster than anything can answer. What has been asked before the
last question is not answered: the skyline stays with the hand.
"""

import asyncio
import contextlib
import logging
from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from skyline import SkylineError
from skyline.web.asked import number, pose_of
from skyline.web.engine import Engine
from skyline.web.sessions import Session

_log = logging.getLogger(__name__)

_TOLD_S = 0.15
"""How often a page is told how far its matches have come."""
_GAPS = 240
"""Columns of a photo for which the gap between the skylines is told."""


class LiveChannel:
    """One open page."""

    def __init__(self, socket: WebSocket, engine: Engine, session: Session) -> None:
        self._socket, self._engine, self._session = socket, engine, session
        self._asked: dict[str, Mapping[str, Any]] = {}
        self._news = asyncio.Event()

    async def run(self) -> None:
        """Answer until the page closes."""
        await self._socket.accept()
        self._session.came()
        tasks = [asyncio.create_task(self._answer()), asyncio.create_task(self._tell())]
        try:
            await self._listen()
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self._session.left()

    async def _listen(self) -> None:
        while self._socket.application_state is not WebSocketState.DISCONNECTED:
            try:
                asked = await self._socket.receive_json()
            except (ValueError, KeyError):
                continue
            if isinstance(asked, Mapping) and asked.get("type") in {"look", "height"}:
                self._asked[str(asked["type"])] = asked
                self._news.set()

    async def _answer(self) -> None:
        while True:
            await self._news.wait()
            self._news.clear()
            while self._asked:
                _, asked = self._asked.popitem()
                try:
                    answer = await self._engine.work("live", self._answered, asked)
                except Exception:
                    # The page opens the channel again, which a silent one would not bring about.
                    _log.exception("the page asked for %s", asked.get("type"))
                    await self._socket.close(1011)
                    return
                await self._socket.send_json(answer)

    async def _tell(self) -> None:
        """Say how far the matches have come, each until it is done."""
        told: dict[str, Any] = {}
        while True:
            for photo_id, match in list(self._session.matches.items()):
                now = match.told()
                if told.get(photo_id) != now:
                    told[photo_id] = now
                    with contextlib.suppress(RuntimeError):
                        await self._socket.send_json({"type": "progress", **now})
            await asyncio.sleep(_TOLD_S)

    def _answered(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        same = {"type": asked["type"], "seq": asked.get("seq")}
        try:
            if asked["type"] == "height":
                height_m = self._engine.height_m(number(asked, "lon"), number(asked, "lat"))
                return {**same, "height": height_m}
            return {**same, **self._looked(asked)}
        except (SkylineError, KeyError) as error:
            return {**same, "error": str(error)}

    def _looked(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        viewer = self._engine.viewer
        photo = self._session.photos[str(asked.get("photo"))]
        if viewer is None or photo.query is None:
            return {"error": "there is nothing to render with: the store's DEM is not at hand"}
        pose = pose_of(asked.get("pose"), viewer)
        sight = viewer.look(pose, photo.query)
        told: dict[str, Any] = {
            "column": _rounded(sight.column_px),
            "row": _rounded(sight.row_px),
            "sure": sight.is_sure.astype(int).tolist(),
            "gap": sight.median_gap_deg,
            "elevation": pose.eye_elevation_m,
            **_gaps(sight.gap_deg),
        }
        if asked.get("summits"):
            told["summits"] = [
                {"label": one.label, "column": one.column_px, "row": one.row_px}
                for one in viewer.summits(pose, photo.query)
            ]
        return told


def _rounded(values: np.ndarray[Any, np.dtype[np.float64]]) -> list[float | None]:
    """Return values for JSON, which has no NaN."""
    return [round(value, 1) if isfinite(value) else None for value in values.tolist()]


def _gaps(gap_deg: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, Any]:
    """Return evenly chosen columns and the gap of each, degrees."""
    step = max(1, len(gap_deg) // _GAPS)
    columns = np.arange(step // 2, len(gap_deg), step)
    known = columns[np.isfinite(gap_deg[columns])]
    return {"gapColumn": known.tolist(), "gapDeg": np.round(gap_deg[known], 3).tolist()}
