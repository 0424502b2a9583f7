"""Elevation models that are kept for later runs.

A later run maps a model into memory as it was read, and does not open its files. A model is kept in
the cache under a digest of all that its heights depend on: the names, sizes and times of its files
and of files beside them, the options, and the code that reads them.
"""

import hashlib
import logging
import os
import shutil
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

from skyline.errors import SkylineError
from skyline.files import archive_of, cache_folder, is_file, version_of
from skyline.terrain.field_files import SUFFIX, LoggedWarning, read_field, save_dem
from skyline.terrain.heightfield import HeightField, field_of
from skyline.terrain.metric_dem import MetricDem
from skyline.terrain.provenance import DemOptions

_OF_ITS_OWN = (".tif", ".tiff", ".hgt", ".asc", ".bil", ".flt", ".img")
"""Endings of formats that refer to no files but those that begin with their own name."""

_LEAST_SAMPLES = 1 << 20
"""The smallest model that is kept; smaller ones are read in a tenth of a second."""

_MOST_OF_FREE = 0.1
"""The greatest share of the disk's free space that all kept models take."""

_CODE = (Path(__file__).parent, Path(__file__).parents[1] / "geodesy")
"""The code on which heights depend."""

_LIBRARIES = ("numpy", "pyproj", "rasterio", "scipy")
"""The libraries on which heights depend; GDAL and PROJ come with two of them."""

_log = logging.getLogger(__name__)


def models_folder() -> Path:
    """Return the folder of kept models, which may not exist yet."""
    return cache_folder() / "models"


def kept_bytes() -> int:
    """Return how much of the disk all kept models take."""
    return sum(512 * about.st_blocks for about, _ in _kept())


def remove_models() -> None:
    """Remove all kept models.

    Runs that use one keep what they have opened.
    """
    for _, path in _kept():
        path.unlink(missing_ok=True)


def _kept() -> list[tuple[os.stat_result, Path]]:
    """Return the files of kept models, the least recently used first."""
    known = []
    for path in models_folder().glob("*"):
        with suppress(FileNotFoundError):
            known.append((path.stat(), path))
    return sorted(known, key=lambda one: one[0].st_mtime)


def place_of(names: Sequence[str], options: DemOptions) -> Path | None:
    """Return where the model of some files is kept.

    It is None for files that may change unnoticed.
    """
    beside: dict[Path, dict[str, list[Path]]] = {}
    files: list[Path] = []
    for name in names:
        path = Path(name)
        is_known = name.lower().removesuffix(".gz").endswith(_OF_ITS_OWN)
        if not is_known or archive_of(name) or not is_file(name):
            return None
        if path.parent not in beside:
            beside[path.parent] = _by_stem(path.parent)
        files += beside[path.parent][_stem(path)]
    versions = [(str(file), version_of(file)) for file in dict.fromkeys(files)]
    code = [(str(one), version_of(one)) for folder in _CODE for one in sorted(folder.glob("*.py"))]
    libraries = [(one, version(one)) for one in _LIBRARIES]
    parts = repr((list(names), versions, options, code, libraries))
    digest = hashlib.sha256(parts.encode("utf-8", "surrogateescape")).hexdigest()[:24]
    return models_folder() / f"{digest}{SUFFIX}"


def _by_stem(folder: Path) -> dict[str, list[Path]]:
    """Return the files of a folder by the beginning of their names, without stores."""
    found: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix != ".h5":
            found.setdefault(_stem(path), []).append(path)
    return found


def _stem(path: Path) -> str:
    return path.name.split(".")[0]


def kept_model(place: Path) -> HeightField | None:
    """Return the model that is kept at a place, or None."""
    if not place.is_file():
        return None
    try:
        return read_field(place)
    except SkylineError as error:
        _log.debug("%s", error)
        return None


def keep_model(dem: MetricDem, place: Path, warnings: Sequence[LoggedWarning]) -> HeightField:
    """Keep a model that was read, and return it.

    A small one, and one for which the disk has no room, stays in memory alone.
    """
    if dem.grid.rows * dem.grid.cols < _LEAST_SAMPLES:
        return field_of(dem)
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        if not _has_room(place.parent, dem):
            return field_of(dem)
        save_dem(dem, place, warnings)
        return read_field(place, dem)
    except (OSError, SkylineError) as error:
        _log.debug("%s is not kept: %s", place, error)
        return field_of(dem)


def _has_room(folder: Path, dem: MetricDem) -> bool:
    """Make room for another model, and return whether there is any.

    The models that were used longest ago are removed.
    """
    samples = dem.grid.rows * dem.grid.cols
    if dem.source is not None:
        samples += dem.source.heights_m.size
    known = _kept()
    taken = sum(512 * about.st_blocks for about, _ in known)
    left = _MOST_OF_FREE * (shutil.disk_usage(folder).free + taken) - 4 * samples
    for about, path in known:
        if taken <= left:
            break
        path.unlink(missing_ok=True)
        taken -= 512 * about.st_blocks
    return left >= 0.0


@contextmanager
def noted_warnings() -> Iterator[list[LoggedWarning]]:
    """Collect the warnings that this thread logs about terrain in the block.

    They are collected even if they are not shown, since a later run may show them.
    """
    noted: list[LoggedWarning] = []
    thread = threading.get_ident()

    class _Notes(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.thread == thread:
                noted.append((record.name, record.getMessage()))

    notes = _Notes(logging.WARNING)
    logger = logging.getLogger("skyline.terrain")
    level = logger.level
    propagates = logger.propagate
    if not logger.isEnabledFor(logging.WARNING):
        logger.setLevel(logging.WARNING)
        logger.propagate = False
    logger.addHandler(notes)
    try:
        yield noted
    finally:
        logger.removeHandler(notes)
        logger.setLevel(level)
        logger.propagate = propagates
