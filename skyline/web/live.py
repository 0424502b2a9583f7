"""The live channel: poses in, skylines and progress of matches out."""

import asyncio
import contextlib
import logging
from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from skyline import SkylineError
from skyline.web.engine import Engine
from skyline.web.messages import number, pose_of
from skyline.web.sessions import Session

_log = logging.getLogger(__name__)

_PROGRESS_S = 0.15
"""Interval between two reports of the progress of matches."""
_GAPS = 240
"""Number of columns whose gap between the skylines is sent."""


class LiveChannel:
    """The channel to one open page.

    A dragged marker sends poses faster than skylines can be rendered, so only the latest request of
    each type is answered.
    """

    def __init__(self, socket: WebSocket, engine: Engine, session: Session) -> None:
        self._socket = socket
        self._engine = engine
        self._session = session
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
        """Answer the latest request of each type, one after another."""
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
                area = self._engine.areas.get(str(asked.get("area")))
                at = number(asked, "lon"), number(asked, "lat")
                height_m = None if area is None else area.height_m(*at)
                return {**same, "height_m": height_m}
            return {**same, **self._looked(asked)}
        except SkylineError as error:
            return {**same, "error": str(error)}

    def _looked(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Return the skyline at a pose, its gaps, and the summits.

        The gaps lie between this skyline and the photo's.
        """
        photo = self._session.photo(str(asked.get("photo")))
        viewer = photo.area.viewer
        pose = pose_of(asked.get("pose"), photo.skyline, viewer)
        sight = viewer.look(pose, photo.skyline)
        seen: dict[str, Any] = {
            "column_px": _rounded(sight.column_px),
            "row_px": _rounded(sight.row_px),
            "is_sure": sight.is_sure.astype(int).tolist(),
            "median_gap_deg": sight.median_gap_deg,
            **_gaps(sight.gap_deg),
        }
        if asked.get("summits"):
            seen["summits"] = [
                {"label": one.label, "column_px": one.column_px, "row_px": one.row_px}
                for one in viewer.summits(pose, photo.skyline)
            ]
        return seen


def _rounded(values: NDArray[np.float64]) -> list[float | None]:
    """Return values for JSON, with None for NaN."""
    return [round(value, 1) if isfinite(value) else None for value in values.tolist()]


def _gaps(gap_deg: NDArray[np.float64]) -> dict[str, Any]:
    """Return evenly spaced columns and the gap in each, degrees."""
    step = max(1, len(gap_deg) // _GAPS)
    columns = np.arange(step // 2, len(gap_deg), step)
    known = columns[np.isfinite(gap_deg[columns])]
    return {"gap_column_px": known.tolist(), "gap_deg": np.round(gap_deg[known], 3).tolist()}
