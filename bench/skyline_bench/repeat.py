"""``skyline-bench repeat``: the command of a record, run again."""

import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from skyline.errors import InputError, MissingFileError
from skyline_bench import options
from skyline_bench.measuring import Row
from skyline_bench.records import data_digest, read_record

_NEEDED = "command", "inputs", "outputs"
"""What a record must have to be repeated."""


def repeat(
    context: typer.Context,
    record: Annotated[Path, Argument(metavar="RECORD.json", help="A record, as --json writes it.")],
    data: Annotated[
        Path | None,
        Option(
            metavar="FOLDER",
            help="Look here for the data that the record names, by the ends of their paths.",
        ),
    ] = None,
    out: Annotated[
        Path,
        Option(
            "--output", "-o", metavar="FOLDER", help="For the new record and all that is written."
        ),
    ] = Path("repeated"),
) -> None:
    """The command of a record once more, on the same data.

    The new record is compared with the old one. Data whose digest differs from the record's are
    refused. A record keeps its name, so --output decides whether it is replaced.
    """
    if data is not None and not data.is_dir():
        raise MissingFileError(f"--data {data} is no folder; name the folder of the record's data")
    old = read_record(record)
    missing = [name for name in _NEEDED if name not in old]
    group: Any = context.parent.command if context.parent else None
    if missing:
        raise InputError(
            f"{record} has no {', no '.join(missing)}: it is older than `repeat`; measure "
            f"{old['bench']} anew"
        )
    if old["bench"] not in group.commands:
        raise InputError(f"{record} is of another program: {old['command']}")
    try:
        words = shlex.split(old["command"])
        words = words[words.index(old["bench"]) :]
        digests = {str(one["path"]): str(one["digest"]) for one in old["inputs"]}
        outputs = [Path(name).name for name in old["outputs"]]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{record} is damaged ({error!r}); measure it anew") from None
    folder = Path() if data is None else data
    moved = _inputs_in(folder, record, digests)
    out.mkdir(parents=True, exist_ok=True)
    target = (out / record.name).absolute()
    moved |= {name: str(target.with_name(name)) for name in outputs}
    # The last of two values counts: the record may have another name than it was given.
    words = [*(moved.get(word, word) for word in words), "--json", str(target)]
    with chdir(folder):
        group.main(words, prog_name=context.find_root().info_name, standalone_mode=False)
    _print_comparison(old, read_record(target))


def _inputs_in(folder: Path, record: Path, digests: Mapping[str, str]) -> dict[str, str]:
    """Return the present paths of a record's files, by their names.

    The files are searched in a folder. Raises `MissingFileError` for a missing file, and
    `InputError` for another digest.
    """
    found = {path: _path_in(folder, path) for path in digests}
    absent = [path for path, here in found.items() if here is None]
    if absent:
        raise MissingFileError(
            f"{len(absent)} of the {len(digests)} files that {record} was made from are not in "
            f"{folder.absolute()}, the first of them {absent[0]}; name the folder that has them: "
            "--data FOLDER"
        )
    moved = {path: here for path, here in found.items() if here is not None}
    for path, wanted in digests.items():
        here = folder / moved[path]
        digest = data_digest(here)
        if digest != wanted:
            raise InputError(
                f"{here} has the digest {digest[:12]}, and {record} was made from {wanted[:12]}; "
                "name the folder of the record's data: --data FOLDER"
            )
    return moved


def _path_in(folder: Path, path: str) -> str | None:
    """Return the longest end of a path that exists in a folder.

    An absolute path is returned unchanged. Returns None if no such path exists.
    """
    given = Path(path)
    if given.is_absolute() and folder == Path() and given.exists():
        return path
    parts = given.relative_to(given.anchor).parts
    ends = (Path(*parts[start:]) for start in range(len(parts)))
    here = next((str(end) for end in ends if (folder / end).exists()), None)
    return here or (path if given.is_absolute() and given.exists() else None)


def _print_comparison(old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """Print how two records differ.

    Each column that differs is printed with the number of rows in which it does, and the greatest
    difference.
    """
    before = old["rows"]
    after = new["rows"]
    differing = list(_differences(before, after))
    columns = {key for row in (*before, *after) for key in row}
    typer.echo(
        f"rows: {len(before)} before, {len(after)} now; {len(columns) - len(differing)} of "
        f"{len(columns)} columns are equal in all rows"
    )
    if differing:
        options.print_rows(differing)
    for name in ("seed", "bounds_deg", "dem", "stores", "code"):
        if old.get(name) != new.get(name):
            typer.echo(f"{name}: {old.get(name)} before, {new.get(name)} now")


def _differences(before: Sequence[Row], after: Sequence[Row]) -> Iterator[Row]:
    pairs: list[tuple[Row, Row]] = list(zip_longest(before, after, fillvalue={}))
    for key in dict.fromkeys(key for pair in pairs for row in pair for key in row):
        changed = [(a.get(key), b.get(key)) for a, b in pairs if a.get(key) != b.get(key)]
        if changed:
            yield {"column": key, "rows": len(changed), **_greatest(changed)}


def _greatest(changed: Sequence[tuple[Any, Any]]) -> Row:
    """Return the pair of numbers that differ most.

    Differences are shares of the first number. Without numbers, the first pair is returned.
    """

    def share(pair: tuple[Any, Any]) -> float:
        if not all(isinstance(value, int | float) for value in pair):
            return math.inf
        return abs(pair[1] - pair[0]) / abs(pair[0]) if pair[0] else math.inf

    before, after = max(changed, key=share)
    return {"before": _plain(before), "now": _plain(after)}


def _plain(value: Any) -> Any:
    return value if isinstance(value, int | float | None) else str(value)
