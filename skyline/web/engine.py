"""The engine that all sessions share: grounds, renderer and threads."""

import asyncio
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from skyline import Narrowing, RenderThread, SkylineError
from skyline.cache import prepare_area
from skyline.location import area_of
from skyline.web.ground import Ground, shown_name

T = TypeVar("T")

ReportProgress = Callable[[str, float], None]
"""Called with the name of a step, and its finished share."""

_WORKERS = {"photos": 2, "strokes": 2, "matches": 3, "live": 4, "files": 1}
"""Number of threads of each kind of work; no kind waits for another."""


class Engine:
    """Grounds for many sessions: the given one, or the photos' areas.

    Raises `SkylineError` if the stores, their DEM or the gazetteer cannot be used.

    Parameters
    ----------
    stores : sequence of Path
        Stores of one DEM, searched as one. Without any, the ground of each photo is its area in the
        cache, which is made when its place is first searched.
    dem : list of str, optional
        Files of the stores' DEM, if they have moved; without stores, the elevation of the areas,
        which by default is fetched.
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
        self.photos = photos
        self.thread = RenderThread()
        self._dem = dem
        self._peaks = peaks
        self.ground = None
        self.grounds: dict[str, Ground] = {}
        self._making = threading.Lock()
        if stores:
            try:
                self.ground = self._opened(stores, dem)
            except SkylineError:
                self.thread.close()
                raise
        self._pools = {
            name: ThreadPoolExecutor(count, thread_name_prefix=name)
            for name, count in _WORKERS.items()
        }

    async def work(self, kind: str, task: Callable[..., T], *arguments: Any) -> T:
        """Run a task on a thread of its kind of work."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._pools[kind], task, *arguments)

    def about(self) -> dict[str, Any]:
        """Return facts about the stores and photos that the command names."""
        return {
            "ground": self.ground and self.ground.about,
            "given": [shown_name(path.name) for path in self.photos],
        }

    def ground_for(self, photo: Path, narrowing: Narrowing, report: ReportProgress) -> Ground:
        """Return the ground in which a photo is searched.

        It is the area of the narrowing, or else of the photo's own position, made if it is missing.
        Raises as `skyline.locate`, and what ``report`` raises.
        """
        if self.ground is not None:
            return self.ground
        area, _ = area_of([photo], narrowing)

        @contextmanager
        def bar(step: str) -> Iterator[Callable[[int, int], None]]:
            report(step, 0.0)
            yield lambda done, total: report(step, done / max(1, total))

        with self._making:
            make = partial(prepare_area, area, self._dem or (), bar=bar)
            ready = self.thread.run(make)
            return self._opened([ready.store], [str(ready.terrain)])

    def _opened(self, stores: Sequence[Path], dem: list[str] | None) -> Ground:
        """Return the ground of stores, opened only once."""
        named = {str(one.stores): one for one in self.grounds.values()}
        ground = named.get(str(stores)) or Ground(stores, dem, self._peaks, self.thread)
        self.grounds[ground.id] = ground
        return ground

    def close(self) -> None:
        """End all work, close the stores and release the renderer."""
        for pool in self._pools.values():
            pool.shutdown(cancel_futures=True)
        for ground in self.grounds.values():
            ground.close()
        self.thread.close()
