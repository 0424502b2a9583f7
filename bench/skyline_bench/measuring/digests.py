"""Digests of files and of code: what a result that is kept depends on."""

import hashlib
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

_SUFFIXES = (".py", ".json")
"""Of code, and of what was learned for it."""


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def files_digest(files: Iterable[Path]) -> str:
    """Return a SHA-256 of files, their names and their folders' names included."""
    told = hashlib.sha256()
    for file in files:
        told.update(f"{file.parent.name}/{file.name}\0".encode() + file.read_bytes())
    return told.hexdigest()


def code_files(package: ModuleType, names: Iterable[str]) -> list[Path]:
    """Return the code and the learned models in a package's files and folders of those names."""
    roots = [Path(folder) / name for folder in package.__path__ for name in names]
    files = [file for root in roots for file in ([root] if root.is_file() else root.rglob("*"))]
    return sorted(file for file in files if file.suffix in _SUFFIXES)
