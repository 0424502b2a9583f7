"""What planned builds take.

Processor time counts all threads, the software rasterizer's too; storing is part of rendering, as
it is in `Plan.render_s`.
"""

import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

from skyline.pipeline import build_planned
from skyline.planning.plan import PlanConfig
from skyline.report.coverage_map import save_coverage_map
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.record import Row


def measure(
    terrain: HeightField,
    planner: str,
    coverage: float,
    bounds_deg: tuple[float, float, float, float],
    picture: Path | None = None,
) -> Row:
    """Build a store with a planner; return what it took, and draw its plan where asked to."""
    started = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "store.h5"
        done = build_planned(terrain, store, PlanConfig(planner, coverage=coverage), bounds_deg)
        size = store.stat().st_size
    plan, proof, made = done.plan, done.verification, done.plan.progress
    if picture is not None:
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
