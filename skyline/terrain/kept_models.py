"""Elevation models that are kept for later runs.

A later run maps a model into memory as it was read, and does not open its files. A model is kept in
the cache under a digest of all that its heights depend on: the names, sizes and times of its files
and of files beside them, the options, the code that reads them, and the settings and the grids of
datum shifts of its libraries.
"""

import logging
import os
import shutil
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

from pyproj.datadir import get_data_dir, get_user_data_dir  # type: ignore[attr-defined]

from skyline.errors import SkylineError
from skyline.files.disk import STORE_SUFFIXES, cache_folder, digest_of, is_file, version_of
from skyline.files.gdal_names import archive_of
from skyline.terrain.field_files import SUFFIX, LoggedWarning, read_field, save_dem
from skyline.terrain.heightfield import HeightField, field_of
from skyline.terrain.metric_dem import MetricDem
from skyline.terrain.provenance import DemOptions

_OF_ITS_OWN = (".tif", ".tiff", ".hgt", ".asc", ".bil", ".flt", ".img")
"""Endings of formats that refer only to files whose names begin like their own."""

_LEAST_SAMPLES = 1 << 20
"""The smallest model that is kept; smaller ones are read in a tenth of a second."""

_MOST_OF_FREE = 0.1
"""The greatest share of the disk's free space that all kept models take."""

_CODE = (Path(__file__).parent, Path(__file__).parents[1] / "geodesy")
"""The code on which heights depend."""

_LIBRARIES = ("numpy", "pyproj", "rasterio", "scipy")
"""The libraries on which heights depend; GDAL and PROJ come with two of them."""

_LEVEL_LOCK = threading.Lock()
"""Held while the level of the terrain's logger may differ from the user's."""

_log = logging.getLogger(__name__)


def models_folder() -> Path:
    """Return the folder of kept models, which may not exist yet."""
    return cache_folder() / "models"


def kept_bytes() -> int:
    """Return how much of the disk all kept models take."""
    return sum(size for size, _ in _kept())


def remove_models() -> None:
    """Remove all kept models.

    Runs that use one keep what they have opened.
    """
    for _, path in _kept():
        path.unlink(missing_ok=True)


def _kept() -> list[tuple[int, Path]]:
    """Return kept models' sizes and files, least recently used first."""
    known = []
    for path in models_folder().glob("*"):
        with suppress(FileNotFoundError):
            if not path.is_dir():  # Someone else's
                known.append((path.stat(), path))
    known.sort(key=lambda one: one[0].st_mtime)
    return [(512 * about.st_blocks, path) for about, path in known]


def path_of(names: Sequence[str], options: DemOptions) -> Path | None:
    """Return where the model of some files is kept.

    Returns None for files that may change unnoticed.
    """
    beside: dict[Path, dict[str, list[Path]]] = {}
    files: list[Path] = []
    try:
        for name in names:
            path = Path(name)
            if not _stands_alone(name):
                return None
            if path.parent not in beside:
                beside[path.parent] = _by_stem(path.parent)
            files += [path, *beside[path.parent].get(_stem(path), [])]
    except OSError:  # A folder that cannot be listed, or a file that cannot be read
        return None
    read = [(str(file), os.path.realpath(file), version_of(file)) for file in dict.fromkeys(files)]
    code = [one for folder in _CODE for one in sorted(folder.glob("*.py"))]
    folders = [*get_data_dir().split(os.pathsep), get_user_data_dir()]
    shifts = [one for folder in folders for one in sorted(Path(folder).glob("*.tif"))]
    digest = digest_of(
        list(names),
        read,
        options,
        [(str(file), version_of(file)) for file in [*code, *shifts]],
        [(one, version(one)) for one in _LIBRARIES],
        _settings(),
        digits=24,
    )
    return models_folder() / f"{digest}{SUFFIX}"


def _settings() -> list[tuple[str, str]]:
    """Return the environment's settings of GDAL and PROJ.

    The paths of certificates, which rasterio sets when it is loaded, are left out.
    """
    beginnings = ("CPL_", "GDAL_", "GTIFF_", "OSR_", "PROJ_")
    named = ((name, value) for name, value in os.environ.items() if name.startswith(beginnings))
    return sorted((name, value) for name, value in named if "_CURL_" not in name)


def _stands_alone(name: str) -> bool:
    """Return whether a raster depends only on files of its own name."""
    is_known = name.lower().removesuffix(".gz").endswith(_OF_ITS_OWN)
    if not is_known or archive_of(name) or not is_file(name):
        return False
    with Path(name).open("rb") as file:
        # GDAL goes by the content: a virtual raster (XML or JSON) may have any ending.
        return file.read(256).lstrip(b"\xef\xbb\xbf \t\r\n")[:1] not in (b"<", b"{")


def _by_stem(folder: Path) -> dict[str, list[Path]]:
    """Return a folder's files by their names' beginnings, without stores."""
    found: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix not in STORE_SUFFIXES:
            found.setdefault(_stem(path), []).append(path)
    return found


def _stem(path: Path) -> str:
    """Return the beginning of a name in lower case.

    GDAL finds ``DEM.PRJ`` for ``dem.tif``.
    """
    return path.name.split(".")[0].lower()


def kept_model(path: Path) -> HeightField | None:
    """Return the model that is kept at a path, or None."""
    if not is_file(path):
        return None
    try:
        return read_field(path)
    except SkylineError as error:
        _log.debug("%s", error)
        return None


def keep_model(dem: MetricDem, path: Path, warnings: Sequence[LoggedWarning]) -> HeightField:
    """Keep a model that was read, and return it.

    A small model, or one for which the disk has no room, stays only in memory.
    """
    if dem.grid.rows * dem.grid.cols < _LEAST_SAMPLES:
        return field_of(dem)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not _has_room(path.parent, dem):
            return field_of(dem)
        save_dem(dem, path, warnings)
        return read_field(path, dem)
    except (OSError, SkylineError) as error:
        _log.debug("%s is not kept: %s", path, error)
        return field_of(dem)


def _has_room(folder: Path, dem: MetricDem) -> bool:
    """Make room for another model, and return whether there is any.

    The least recently used models are removed.
    """
    samples = dem.grid.rows * dem.grid.cols
    if dem.source is not None:
        samples += dem.source.heights_m.size
    known = _kept()
    taken = sum(size for size, _ in known)
    left = _MOST_OF_FREE * (shutil.disk_usage(folder).free + taken) - 4 * samples
    if left < 0.0:
        return False
    for size, path in known:
        if taken <= left:
            break
        path.unlink(missing_ok=True)
        taken -= size
    return True


@contextmanager
def noted_warnings() -> Iterator[list[LoggedWarning]]:
    """Collect the warnings that this thread logs about terrain.

    They are collected even if they are not shown, since a later run may show them. Other threads
    wait for the end of the block, since the level of a logger holds for the whole process.
    """
    noted: list[LoggedWarning] = []
    thread = threading.get_ident()
    package = logging.getLogger("skyline.terrain")
    # Filters and not a handler: a process without handlers shows warnings, too.
    loggers = [logging.getLogger(f"{package.name}.{one.stem}") for one in _CODE[0].glob("*.py")]
    with _LEVEL_LOCK:
        is_shown = package.isEnabledFor(logging.WARNING)
        level = package.level

        def note(record: logging.LogRecord) -> bool:
            if record.thread == thread and record.levelno >= logging.WARNING:
                noted.append((record.name, record.getMessage()))
            return is_shown

        if not is_shown:
            package.setLevel(logging.WARNING)
        for logger in loggers:
            logger.addFilter(note)
        try:
            yield noted
        finally:
            for logger in loggers:
                logger.removeFilter(note)
            package.setLevel(level)
