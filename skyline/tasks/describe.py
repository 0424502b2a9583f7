"""Facts about elevation models and stores."""

import numpy as np

from skyline.errors import printable
from skyline.geodesy.map_frame import Frame
from skyline.store.layout import PLACES, SCHEMA_VERSION
from skyline.store.read import open_store
from skyline.terrain.heightfield import HeightField
from skyline.terrain.products import model_of

_SIDES = "west, south, east, north"
MEANINGS = {
    "DEM": {
        "spacing_m": "east, north",
        "bounds_m": _SIDES,
        "bounds_deg": _SIDES,
        "height_range_m": "lowest and highest sample",
        "convergence_deg": "true azimuth minus grid azimuth, in the middle",
        "filled": "samples in voids that were filled",
        "hollow": "samples in voids that were left open",
        "despiked": "samples that were removed as spikes",
        "undeclared": "samples in voids that the file does not declare",
        "digest": "of the heights; a store names the digest of its model",
    },
    "store": {
        "bounds_deg": _SIDES,
        "spacing_m": "least, median and greatest distance of neighbouring places",
        "dem_digest": "of the heights of its model",
    },
}
"""The meanings of facts, in words, for each kind of file."""


def describe_terrain(field: HeightField) -> dict[str, object]:
    """Return facts about an elevation model.

    They are its files, its grid, its frame, and its repairs.
    """
    west, south, east, north = field.bounds_m
    turn_deg = field.frame.convergence_deg(
        easting_m=(west + east) / 2.0, northing_m=(south + north) / 2.0
    )
    made = field.provenance
    return {
        "kind": "DEM",
        "files": list(made.files),
        "model": model_of(made.files),
        "frame": field.frame.name,
        **made.conventions,
        "resampling": made.resampling,
        "samples": f"{field.cols} x {field.rows}",
        "spacing_m": [field.spacing_east_m, field.spacing_north_m],
        "bounds_m": [west, south, east, north],
        "bounds_deg": list(field.box_deg),
        "height_range_m": list(field.height_range_m),
        "convergence_deg": float(turn_deg),
        **{name: getattr(made, name) for name in ("filled", "hollow", "despiked", "undeclared")},
        "digest": field.digest,
    }


def describe_store(path: str) -> dict[str, object]:
    """Return facts about a store.

    They are its rows, its DEM and its settings. Raises as `open_store`.
    """
    with open_store(path) as store:
        header = store.header
        eyes = store.eyes()
        frame = Frame(header.frame_wkt)
        facts: dict[str, object] = {"kind": "store", header.holds: len(store)}
        if header.width:
            facts["width"] = header.width
        facts |= {
            "frame": frame.name,
            "dem_files": [printable(file) for file in header.dem_files],
            "dem_digest": header.dem_digest,
            "config": dict(header.config),
            "renderer": header.renderer,
            "package_version": header.package_version,
            "schema_version": SCHEMA_VERSION,
        }
        if len(store):
            facts["locations"] = len(np.unique(eyes.easting_m + 1j * eyes.northing_m))
            if header.holds == PLACES:
                blocks = store.places().blocks()
                spacing_m = 2.0 * np.concatenate([block.tolerance_m for block in blocks])
                facts["spacing_m"] = np.quantile(spacing_m, [0.0, 0.5, 1.0]).tolist()
            facts["bounds_deg"] = list(
                frame.box_deg(easting_m=eyes.easting_m, northing_m=eyes.northing_m)
            )
        return facts
