"""Hold the predictors to renderings: python bench/prediction_quality.py NAME=DEM...

Prints a table a terrain and writes bench/results/prediction_quality.json.
"""

import argparse
import datetime
import json
import logging
from dataclasses import asdict
from pathlib import Path

from skyline.render.context import acquire_context
from skyline.terrain.dem import read_dem
from skyline_bench.runs.prediction_quality import QualityRow, QualitySetup, prediction_quality

RESULT = Path(__file__).parent / "results" / "prediction_quality.json"


def line(row: QualityRow) -> str:
    """Return a row of the table in Markdown."""
    return (
        f"| {row.predictor} | {row.shells or '-'} | {'yes' if row.flanks else '-'} "
        f"| {row.precision:.3f} ({row.precision_interval[0]:.2f} to "
        f"{row.precision_interval[1]:.2f}) "
        f"| {row.recall:.3f} ({row.recall_interval[0]:.2f} to {row.recall_interval[1]:.2f}) "
        f"| {row.rank_correlation:.2f} | {row.answered:.2f} | {row.ms_per_area:.1f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("terrains", nargs="+", metavar="NAME=DEM")
    parser.add_argument("--viewpoints", type=int, default=QualitySetup().viewpoints)
    parser.add_argument("--seed", type=int, default=QualitySetup().seed)
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.WARNING)
    setup = QualitySetup(viewpoints=arguments.viewpoints, seed=arguments.seed)
    tables: dict[str, list[dict[str, object]]] = {}
    for terrain in arguments.terrains:
        name, _, path = terrain.partition("=")
        rows = prediction_quality(read_dem([Path(path)]), setup)
        print(f"\n{name}\n")
        print("| predictor | shells | flanks | precision | recall | rank | answered | ms an area |")
        print("| --- | --- | --- | --- | --- | --- | --- | --- |")
        print("\n".join(line(row) for row in rows), flush=True)
        tables[name] = [asdict(row) for row in rows]
    machine = {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "renderer": acquire_context().renderer,
    }
    result = {
        "bench": "prediction-quality",
        "machine": machine,
        "setup": asdict(setup),
        "rows": [{"terrain": name, **row} for name, rows in tables.items() for row in rows],
    }
    RESULT.parent.mkdir(exist_ok=True)
    RESULT.write_text(json.dumps(result, indent=1) + "\n")
    print(f"\nwritten to {RESULT}")


if __name__ == "__main__":
    main()
