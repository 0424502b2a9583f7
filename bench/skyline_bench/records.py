"""Records of benchmarks: rows, and how to measure them again.

A record names the command, the data that it read, the area, the stores, the seed, the code and the
machine. Files are named as the command named them. If others are to repeat a record, start the
benchmark in the folder of the data, and give the paths from there.
"""

import datetime
import hashlib
import json
import math
import os
import platform
import shlex
import subprocess
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer

import skyline
from skyline import HeightField
from skyline.errors import ContextError, InputError, SkylineError
from skyline.files.disk import read_bytes, write_whole
from skyline.geodesy.bounds import Bounds
from skyline.render.context import held_context
from skyline.store.read import open_store
from skyline_bench.measuring import Row, core_count

# What a command does with the files that a parameter names.
READ = "skyline_bench.read"
WRITTEN = "skyline_bench.written"
KEPT = "skyline_bench.kept"
"""A folder of files that are kept for the next run; they do not change any figure."""
_CODE = "skyline", "shaders", "bench/skyline_bench", "bench/skyline_training"


def note_files(context: typer.Context, param: typer.CallbackParam, use: str) -> None:
    """Note what a command does with the files that a parameter names."""
    context.meta.setdefault(use, []).append(param.name)


@dataclass(frozen=True, slots=True)
class Run:
    """A benchmark as it was started, and the file of its record."""

    context: typer.Context
    path: Path | None  # Where the record is written; None for no record

    @property
    def bench(self) -> str:
        """The name of the benchmark."""
        return self.context.info_name or ""

    @property
    def seed(self) -> int | None:
        """The seed of all random draws; None where there is none."""
        return self.context.params.get("seed")

    def command(self) -> str:
        """Return the command for a shell.

        It has all given options, and the seed. Files that it writes are named without their
        folders, and a folder in which stores are kept is left out.
        """
        program = self.context.find_root().info_name or ""
        words = [*program.split(), self.bench]
        for param, values in self._given():
            is_written = param.name in self._named(WRITTEN)
            for value in values:
                if param.param_type_name == "option":
                    words.append(next(name for name in param.opts if name.startswith("--")))
                if not isinstance(value, bool):
                    words.append(Path(value).name if is_written else _word(value))
        return shlex.join(words)

    def outputs(self) -> list[str]:
        """Return the names of the files written, as in the command."""
        written = self._named(WRITTEN)
        return [
            Path(value).name
            for param, values in self._given()
            for value in values
            if param.name in written
        ]

    def inputs(self, more: Iterable[Path] = ()) -> list[dict[str, str]]:
        """Return the paths and digests of all files and folders read.

        ``more`` are files that are named in files on the command line. Addresses are left out.
        """
        read = self._named(READ)
        given = [one for param, values in self._given() if param.name in read for one in values]
        named = dict.fromkeys(str(path) for path in (*given, *more))
        # An address may be too long to be a file, for which `Path.exists` raises an error.
        here = [path for path in named if os.path.exists(path)]  # noqa: PTH110
        return [{"path": path, "digest": data_digest(Path(path))} for path in here]

    def _given(self) -> Iterator[tuple[Any, list[Any]]]:
        """Yield the parameters that were given, and the seed.

        Each comes with a list of its values.
        """
        context = self.context
        for param in context.command.params:
            name = param.name or ""
            source = context.get_parameter_source(name)
            is_given = source is not None and source.name == "COMMANDLINE"
            if (is_given or name == "seed") and name not in self._named(KEPT):
                value = context.params[name]
                value = value.path if isinstance(value, Run) else value
                yield param, list(value) if isinstance(value, list | tuple) else [value]

    def _named(self, use: str) -> list[str]:
        return list(self.context.meta.get(use, ()))


def _word(value: object) -> str:
    """Return a value for a command line.

    Whole numbers have no point.
    """
    return f"{value:.15g}" if isinstance(value, float) else str(value)


def write_record(
    run: Run | None,
    rows: Sequence[Row],
    summary: Mapping[str, Sequence[Row]] | None = None,
    *,
    terrain: HeightField | None = None,
    bounds_deg: Bounds | None = None,
    stores: Mapping[str, str] | None = None,
    files: Iterable[Path] = (),
) -> None:
    """Write a run's record as JSON, if the run asks for one.

    The file is written whole or not at all. Numbers that are not finite, which JSON cannot hold,
    are written as null.

    Parameters
    ----------
    run : Run, optional
    rows : sequence of mapping
        What was measured.
    summary : mapping, optional
        Tables by name, which follow from the rows.
    terrain : HeightField, optional
        The elevation model, whose digest and bounds are written.
    bounds_deg : tuple, optional
        The area that was measured, if it is not all of the terrain.
    stores : mapping, optional
        `Store.digest` of each store that was searched, by its name in the rows.
    files : iterable of Path
        Files that were read because other files name them.
    """
    if run is None or run.path is None:
        return
    record: dict[str, object] = {
        "bench": run.bench,
        "command": run.command(),
        "seed": run.seed,
        "inputs": run.inputs(files),
        "outputs": run.outputs(),
    }
    if terrain is not None:
        record["dem"] = {"digest": terrain.digest, "bounds_deg": list(terrain.box_deg)}
        record["bounds_deg"] = list(bounds_deg or terrain.box_deg)
    if stores:
        record["stores"] = dict(stores)
    record |= {"code": code(), "machine": machine(), "rows": _plain(rows)}
    if summary:
        record["summary"] = {name: _plain(table) for name, table in summary.items()}
    write_whole(run.path, json.dumps(record, indent=1, allow_nan=False) + "\n")


def read_record(path: Path) -> dict[str, Any]:
    """Read a record; raises `MissingFileError`, or `InputError` for any other file."""
    expected = "expected the record of a benchmark, as --json writes it"
    try:
        record = json.loads(read_bytes(path, expected))
        are_rows = (isinstance(row, dict) for row in record["rows"])
        if not isinstance(record["bench"], str) or not all(are_rows):
            raise TypeError
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{path} is no record; {expected}") from None
    return dict(record)


def data_digest(path: Path) -> str:
    """Return the digest of a store, else the SHA-256 of a file.

    The digest of a folder is over the names and digests of its files.
    """
    with suppress(SkylineError), open_store(path) as store:
        return store.digest
    if path.is_dir():
        inside = sorted(one for one in path.rglob("*") if one.is_file())
        parts = [f"{one.relative_to(path).as_posix()} {data_digest(one)}\n" for one in inside]
        return hashlib.sha256("".join(parts).encode("utf-8", "surrogateescape")).hexdigest()
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror})") from error


def code() -> dict[str, object]:
    """Return the version of Skyline and of its checkout.

    In a checkout, these are the commit and whether the code was changed since.
    """
    package = Path(skyline.__file__).parent
    about: dict[str, object] = {"skyline": skyline.__version__}
    # The checkout of another project may contain an installed Skyline.
    if _git(package, "ls-files", "--error-unmatch", "__init__.py") is not None:
        about["commit"] = _git(package, "rev-parse", "HEAD")
        changes = _git(package, "status", "--porcelain", "--", *(f":/{part}" for part in _CODE))
        about["is_changed"] = bool(changes)
    return about


def _git(folder: Path, *words: str) -> str | None:
    """Return what git prints; None where it fails or is not installed."""
    command = ["git", "-C", str(folder), *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def machine() -> dict[str, object]:
    """Describe this machine, and its software that matters to measurements."""
    try:
        with held_context() as context:
            renderer = context.renderer
            driver = context.version
    except ContextError:
        renderer = driver = "none"
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "processor": _processor(),
        "cores": core_count(),
        "os": platform.platform(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "renderer": renderer,
        "driver": driver,
    }


def _processor() -> str:
    """Return the processor's model name, else its architecture."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, [*names, platform.processor()]), platform.machine())


def _plain(rows: Sequence[Row]) -> list[Row]:
    def plain(value: object) -> object:
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return [{key: plain(value) for key, value in row.items()} for row in rows]
