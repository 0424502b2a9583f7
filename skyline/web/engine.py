"""The engine that all sessions share: stores, renderer and threads."""

import asyncio
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from skyline import (
    InputError,
    Matcher,
    Pose,
    ReliefTiles,
    RenderThread,
    SkylineError,
    Viewer,
    read_peaks,
    stand_at,
)

T = TypeVar("T")

_WORKERS = {"photos": 2, "strokes": 2, "matches": 3, "live": 4, "files": 1}
"""Number of threads of each kind of work; no kind waits for another."""
_NAME_LENGTH = 100


class Engine:
    """Stores opened for many sessions at a time.

    Raises `SkylineError` if the stores, their DEM or the gazetteer cannot be used.

    Parameters
    ----------
    stores : sequence of Path
        Stores of one DEM, searched as one.
    dem : list of str, optional
        Files of that DEM, if they have moved since the stores were built.
    photos : sequence of Path
        Photos at the start of every session's list.
    peaks : Path, optional
        Gazetteer of summits; see `skyline.read_peaks`.
    """

    def __init__(
        self,
        stores: Sequence[Path],
        dem: list[str] | None,
        photos: Sequence[Path],
        peaks: Path | None,
    ) -> None:
        self.stores = stores
        self.photos = photos
        self.thread = RenderThread()
        try:
            self.matcher = Matcher(stores, dem, render_thread=self.thread)
            self.peaks = None if peaks is None else read_peaks(peaks, self.matcher.frame)
            self.relief = None
            self._viewer = None
            if self.matcher.terrain is not None:
                curvature = self.matcher.header.curvature
                self.relief = ReliefTiles(self.matcher.terrain)
                self._viewer = Viewer(
                    self.matcher.terrain, self.peaks, curvature=curvature, render_thread=self.thread
                )
        except SkylineError:
            self.thread.close()
            raise
        self._pools = {
            name: ThreadPoolExecutor(count, thread_name_prefix=name)
            for name, count in _WORKERS.items()
        }

    @property
    def viewer(self) -> Viewer:
        """The terrain as cameras see it; raises `InputError` without the stores' DEM."""
        if self._viewer is None:
            raise InputError("the store's DEM is not at hand; start skyline serve with --dem DEM")
        return self._viewer

    async def work(self, kind: str, task: Callable[..., T], *arguments: Any) -> T:
        """Run a task on a thread of its kind of work."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._pools[kind], task, *arguments)

    def about(self) -> dict[str, Any]:
        """Return the facts about the stores that the page shows."""
        eyes = self.matcher.viewpoints
        return {
            "store": ", ".join(shown_name(path.name) for path in self.stores),
            "places": self.matcher.rows,
            "area": list(
                self.matcher.frame.box_deg(easting_m=eyes.easting_m, northing_m=eyes.northing_m)
            ),
            "terrain": self.relief and list(self.relief.bounds_deg),
            "peaks": self._viewer is not None and self.peaks is not None,
            "given": [shown_name(path.name) for path in self.photos],
        }

    def height_m(self, lon: float, lat: float) -> float | None:
        """Return the terrain's height at a position; None where unknown."""
        terrain = self.matcher.terrain
        if terrain is None:
            return None
        height = float(terrain.height_at(lon=lon, lat=lat))
        return height if np.isfinite(height) else None

    def eye_height_m(self, pose: Pose) -> float | None:
        """Return the height of a pose's eye above the ground.

        It is the height that `Viewer.pose` takes. An eye below the surface counts as on it. Without
        terrain the height is None.
        """
        surface_m = self.height_m(pose.lon, pose.lat)
        if surface_m is None or self.matcher.terrain is None:
            return None
        ground = stand_at(self.matcher.terrain, lon=pose.lon, lat=pose.lat, eye_height_m=0.0)
        return max(surface_m, pose.eye_elevation_m) - float(ground.eye_elevation_m[0])

    def close(self) -> None:
        """End all work, close the store and release the renderer."""
        for pool in self._pools.values():
            pool.shutdown(cancel_futures=True)
        if self._viewer is not None:
            self._viewer.close()
        self.matcher.close()
        self.thread.close()


def shown_name(name: str) -> str:
    """Return a file's name as the page shows it.

    It has no folders and no control characters.
    """
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    plain = "".join(letter for letter in last if letter.isprintable()).strip()
    return plain[-_NAME_LENGTH:] or "photo"
