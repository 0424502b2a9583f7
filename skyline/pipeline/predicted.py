"""What a store predicts, kept in a folder: the predictions of one store are made once.

A file is named by all that its predictions depend on: the store's bytes, the terrain, the
settings, and the code itself. So nothing is ever out of date, only no longer asked for, and the
files that were longest not asked for go when the folder grows too large.
"""

import hashlib
import logging
import os
import tempfile
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import numpy as np

from skyline.matching.dense import DenseProfiles, DensifyConfig, Progress, densify
from skyline.pipeline.config import mapped_area_m
from skyline.pipeline.digests import code_files, file_digest, files_digest
from skyline.store import Store, StoreHeader
from skyline.terrain.heightfield import HeightField
from skyline.views import Views

_log = logging.getLogger(__name__)

PREDICTING_CODE = (
    "camera.py", "geodesy.py", "views.py", "matching/dense.py", "matching/lattice.py",
    "pipeline/config.py", "pipeline/predicted.py", "planning/uniform.py", "prediction", "store",
    "terrain",
)  # fmt: skip
"""Code that a prediction depends on, in the package."""
FOLDER_LIMIT_BYTES = 4 << 30
_SUFFIX = ".predicted.npz"
_PARTIAL = ".predicted.partial"
_STRAY_S = 24 * 3600.0
"""A partial file that old was left behind by a process that was killed."""
_FIELDS = tuple(field.name for field in fields(DenseProfiles))


def cache_folder() -> Path:
    """Return the folder for what can be made again: ``$XDG_CACHE_HOME/skyline``."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "skyline"


def predicted_profiles(
    store: Store,
    terrain: HeightField | None,
    config: DensifyConfig,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> DenseProfiles:
    """Return a store made dense, from a folder where it is kept there, and kept there if not.

    Parameters
    ----------
    store : Store
    terrain : HeightField, optional
        What it was rendered from; see `densify`.
    config : DensifyConfig
    folder : Path, optional
        Made if need be; where it cannot be written to, there is a warning. None keeps nothing.
    progress : callable, optional
        See `densify`; not called where there is nothing to predict.
    """
    if folder is None:
        return densified(store.iter_views(), store.header, terrain, config, progress)
    path = folder / (_key(store, terrain, config) + _SUFFIX)
    profiles = _kept(path)
    if profiles is None:
        profiles = densified(store.iter_views(), store.header, terrain, config, progress)
        try:
            _keep(profiles, path)
        except OSError as error:
            _log.warning("predictions are not kept for the next time in %s: %s", folder, error)
    return profiles


def densified(
    chunks: Iterable[Views],
    header: StoreHeader,
    terrain: HeightField | None,
    config: DensifyConfig,
    progress: Progress | None = None,
) -> DenseProfiles:
    """Return a store's views made dense over the area it was built for; see `densify`."""
    ground = None if terrain is None else terrain.height_at
    area_m = None if terrain is None else mapped_area_m(header, terrain)
    return densify(chunks, ground, config, area_m, progress)


def _key(store: Store, terrain: HeightField | None, config: DensifyConfig) -> str:
    told = (
        files_digest(code_files(PREDICTING_CODE)),
        file_digest(store.path),
        store.committed,
        None if terrain is None else terrain.digest,
        config,
    )
    return hashlib.sha256(repr(told).encode()).hexdigest()


def _kept(path: Path) -> DenseProfiles | None:
    """Return profiles that were kept; None where there are none that can be read."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as held:
            profiles = DenseProfiles(*(held[name] for name in _FIELDS))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except Exception as error:  # A damaged archive may raise anything.
        _log.warning("%s is not as it was written and will be made again: %s", path, error)
        return None
    with suppress(OSError):
        path.touch()
    return profiles


def _keep(profiles: DenseProfiles, path: Path) -> None:
    """Write profiles, whole or not at all, and make room for them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, suffix=_PARTIAL)
    partial = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **{name: getattr(profiles, name) for name in _FIELDS})
        partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    _make_room(path)


def _make_room(newest: Path) -> None:
    """Remove what was longest not asked for from a folder that is too large."""
    for stat, stray in _files(newest.parent, _PARTIAL):
        if time.time() - stat.st_mtime > _STRAY_S:
            stray.unlink(missing_ok=True)
    kept = _files(newest.parent, _SUFFIX)
    excess = sum(stat.st_size for stat, _ in kept) - FOLDER_LIMIT_BYTES
    for stat, path in sorted(kept, key=lambda one: one[0].st_mtime):
        if excess > 0 and path != newest:
            path.unlink(missing_ok=True)
            excess -= stat.st_size


def _files(folder: Path, suffix: str) -> list[tuple[os.stat_result, Path]]:
    """Return the files of a name; another process may remove some meanwhile."""
    files = []
    for path in folder.glob(f"*{suffix}"):
        with suppress(FileNotFoundError):
            files.append((path.stat(), path))
    return files
