"""Folders, and the files in them."""

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path, PurePath
from typing import NoReturn

from skyline.errors import InputError

_FILE_SUFFIXES = {
    ".csv", ".geojson", ".gpkg", ".gpx", ".h5", ".hdf5", ".htm", ".html", ".jpeg", ".jpg", ".json",
    ".kml", ".kmz", ".npz", ".pdf", ".png", ".svg", ".tif", ".tiff", ".txt", ".zip",
}  # fmt: skip
"""Suffixes that nobody gives to a folder."""
_SYSTEM_FOLDERS = {
    "__macosx", "@eadir", "$recycle.bin", "system volume information", "lost+found",
}  # fmt: skip
"""Folders that systems make beside a person's own, in lower case."""


def check_folder(path: Path) -> None:
    """Raise `InputError` for a path that cannot be a folder.

    It is a file, or a new folder with the suffix of a file.
    """
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is a file; name a folder")
    suffix = path.suffix.lower()
    if suffix in _FILE_SUFFIXES and not path.exists():
        raise InputError(f"{path} would be a folder, and {suffix} promises a file; name a folder")


def files_in(folder: Path, is_skipped: Callable[[Path], bool] = lambda _: False) -> list[Path]:
    """Return the files below a folder, in order of path.

    Hidden files and folders are left out, and so are folders that systems make or for which
    ``is_skipped`` returns True. Links are followed, and each folder is listed once; a link without
    a target is a file. Raises `InputError` where a folder cannot be listed.
    """

    def refuse(error: OSError) -> NoReturn:
        raise InputError(f"{error.filename} cannot be read: {error.strerror}") from error

    found: list[Path] = []
    listed: set[str] = set()
    for here, folders, names in os.walk(folder, onerror=refuse, followlinks=True):
        if os.path.realpath(here) in listed or is_skipped(Path(here)):
            folders.clear()
            continue
        listed.add(os.path.realpath(here))
        folders[:] = [one for one in folders if not is_of_system(one)]
        files = (Path(here, name) for name in names if not is_of_system(name))
        found += (file for file in files if file.is_file() or not file.exists())
    return sorted(found)


def is_of_system(name: str) -> bool:
    """Return whether a file or folder is hidden or a system's own."""
    return name.startswith(".") or name.lower() in _SYSTEM_FOLDERS


def names_in_words(names: Sequence[str]) -> str:
    """Return the names of files in words.

    One file of each suffix is named, with the number of the others.
    """
    most = 10
    kinds: dict[str, list[str]] = {}
    for name in names:
        kinds.setdefault(PurePath(name).suffix.lower(), []).append(name)
    shown = [
        some[0] if len(some) == 1 else f"{some[0]} and {len(some) - 1} more {kind}".rstrip()
        for kind, some in list(kinds.items())[:most]
    ]
    others = sum(map(len, list(kinds.values())[most:]))
    return ", ".join(shown + [f"{others} others"] * bool(others))


def left_out_in_words(names: Sequence[str], expected: str) -> str:
    """Return a clause on a folder's files that are left out."""
    if len(names) == 1:
        return f"1 file is left out, which is not a {expected}: {names_in_words(names)}"
    return f"{len(names)} files are left out, which are not {expected}: {names_in_words(names)}"


def lies_in_any(output: Path, folders: Iterable[str]) -> bool:
    """Return whether an output is one of some folders, or inside one.

    It may lie in a folder of such a folder.
    """
    resolved = output.resolve()
    return not {Path(one).resolve() for one in folders}.isdisjoint([resolved, *resolved.parents])
