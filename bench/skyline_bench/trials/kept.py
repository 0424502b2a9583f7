"""Trials kept in a folder, so that a measurement that was stopped goes on where it was."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from types import ModuleType

import skyline
import skyline_bench
from skyline.files import write_with_folders
from skyline.render.shaders import SHADER_FOLDERS
from skyline_bench.trials.trials import Trial

Key = Mapping[str, object]
"""What a result depends on, as JSON holds it."""

MEASURED_CODE: Mapping[ModuleType, Sequence[str]] = {
    skyline: (
        "camera.py", "geodesy.py", "views.py", "features.py", "horizons.py", "matching", "photo",
        "pipeline", "places", "planning/uniform.py", "render", "store", "terrain",
    ),
    skyline_bench: (
        "queries/synthetic.py", "queries/occluders.py", "queries/pinhole.py",
        "trials/matchers.py", "trials/traced.py", "trials/trials.py",
    ),
}  # fmt: skip
"""By package: code that an answer depends on; shaders beside it."""


def save_trials(path: Path, key: Key, trials: Sequence[Trial]) -> None:
    """Write trials, whole or not at all."""
    kept = [asdict(trial) for trial in trials]
    write_with_folders(path, json.dumps({"key": key, "trials": kept}) + "\n")


def kept_trials(path: Path, key: Key, count: int) -> list[Trial] | None:
    """Return the so many trials that were kept under a key; None where there are none.

    A file that holds others, or cannot be read, counts as none: it will be written again.
    """
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
        if held["key"] != json.loads(json.dumps(key)) or len(held["trials"]) != count:
            return None
        return [Trial(**one) for one in held["trials"]]
    except (OSError, ValueError, KeyError, TypeError):
        return None


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
