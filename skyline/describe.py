"""What a DEM, a store, an answer or the OpenGL at hand is, as facts to print or to parse."""

from collections.abc import Sequence

import numpy as np

from skyline.camera import pixel_size
from skyline.geodesy import Frame
from skyline.pipeline import JointResult, MatchResult, RenderConfig
from skyline.render.context import describe_context
from skyline.report.beyond import beyond_in_words
from skyline.report.claims import claim_in_words, describe_claim
from skyline.report.records import CandidateRecord, LensRecord, MatchRecord, describe_candidates
from skyline.store import StoreHeader, open_store
from skyline.store.header import PLACES, SCHEMA_VERSION
from skyline.terrain.heightfield import HeightField
from skyline.terrain.products import model_of
from skyline.terrain.scene import SceneNeeds
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

Facts = dict[str, object]

_OF_CAMERA = ("heading_deg", "pitch_deg", "roll_deg", "fov_deg", "beyond_share")


def describe_match(query: str, result: MatchResult, loading_seconds: float) -> MatchRecord:
    """Return what was found for a query, in the public JSON's terms."""
    candidates = describe_candidates(result.candidates)
    record = MatchRecord(
        query=query,
        answer=candidates[0] if result.answer else None,
        answer_within_m=result.within_m,
        candidates=candidates,
        seconds=result.seconds,
        loading_seconds=loading_seconds,
    )
    if result.refusal:
        record["refusal"] = result.refusal
    lens = result.query.lens
    if lens is not None and lens.said:
        record["lens"] = LensRecord(
            fov_deg=lens.fov_deg, sd_deg=lens.sd_deg, most_deg=lens.most_deg, said=lens.said
        )
    claim = describe_claim(result.query.noted, next(iter(result.candidates), None))
    if claim is not None:
        record["exif"] = claim
    return record


def match_in_words(record: MatchRecord, asked_for: int) -> list[str]:
    """Return what was found for a query as lines for a person who asked for so many candidates."""
    places = record["candidates"]
    said = [f"{record['query']} ({record['seconds']:.2f} s)"]
    if record["answer"] is not None:
        within_m = record["answer_within_m"]
        near = "" if within_m is None else f", right within {within_m:g} m"
        said.append(f"  the answer is candidate 1{near}; all candidates, best first:")
    if "refusal" in record:
        said.append(f"  no answer: {record['refusal']}")
    said += [
        f"  {rank}. lat {place['lat']:.5f} lon {place['lon']:.5f}  easting "
        f"{place['easting_m']:.0f} northing {place['northing_m']:.0f}  heading "
        f"{place['heading_deg']:.1f} from true north  pitch {place['pitch_deg']:.1f}  fov "
        f"{place['fov_deg']:.1f}  "
        f"{_how_sure(place)}{'' if place['refined'] else '  (unrefined)'}"
        for rank, place in enumerate(places, start=1)
    ]
    if 0 < len(places) < asked_for:
        count = f"{len(places)} of {asked_for} candidates"
        said.append(f"  {count}: no other place was worth refining to the end")
    beyond = beyond_in_words(places[0]["beyond_share"]) if places else None
    said += [f"  {beyond}"] if beyond else []
    if "lens" in record:
        said.append(f"  field of view: {_lens_in_words(record['lens'])}")
    if "exif" in record:
        heading_deg = places[0]["heading_deg"] if places else None
        is_answer = record["answer"] is not None
        said.append(f"  {claim_in_words(record['exif'], heading_deg, is_answer)}")
    return said


def describe_together(queries: Sequence[str], result: JointResult, loading_seconds: float) -> Facts:
    """Return what was found for photos of one place, in the public JSON's terms.

    Places are candidates without their cameras; each photo that agrees has its own at the best.
    """
    places = [
        {name: value for name, value in record.items() if name not in _OF_CAMERA}
        for record in describe_candidates(result.places)
    ]
    photos = []
    for query, one, agrees in zip(queries, result.results, result.agrees, strict=True):
        camera = dict(describe_candidates(one.candidates[:1])[0]) if agrees else {}
        about = {name: camera[name] for name in _OF_CAMERA if agrees} or {"refusal": one.refusal}
        photos.append({"query": query, "agrees": agrees, **about})
    return {
        "answer": places[0] if result.answer else None,
        "answer_within_m": result.within_m,
        "candidates": places,
        **({"refusal": result.refusal} if result.refusal else {}),
        "photos": photos,
        "seconds": result.seconds,
        "loading_seconds": loading_seconds,
    }


def together_in_words(queries: Sequence[str], result: JointResult) -> list[str]:
    """Return what was found for photos of one place as lines for a person."""
    said = [f"{len(queries)} photos of one place ({result.seconds:.2f} s)"]
    if result.answer is not None:
        near = f"right within {result.within_m:g} m"
        said.append(f"  the answer is place 1, {near}; all places, best first:")
    if result.refusal:
        said.append(f"  no answer: {result.refusal}")
    said += [
        f"  {rank}. lat {place.lat:.5f} lon {place.lon:.5f}  easting {place.easting_m:.0f} "
        f"northing {place.northing_m:.0f}  within {place.radius_m:.0f} m (68 %)  confidence "
        f"{place.confidence:.2f} (1 km: {place.confidence_1km:.2f})"
        for rank, place in enumerate(result.places, start=1)
    ]
    for query, one in zip(queries, result.results, strict=True):
        for camera in one.candidates[:1]:
            look = f"heading {camera.heading_deg:.1f} from true north  pitch {camera.pitch_deg:.1f}"
            said.append(f"  {query}: {look}  fov {camera.fov_deg:.1f}")
        if not one.candidates:
            said.append(f"  {query}: does not agree: {one.refusal}")
    return said


def _lens_in_words(lens: LensRecord) -> str:
    if lens["fov_deg"] is None:
        return f"not known; {lens['said']}"
    sure = "" if lens["sd_deg"] is None else f", give or take {lens['sd_deg']:.0f}"
    return f"{lens['fov_deg']:.1f} degrees{sure}; {lens['said']}"


def _how_sure(place: CandidateRecord) -> str:
    if place["confidence"] is None:
        return f"score {place['score']:.3f}"
    return f"confidence {place['confidence']:.2f} (1 km: {place['confidence_1km']:.2f})"


def describe_gl() -> Facts:
    """Return which OpenGL was chosen and why."""
    return dict(describe_context())


def describe_terrain(field: HeightField) -> Facts:
    """Return the facts of a height field."""
    west, south, east, north = field.bounds_m
    lon, lat = field.frame.to_lonlat([west, east, west, east], [south, south, north, north])
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
        "bounds_deg": [float(v) for v in (lon.min(), lat.min(), lon.max(), lat.max())],
        "height_range_m": [low, high],
        "convergence_deg": float(field.frame.convergence_deg(*centre)),
        "filled": field.provenance.filled,
        "hollow": field.provenance.hollow,
        "despiked": field.provenance.despiked,
        "undeclared": field.provenance.undeclared,
        "digest": field.digest,
    }


def describe_scene(eye: Viewpoints, config: RenderConfig, needs: SceneNeeds, views: Views) -> Facts:
    """Return what was modelled for one viewpoint, what was left out, and at what cost.

    Parameters
    ----------
    eye : Viewpoints
        One viewpoint.
    config : RenderConfig
    needs : SceneNeeds
    views : Views
        Its four views at tolerance 0, and then the same as configured.
    """
    curved = config.curvature.enabled
    full, given = views.elevation_tan[:4], views.elevation_tan[4:]
    short_px = np.nanmax(full - given, initial=0.0) / pixel_size(config.width)
    depth_m = views.depth_m[:4]
    flagged = float((views.flags[:4] != 0).mean())
    facts: Facts = {
        "easting_m": float(eye.easting_m[0]),
        "northing_m": float(eye.northing_m[0]),
        "eye_elevation_m": float(eye.eye_elevation_m[0]),
        "width": config.width,
        "tolerance_px": config.tolerance_px,
        "skyline_depth_m": [float(v) for v in np.nanquantile(depth_m, [0.0, 0.5, 1.0])]
        if np.isfinite(depth_m).any()
        else [],
        "flagged_columns": flagged,
        "data_reach_m": needs.data_reach_m,
        "sight_m": needs.sight_m,
        "samples_beyond_sight": needs.beyond_sight,
        "curvature": "modelled" if curved else "left out (--no-curvature)",
        "curvature_bound_px": needs.curvature_px,
        "passed_over_bound_px": config.tolerance_px,
        "passed_over_measured_px": float(short_px),
    }
    for step in needs.steps:
        facts[f"every_{step.step}_samples"] = (
            f"deviates by {step.deviation_m:.1f} m in the median block; within the tolerance in "
            f"{100.0 * step.share:.1f} % of blocks; not used: all samples are kept"
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
            lon, lat = frame.to_lonlat(eyes.easting_m, eyes.northing_m)
            facts["locations"] = len(np.unique(eyes.easting_m + 1j * eyes.northing_m))
            if header.holds == PLACES:
                spacing_m = 2.0 * np.concatenate(
                    [block.tolerance_m for block in store.places().blocks()]
                )
                facts["spacing_m"] = [float(v) for v in np.quantile(spacing_m, [0.0, 0.5, 1.0])]
            facts["bounds_deg"] = [float(v) for v in (lon.min(), lat.min(), lon.max(), lat.max())]
        return facts


def _describe_coding(header: StoreHeader) -> Facts:
    """Return how far compact rows may be from what was rendered."""
    if header.coding is None:
        return {}
    return {
        "tan_error_px": header.coding.tan_error_px(header.width),
        "depth_error": header.coding.depth_error,
    }
