"""All commands of ``skyline-bench``: what its help says, and the short ones run small."""

import ast
import json
import re
from pathlib import Path

import pytest
import typer

import skyline_bench
from skyline_bench import cli

LAYERS = (
    ("cli",), ("commands",), ("figures",), ("runs",), ("cases", "stores", "training", "trials"),
    ("queries", "truth", "peers"), ("measuring",),
)  # fmt: skip
"""Folders of the package; each imports from those after it, and from its own."""
FOLDERS = {name: level for level, names in enumerate(LAYERS) for name in names}


def imported(path):
    """Return the modules that a file imports."""
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            names.append(node.module or "")
        elif isinstance(node, ast.Import):
            names += [each.name for each in node.names]
    return names


def test_folders_import_downward_only():
    package = Path(skyline_bench.__file__).parent
    for file in package.rglob("*.py"):
        own = file.relative_to(package).parts[0].removesuffix(".py")
        for name in imported(file):
            root, _, inner = name.partition(".")
            if root == "skyline_bench" and own in FOLDERS and inner:
                other = inner.split(".")[0]
                assert own == other or FOLDERS[own] < FOLDERS[other], f"{file}: {name}"


def test_every_command_is_quick_where_asked_and_says_how_long_it_takes():
    commands = typer.main.get_command(cli.app).commands
    assert len(commands) == sum(len(some) for some in cli.COMMANDS.values())
    for name, command in commands.items():
        assert any("--quick" in option.opts for option in command.params), name
        assert re.search(r"\((an?|\d+) (minute|hour)s?\)\.$|\(hours\)\.$", command.short_help), name


def test_damaged_files_are_answered_or_refused(run_bench, tmp_path):
    record = tmp_path / "record.json"
    done = run_bench("input-fuzz", "--cases", 3, "--json", record)
    assert done.code == 0, done.err
    rows = json.loads(record.read_text())["rows"]
    assert len(rows) == 6
    for row in rows:
        assert row["answered"] + row["refused"] == 3
        assert not row["wrong"]


@pytest.mark.parametrize(
    ("command", "rows", "key"),
    [
        (("place-speed", "DEM", "--eyes", 20), 4, "wall_ms"),
        (("summits", "DEM", "--quick"), 1, "summits_off"),
        (("large-dem", "--samples", 300, "--viewpoints", 4), 1, "seconds"),
        (("retrieval-scale", "STORE", "DEM", "--places", 700, "--queries", 3), 2, "screen_s"),
        pytest.param(
            ("strangers", "STORE", "DEM", "--strange", "DEM", "--queries", 2),
            1,
            "query_ms",
            marks=pytest.mark.slow,
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_short_ones_write_their_rows(run_bench, dem, store, tmp_path, command, rows, key):
    given = [{"DEM": dem, "STORE": store}.get(word, word) for word in command]
    record = tmp_path / "record.json"
    done = run_bench(*given, "--json", record)
    assert done.code == 0, done.err
    written = json.loads(record.read_text())
    assert written["bench"] == command[0]
    assert len(written["rows"]) == rows
    assert all(row[key] >= 0.0 for row in written["rows"])
