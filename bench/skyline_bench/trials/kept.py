"""Results kept in a file, so that a measurement that was stopped goes on where it was."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar

import skyline
import skyline_bench
from skyline.render.shaders import SHADER_FOLDERS

T = TypeVar("T")

MEASURED_CODE: Mapping[ModuleType, Sequence[str]] = {
    skyline: (
        "camera.py", "geodesy.py", "views.py", "features.py", "horizons.py", "matching", "photo",
        "pipeline", "places.py", "planning/uniform.py", "render", "store", "terrain",
    ),
    skyline_bench: (
        "queries/synthetic.py", "queries/occluders.py", "queries/pinhole.py",
        "trials/traced.py", "trials/trials.py",
    ),
}  # fmt: skip
"""By package: code that an answer depends on; shaders beside it."""


class Kept(Generic[T]):
    """Results kept in a file, a line each as they come; those of an earlier run are read.

    A line that a kill cut short is left out. ``path`` begins the file's name; what is not there is
    made. ``depends`` is all that results depend on but their keys, as JSON: others are kept in
    another file. ``read`` makes a result, a dataclass, of its fields.
    """

    def __init__(self, path: Path, depends: object, read: Callable[..., T]) -> None:
        whole = [skyline.__version__, measured_code_digest(), depends]
        digest = hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()
        self._path = path.with_name(f"{path.name}-{digest[:12]}.jsonl")
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self.found: dict[str, T] = {}
        text = self._path.read_text(encoding="utf-8") if self._path.exists() else ""
        for line in text.splitlines():
            try:
                key = (held := json.loads(line)).pop("key")
                self.found[key] = read(**held)
            except (ValueError, KeyError, TypeError, AttributeError):
                continue
        if text and not text.endswith("\n"):
            self._append("")

    def keep(self, key: str, result: T) -> None:
        """Add a result, also to the file."""
        self.found[key] = result
        fields: dict[str, Any] = asdict(result)  # type: ignore[call-overload]
        self._append(json.dumps({"key": key, **fields}))

    def _append(self, line: str) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@cache
def measured_code_digest() -> str:
    """Return a SHA-256 of the `measured_files`, their names and their folders' names included."""
    told = hashlib.sha256()
    for file in measured_files():
        told.update(f"{file.parent.name}/{file.name}\0".encode() + file.read_bytes())
    return told.hexdigest()


def measured_files() -> list[Path]:
    """Return the files that an answer depends on: code, learned models and shaders."""
    code: list[Path] = []
    for package, names in MEASURED_CODE.items():
        roots = [Path(folder) / name for folder in package.__path__ for name in names]
        files = [file for root in roots for file in ([root] if root.is_file() else root.rglob("*"))]
        code += sorted(file for file in files if file.suffix in (".py", ".json"))
    return code + sorted(file for folder in SHADER_FOLDERS for file in folder.glob("*.*"))
