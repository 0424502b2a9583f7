"""Trials kept in a folder, so that a measurement that was stopped goes on where it was."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import skyline
import skyline_bench
from skyline.files import write_with_folders
from skyline.matching import Candidate
from skyline.render.shaders import SHADER_FOLDERS
from skyline_bench.measuring.digests import code_files, files_digest
from skyline_bench.queries.synthetic import SyntheticQuery
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
    """Write trials, whole or not at all; of the candidates the best is kept."""
    kept = [
        {
            "best": asdict(trial.candidates[0]) if trial.candidates else None,
            "answered_within_m": trial.answered_within_m,
            "error_m": trial.error_m,
            "heading_error_deg": trial.heading_error_deg,
            "seconds": trial.seconds,
        }
        for trial in trials
    ]
    write_with_folders(path, json.dumps({"key": key, "trials": kept}) + "\n")


def kept_trials(path: Path, key: Key, queries: Sequence[SyntheticQuery]) -> list[Trial] | None:
    """Return the trials of these queries that were kept under a key; None where there are none.

    A file that holds others, or cannot be read, counts as none: it will be written again.
    """
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
        if held["key"] != json.loads(json.dumps(key)):
            return None
        return [
            Trial(
                index,
                query.truth,
                query.distance_m,
                () if kept["best"] is None else (_candidate(kept["best"]),),
                kept["answered_within_m"],
                kept["error_m"],
                kept["heading_error_deg"],
                kept["seconds"],
            )
            for index, (query, kept) in enumerate(zip(queries, held["trials"], strict=True))
        ]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _candidate(kept: dict[str, Any]) -> Candidate:
    covariance = kept.pop("covariance_m2")
    return Candidate(**kept, covariance_m2=covariance and tuple(map(tuple, covariance)))


@cache
def measured_code_digest() -> str:
    """Return a SHA-256 of the `measured_files`."""
    return files_digest(measured_files())


def measured_files() -> list[Path]:
    """Return the files that an answer depends on: code, learned models and shaders."""
    shaders = sorted(file for folder in SHADER_FOLDERS for file in folder.glob("*.*"))
    code = [file for package, names in MEASURED_CODE.items() for file in code_files(package, names)]
    return code + shaders
