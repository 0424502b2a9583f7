"""The areas that `locate` keeps: elevation tiles, and a store of places.

An area is the folder ``CACHE/areas/ORIGIN/W_S_E_N``. It holds the store, ``places-DIGEST.h5``, and
the elevation model as it was read, ``places-DIGEST-FORM.terrain``; also ``tiles/``, unless the user
gave the DEM. ORIGIN contains a digest of the source: of a DEM that the user gave, the names, sizes
and times of its files and of the files that GDAL reads beside them, or the heights of a model in
memory. DIGEST covers everything else on which a store's rows depend. A store appears when it is
finished, so a search that finds one needs no server.
"""

import errno
import math
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from glob import glob
from pathlib import Path
from typing import Any, TextIO, cast
from urllib.parse import urlsplit

import numpy as np

from skyline.errors import FetchError, InputError, MissingFileError, SkylineError
from skyline.fetch.dem_tiles import SOURCES, fetch_dem, source_of
from skyline.files.disk import cache_folder, digest_of, version_of
from skyline.files.locks import lock_file
from skyline.geodesy.bounds import Bounds, check_bounds, contains_box, width_deg
from skyline.geodesy.earth import EARTH_RADIUS_M
from skyline.geodesy.map_frame import TRUE_DEG, Frame
from skyline.progress import Progress, Step
from skyline.store.layout import SCHEMA_VERSION
from skyline.store.places import PLACE_CODING
from skyline.survey.build import build_places
from skyline.survey.plans import DEFAULT_LOSSES, DEFAULT_PLACES, map_bounds
from skyline.terrain.dem import Dem, field_in_memory, read_dem
from skyline.terrain.dem_files import Paths, dem_names
from skyline.terrain.field_files import FORMAT, SUFFIX, save_field
from skyline.terrain.heightfield import HeightField
from skyline.terrain.kept_models import remove_models
from skyline.terrain.raster_files import files_of
from skyline.terrain.viewpoints import is_on_map, swap_hint

_SEEN_KM = 30.0
"""Distance past the area to which elevation is fetched. From valleys and slopes hardly any skyline
is farther away: a ridge 1 km above the eye stands 1.8 degrees high there, and nearer ones hide it.
At 100 km a fetch would be nine times as large; refinement knows where the terrain's data ends."""

_LOCK = "lock"
"""Name of the file in an area's folder that is locked while the area is made."""

PrintNote = Callable[[str], None]
"""Prints a line about what is being done."""

Bar = Callable[[Step], AbstractContextManager[Progress | None]]
"""Shows the progress of a step."""


@dataclass(frozen=True, slots=True)
class Area:
    """A box to search.

    A cached store that contains ``needed`` is used; otherwise a store of ``built`` is made.
    """

    needed: Bounds
    built: Bounds

    @classmethod
    def around(
        cls, lonlat_deg: Sequence[tuple[float, float]], built_km: float, needed_km: float
    ) -> "Area":
        """Return the area that contains circles round nearby places."""
        frame = Frame.local(lon=lonlat_deg[0][0], lat=lonlat_deg[0][1])
        east, north = frame.from_lonlat(*np.transpose(lonlat_deg))
        needed, built = (
            frame.box_deg(
                easting_m=np.add.outer(east, [-1000.0 * km, 1000.0 * km]),
                northing_m=np.add.outer(north, [-1000.0 * km, 1000.0 * km]),
            )
            for km in (needed_km, built_km)
        )
        return cls(needed, built)


@dataclass(frozen=True, slots=True)
class CachedArea:
    """A folder of the cache: an area's tiles, terrain and store."""

    folder: Path
    bounds_deg: Bounds

    @property
    def store(self) -> Path:
        """The store of the area's places."""
        return self.folder / _STORE

    @property
    def terrain(self) -> Path:
        """The elevation model as it was read, a file for `skyline.read_dem`."""
        return self.folder / _TERRAIN

    @property
    def is_finished(self) -> bool:
        """Whether the area can be searched."""
        return self.store.is_file() and self.terrain.is_file()

    def to_dict(self) -> dict[str, Any]:
        """Return the area for JSON, with the sizes of its files.

        Raises `FileNotFoundError` where another process has removed it.
        """
        about = []
        for folder, _, names in os.walk(self.folder):
            for path in (Path(folder, name) for name in names):
                with suppress(FileNotFoundError):  # Another process may remove files at any time.
                    about.append((path, path.stat()))
        tiles = [known.st_size for path, known in about if path.parent.name == "tiles"]
        latest = max((known.st_mtime for _, known in about), default=self.folder.stat().st_mtime)
        return {
            "folder": str(self.folder),
            "origin": self.folder.parent.name,
            "bounds_deg": self.bounds_deg,
            "finished": self.is_finished,
            "tiles": len(tiles),
            "tile_bytes": sum(tiles),
            "store_bytes": sum(known.st_size for _, known in about) - sum(tiles),
            "changed": datetime.fromtimestamp(latest).astimezone().isoformat(timespec="seconds"),
        }


def prepare_area(
    area: Area,
    dem: Dem = (),
    source: str | None = None,
    print_note: PrintNote = lambda _: None,
    bar: Bar = lambda _: nullcontext(),
) -> CachedArea:
    """Return an area from the cache; build it if missing.

    ``dem`` is elevation files, folders of them, or a model in memory. Without it, tiles are fetched
    from ``source``, a source of `fetch_dem`, by default `source_of`. Raises `InputError` where the
    DEM does not cover the area, there is only sea, or the cache cannot be written, and `FetchError`
    where a server fails.
    """
    check_bounds(area.built)
    terrain = field_in_memory(dem)
    files = () if terrain is not None else dem_names(cast("Paths", dem))
    source = source_of(source)
    home = areas_folder() / _origin(files if terrain is None else terrain, source)
    with _explained():
        finished = (one for one in _areas_in(home.glob("*")) if one.is_finished)
        serving = [one for one in finished if contains_box(one.bounds_deg, area.needed)]
        if serving:
            made = min(serving, key=lambda one: _km2(one.bounds_deg))
            print_note(f"the area is in the cache already: {made.folder}")
            return made
        folder = home / _name_of(area.built)
        bounds = _bounds_of(folder.name) or area.built
        made = CachedArea(folder, bounds)
        with hold_area(folder, print_note):
            if made.is_finished:
                return made
            is_fetched = terrain is None and not files
            _check_room(folder, bounds, with_tiles=is_fetched)
            print_note(f"the area is kept in the cache: {folder}")
            if is_fetched:
                files = _fetch(folder, bounds, source, print_note, bar)
            if terrain is None:
                with bar(Step.READING):
                    terrain = read_dem(files)
            _check_terrain(terrain, area, is_given=not is_fetched)
            print_note(f"building the store of {_km2(bounds):.0f} km2")
            with bar(Step.BUILDING) as progress:
                built = build_places(terrain, made.store, bounds_deg=bounds, progress=progress)
            save_field(terrain, made.terrain)
            print_note(f"{built.rows} places were built in {built.seconds:.0f} s")
            return made


def store_of(path: Path) -> Path:
    """Return the store in an area's folder; return other paths unchanged."""
    store = path / _STORE
    return store if store.is_file() else path


def title_of(store: Path) -> str:
    """Return a store's name: its file's, or a cached area's bounds."""
    bounds = _bounds_of(store.parent.name) if store.name == _STORE else None
    return store.name if bounds is None else "area " + ",".join(f"{one:.2f}" for one in bounds)


def cached_areas() -> list[CachedArea]:
    """Return the areas in the cache, by origin and bounds."""
    with _explained():
        # Unlike a path's own, this glob passes over folders that another process removes.
        names = glob("*/*", root_dir=areas_folder())  # noqa: PTH207
        return _areas_in(areas_folder() / name for name in names)


def cached_files() -> set[Path]:
    """Return the cache's finished files: tiles, parts of stores, and stores."""
    return {path for kind in ("tif", "h5") for path in areas_folder().rglob(f"[!.]*.{kind}")}


def clear_cache(print_note: PrintNote = lambda _: None) -> int:
    """Remove all areas, and return their number.

    Elevation models that were kept are removed, too. Areas that another process is making stay.
    """
    cleared = 0
    with _explained():
        remove_models()
        for area in cached_areas():
            with hold_area(area.folder) as is_alone:
                if not is_alone:
                    print_note(f"{area.folder} is being made by another skyline, and stays")
                    continue
                # The lock goes last: another process may wait for it.
                for path in area.folder.iterdir():
                    if path.is_dir():
                        shutil.rmtree(path)
                    elif path.name != _LOCK:
                        path.unlink()
                cleared += 1
    return cleared


def areas_folder() -> Path:
    """Return the folder of the cache that holds the areas."""
    return cache_folder() / "areas"


_MAKING = SCHEMA_VERSION, DEFAULT_PLACES, DEFAULT_LOSSES, PLACE_CODING, TRUE_DEG
_STORE = f"places-{digest_of(*_MAKING)}.h5"
"""Name of a store. Releases that would build different stores give it different names."""
_TERRAIN = f"{Path(_STORE).stem}-{FORMAT}{SUFFIX}"
"""Name of an elevation model. An area whose model has another form is completed anew."""


def _origin(dem: Sequence[str] | HeightField, source: str) -> str:
    """Return the name of the folder for a DEM's areas.

    The DEM is files or a field; without either it comes from a source.
    """
    if isinstance(dem, HeightField):
        return f"dem-{digest_of(dem.digest)}"
    if not dem:
        template = SOURCES.get(source, source)
        name = source if source in SOURCES else urlsplit(template).hostname or "source"
        return f"{name}-{digest_of(template)}"
    read = dict.fromkeys(one for file in dem for one in (file, *files_of(file)))
    return f"dem-{digest_of(*((file, version_of(file)) for file in read))}"


def _seen_from(bounds_deg: Bounds) -> Bounds:
    """Return the box with the terrain that is seen from an area."""
    west, south, _, north = bounds_deg
    east = west + width_deg(bounds_deg)
    frame = Frame.local(lon=(west + east) / 2.0, lat=(south + north) / 2.0)
    left, low, right, high = frame.rectangle_m(bounds_deg)
    margin_m = 1000.0 * _SEEN_KM
    return frame.box_deg(
        easting_m=[left - margin_m, right + margin_m], northing_m=[low - margin_m, high + margin_m]
    )


def _km2(bounds_deg: Bounds) -> float:
    _, south, _, north = bounds_deg
    height, width = math.radians(north - south), math.radians(width_deg(bounds_deg))
    radius_km = EARTH_RADIUS_M / 1e3
    middle = math.radians((south + north) / 2.0)
    return radius_km**2 * height * width * math.cos(middle)


def _name_of(bounds_deg: Bounds) -> str:
    """Return the name of an area's folder.

    The name has the area's bounds, rounded outwards to a kilometre.
    """
    rounded = [math.floor(100.0 * side) for side in bounds_deg[:2]]
    rounded += [math.ceil(100.0 * side) for side in bounds_deg[2:]]
    limits = (18000, 9000, 18000, 9000)
    within = (min(max(side, -most), most) for side, most in zip(rounded, limits, strict=True))
    return "_".join(f"{side / 100.0:.2f}" for side in within)


def _bounds_of(name: str) -> Bounds | None:
    """Return the bounds in a folder's name; None where it has none."""
    try:
        west, south, east, north = map(float, name.split("_"))
        return check_bounds((west, south, east, north))
    except ValueError:
        return None


def _areas_in(folders: Iterable[Path]) -> list[CachedArea]:
    """Return the areas among folders, in the order of their bounds."""
    named = ((folder, _bounds_of(folder.name)) for folder in sorted(folders))
    return [CachedArea(folder, bounds) for folder, bounds in named if bounds is not None]


def _fetch(
    folder: Path, bounds: Bounds, source: str, print_note: PrintNote, bar: Bar
) -> tuple[str, ...]:
    """Fetch tiles of all terrain seen from an area; return the files."""
    seen = _seen_from(bounds)
    where = ",".join(f"{side:.2f}" for side in seen)
    print_note(
        f"fetching elevation of {where} from {source if source in SOURCES else 'the source'}"
    )
    earlier = [one / "tiles" for one in folder.parent.iterdir() if one != folder]
    try:
        with bar(Step.FETCHING) as progress:
            done = fetch_dem(seen, source, folder / "tiles", progress=progress, earlier=earlier)
    except FetchError as error:
        raise FetchError(f"{error}; or give elevation files with --dem") from error
    if done.missing:
        print_note(f"the source has no tile (usually sea) for {', '.join(done.missing)}")
    return tuple(str(path) for path in done.files)


def _check_terrain(terrain: HeightField, area: Area, is_given: bool) -> None:
    """Refuse terrain that is all sea, or lacks an area's middle."""
    lon = area.needed[0] + width_deg(area.needed) / 2.0
    lat = (area.needed[1] + area.needed[3]) / 2.0
    if not is_on_map(terrain, *terrain.frame.from_lonlat(lon, lat)):
        covered = ",".join(f"{side:.4f}" for side in terrain.box_deg)
        place = np.round([[lon], [lat]], 4)
        remedy = swap_hint(terrain, *place) or (
            "; give elevation of the place with --dem, or another --near"
        )
        raise InputError(f"the DEM covers {covered}, and not the place {lon:.4f},{lat:.4f}{remedy}")
    west, south, east, north = map_bounds(terrain, area.needed)
    rows, cols = terrain.to_grid(easting_m=[west, east], northing_m=[north, south])
    top, bottom = np.rint(rows).astype(int)
    left, right = np.rint(cols).astype(int)
    inside = terrain.part(slice(top, bottom + 1), slice(left, right + 1))
    if not np.any(np.isfinite(inside) & (inside != 0.0)):
        raise InputError(
            f"round {lon:.4f},{lat:.4f} the elevation model has nothing but sea or holes; give "
            f"another --near{', or another --dem' if is_given else ''}"
        )


def _check_room(folder: Path, bounds: Bounds, with_tiles: bool) -> None:
    # The greatest usual size of a store is 200 kB for a square kilometre.
    wanted = 200_000 * _km2(bounds)
    if with_tiles:
        # Tiles of 1 arc-second, and the terrain that is read from them: 4 bytes a sample each.
        _, south, _, north = seen = _seen_from(bounds)
        wanted += 8 * 3600**2 * (north - south) * width_deg(seen)
    free = shutil.disk_usage(folder).free
    if free < wanted:
        raise _unwritable(f"{free / 1e6:.0f} MB are free, and this may take {wanted / 1e6:.0f} MB")


def _unwritable(reason: str) -> InputError:
    return InputError(
        f"the cache {cache_folder()} cannot be used ({reason}); name another folder with "
        "SKYLINE_CACHE, or make room with `skyline cache --clear`"
    )


@contextmanager
def _explained() -> Iterator[None]:
    """Turn errors of a full or read-only disk into an `InputError`."""
    no_room = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
    no_rights = {errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR, errno.EEXIST}
    try:
        yield
    except (MissingFileError, FetchError):
        raise
    except (SkylineError, OSError) as error:
        cause: BaseException | None = error
        while cause is not None:
            if isinstance(cause, OSError) and cause.errno in no_room | no_rights:
                raise _unwritable(os.strerror(cause.errno or 0)) from error
            cause = cause.__cause__
        raise


@contextmanager
def hold_area(folder: Path, print_note: PrintNote | None = None) -> Iterator[bool]:
    """Hold an area's lock; yield whether it was obtained.

    The folder is made if it is missing. With ``print_note`` the function waits for another process,
    else it gives up at once. A folder that contains only the lock at the end is removed.
    """
    file = _lock(folder, print_note)
    with nullcontext() if file is None else file:
        try:
            yield file is not None
        finally:
            if file is not None:
                _remove_unused(folder)


def _lock(folder: Path, print_note: PrintNote | None) -> TextIO | None:
    """Return the open file of an area's lock.

    None if another process has the lock.
    """
    before_waiting = None
    if print_note is not None:
        before_waiting = partial(
            print_note, f"waiting for another skyline, which is making {folder}"
        )
    for _ in range(1000):
        # Another process may remove the folder at any time: mkdir raises either error then.
        with suppress(FileNotFoundError, FileExistsError):
            folder.mkdir(parents=True, exist_ok=True)
            return lock_file(folder / _LOCK, before_waiting)
    raise _unwritable(f"{folder} cannot be made, or is removed at once")


def _remove_unused(folder: Path) -> None:
    """Remove an area's folder if it has nothing but the held lock."""
    with suppress(OSError):
        (folder / "tiles").rmdir()
    with suppress(OSError):
        if [path.name for path in folder.iterdir()] == [_LOCK]:
            (folder / _LOCK).unlink()
            folder.rmdir()
            folder.parent.rmdir()
