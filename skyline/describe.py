"""What a DEM, a store or a scene is, as facts to print or to parse."""

from dataclasses import replace

import numpy as np

from skyline.camera import pixel_size
from skyline.geodesy import Frame
from skyline.pipeline.build import render_views
from skyline.pipeline.config import RenderConfig
from skyline.store import StoreHeader, open_store
from skyline.store.header import PLACES, SCHEMA_VERSION
from skyline.terrain.heightfield import HeightField
from skyline.terrain.products import model_of
from skyline.terrain.scene import (
    BLOCK_CELLS,
    COARSER_STEPS,
    coarser_step,
    curvature_bound_px,
    share_beyond,
    sight_range_m,
)
from skyline.terrain.viewpoints import Viewpoints

Facts = dict[str, object]


def describe_terrain(field: HeightField) -> Facts:
    """Return the facts of a height field."""
    west, south, east, north = field.bounds_m
    bounds_deg = field.frame.box_deg([west, east, west, east], [south, south, north, north])
    low, high = field.height_range_m
    centre = (west + east) / 2.0, (south + north) / 2.0
    return {
        "kind": "DEM",
        "files": list(field.provenance.files),
        "model": model_of(field.provenance.files),
        "frame": field.frame.name,
        "resampling": field.provenance.resampling,
        "samples": f"{field.cols} x {field.rows}",
        "spacing_m": [field.spacing_east_m, field.spacing_north_m],
        "bounds_m": [west, south, east, north],
        "bounds_deg": list(bounds_deg),
        "height_range_m": [low, high],
        "convergence_deg": float(field.frame.convergence_deg(*centre)),
        "filled": field.provenance.filled,
        "hollow": field.provenance.hollow,
        "despiked": field.provenance.despiked,
        "undeclared": field.provenance.undeclared,
        "digest": field.digest,
    }


def describe_scene(terrain: HeightField, eye: Viewpoints, config: RenderConfig) -> Facts:
    """Return what is modelled for one viewpoint, what is left out, and at what cost."""
    # What the tolerance leaves out shows only in skylines that were rendered without it.
    exact = render_views(terrain, eye, replace(config, tolerance_px=0.0))
    given = render_views(terrain, eye, config)
    drop_per_m2 = config.curvature.drop_per_m2
    reach_m = terrain.reach_m(float(eye.easting_m[0]), float(eye.northing_m[0]))
    sight_m = sight_range_m(terrain, float(eye.eye_elevation_m[0]), drop_per_m2)
    short = np.nanmax(exact.elevation_tan - given.elevation_tan, initial=0.0)
    depth_m = exact.depth_m
    facts: Facts = {
        "easting_m": float(eye.easting_m[0]),
        "northing_m": float(eye.northing_m[0]),
        "eye_elevation_m": float(eye.eye_elevation_m[0]),
        "width": config.width,
        "tolerance_px": config.tolerance_px,
        "skyline_depth_m": [float(v) for v in np.nanquantile(depth_m, [0.0, 0.5, 1.0])]
        if np.isfinite(depth_m).any()
        else [],
        "flagged_columns": float((exact.flags != 0).mean()),
        "data_reach_m": reach_m,
        "sight_m": sight_m,
        "samples_beyond_sight": share_beyond(terrain, eye, sight_m),
        "curvature": "modelled" if config.curvature.enabled else "left out (--no-curvature)",
        "curvature_bound_px": curvature_bound_px(reach_m, drop_per_m2, config.width),
        "passed_over_bound_px": config.tolerance_px,
        "passed_over_measured_px": float(short / pixel_size(config.width)),
    }
    tolerance = config.tolerance_px * pixel_size(config.width)
    for step in COARSER_STEPS if min(terrain.rows, terrain.cols) > BLOCK_CELLS else ():
        deviation_m, share = coarser_step(terrain, eye, step, tolerance)
        facts[f"every_{step}_samples"] = (
            f"deviates by {deviation_m:.1f} m in the median block; within the tolerance in "
            f"{100.0 * share:.1f} % of blocks; not used: all samples are kept"
        )
    return facts


def describe_store(path: str) -> Facts:
    """Return the facts of a store; raises `StoreError` where it cannot be read."""
    with open_store(path) as store:
        header, eyes = store.header, store.eyes()
        frame = Frame(header.frame_wkt)
        facts: Facts = {
            "kind": "store",
            header.holds: store.committed,
            **({"width": header.width} if header.width else {}),
            "frame": frame.name,
            "dem_files": list(header.dem_files),
            "dem_digest": header.dem_digest,
            "config": dict(header.config),
            "rows": header.rows,
            **_describe_coding(header),
            "renderer": header.renderer,
            "package_version": header.package_version,
            "schema_version": SCHEMA_VERSION,
        }
        if store.committed:
            facts["locations"] = len(np.unique(eyes.easting_m + 1j * eyes.northing_m))
            if header.holds == PLACES:
                spacing_m = 2.0 * np.concatenate(
                    [block.tolerance_m for block in store.places().blocks()]
                )
                facts["spacing_m"] = [float(v) for v in np.quantile(spacing_m, [0.0, 0.5, 1.0])]
            facts["bounds_deg"] = list(frame.box_deg(eyes.easting_m, eyes.northing_m))
        return facts


def _describe_coding(header: StoreHeader) -> Facts:
    """Return how far compact rows may be from what was rendered."""
    if header.coding is None:
        return {}
    return {
        "tan_error_px": header.coding.tan_error_px(header.width),
        "depth_error": header.coding.depth_error,
    }
