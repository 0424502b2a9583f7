"""The engine that all sessions share: areas, renderer and threads."""

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
from skyline.progress import Progress, Step, StepProgress
from skyline.web.area import PageArea, area_id, shown_name

T = TypeVar("T")

_WORKERS = {"photos": 2, "strokes": 2, "matches": 3, "live": 4, "files": 1}
"""Number of threads of each kind of work; no kind waits for another."""


class Engine:
    """The areas in which the photos of all sessions are searched.

    Raises `SkylineError` if the stores, their DEM or the gazetteer cannot be used.

    Parameters
    ----------
    stores : sequence of Path
        Stores of one DEM, searched as one. Without any, the area of each photo is in the cache,
        and is made when its place is first searched.
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
        self.photos = _by_name(photos)
        self.thread = RenderThread()
        self._dem = dem
        self._peaks = peaks
        self.area = None
        self.areas: dict[str, PageArea] = {}
        self._making = threading.Lock()
        if stores:
            try:
                self.area = self._opened(stores, dem)
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
            "area": self.area and self.area.about,
            "given": list(self.photos),
        }

    def area_for(self, photo: Path, narrowing: Narrowing, report: StepProgress) -> PageArea:
        """Return the area in which a photo is searched.

        It is the area of the narrowing, or else of the photo's own position, made if it is missing.
        Raises as `skyline.locate`, and what ``report`` raises.
        """
        if self.area is not None:
            return self.area
        box, _ = area_of([photo], narrowing)

        @contextmanager
        def bar(step: Step) -> Iterator[Progress]:
            report(step, 0.0)
            yield lambda done, total: report(step, done / max(1, total))

        with self._making:
            make = partial(prepare_area, box, self._dem or (), bar=bar)
            ready = self.thread.run(make)
            return self._opened([ready.store], [str(ready.terrain)])

    def _opened(self, stores: Sequence[Path], dem: list[str] | None) -> PageArea:
        """Return the area of stores, opened only once."""
        name = area_id(stores)
        if name not in self.areas:
            self.areas[name] = PageArea(stores, dem, self._peaks, self.thread)
        return self.areas[name]

    def close(self) -> None:
        """End all work, close the stores and release the renderer."""
        for pool in self._pools.values():
            pool.shutdown(cancel_futures=True)
        for area in self.areas.values():
            area.close()
        self.thread.close()


def _by_name(photos: Sequence[Path]) -> dict[str, Path]:
    """Return photos by the names that the page shows.

    The second ``IMG.jpg``, of another folder, is ``IMG (2).jpg``.
    """
    named: dict[str, Path] = {}
    for path in photos:
        numbers = (f" ({count})" if count > 1 else "" for count in range(1, len(photos) + 1))
        names = (shown_name(path.stem + number + path.suffix) for number in numbers)
        named[next(name for name in names if name not in named)] = path
    return named
