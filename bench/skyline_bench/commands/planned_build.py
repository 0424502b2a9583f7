"""What planned builds take: python bench/planned_build.py DEM... [--bounds W,S,E,N].

Builds a store with each planner, prints a line for it, and writes bench/results/planned_build.json
and the map of `cover`'s plan. Processor time counts all threads, the software rasterizer's too;
storing is part of rendering, as it is in `Plan.render_s`.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

from skyline.console import parse_bounds
from skyline.pipeline import build_planned
from skyline.planning.plan import PlanConfig
from skyline.report.coverage import save_coverage_map
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.record import Row, write_record

RESULTS = Path(__file__).parent / "results"
DAVOS_BOUNDS = "9.85,46.755,9.915,46.845"


def measure(
    terrain: HeightField, planner: str, coverage: float, bounds: tuple[float, float, float, float]
) -> Row:
    started = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "store.h5"
        done = build_planned(terrain, store, PlanConfig(planner, coverage=coverage), bounds)
        size = store.stat().st_size
    plan, proof, made = done.plan, done.verification, done.plan.progress
    if planner == "cover":
        picture = RESULTS / "cover_map.png"
        save_coverage_map(plan, picture)
        # A palette keeps the repository small.
        Image.open(picture).convert("RGB").quantize(256).save(picture, optimize=True)
    inclusions = [np.count_nonzero(one.areas) for one in plan.coverages]
    return {
        "planner": planner,
        "candidates": int(plan.candidates.grid.valid.sum()),
        "renderings": made.renderings,
        "batches": made.batches,
        "renderings_a_batch": made.renderings / made.batches,
        "mean_area": float(sum(inclusions)) / made.renderings,
        "render_s": plan.render_s,
        "render_cpu_s": plan.render_cpu_s,
        "plan_s": plan.plan_s,
        "plan_cpu_s": plan.plan_cpu_s,
        "build_cpu_s": time.process_time() - started,
        "predicted": proof.predicted,
        "verified": proof.verified,
        "share": proof.share,
        "share_low": proof.low,
        "share_high": proof.high,
        "verified_by": proof.sampled,
        "bytes": size,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dem", nargs="+")
    parser.add_argument("--bounds", default=DAVOS_BOUNDS)
    parser.add_argument("--coverage", type=float, default=0.98)
    parser.add_argument("--planners", default="cover,lpov")
    arguments = parser.parse_args()
    terrain, bounds = read_dem(arguments.dem), parse_bounds(arguments.bounds)
    rows = []
    for planner in arguments.planners.split(","):
        rows.append(measure(terrain, planner, arguments.coverage, bounds))
        print(rows[-1], flush=True)
        write_record(RESULTS / "planned_build.json", "planned-build", rows)


if __name__ == "__main__":
    main()
