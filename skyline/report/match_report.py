"""Reports of matches: a folder with one page, its pictures, and GeoJSON."""

import datetime
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skyline.camera import HEADINGS
from skyline.files import write_with_folders
from skyline.match.ranking import Candidate
from skyline.match.records import (
    apart_in_words,
    beyond_in_words,
    claim_in_words,
    confidence_within,
    pose_name,
)
from skyline.match.results import COLUMNS, columns_of
from skyline.photo.query import QuerySkyline
from skyline.report.exports import write_geojson
from skyline.report.figures import encode_figure, unnamed_in_words
from skyline.report.html import figures, page, picture, section, table, text
from skyline.report.maps import detail_area, draw_match_map, overview_area
from skyline.report.matched import Matched, Surroundings
from skyline.report.overlay import draw_overlay
from skyline.report.peaks import HIDDEN_DEG, Sighting, most_prominent_first, visible_peaks
from skyline.report.shapes import Ellipse
from skyline.report.viewer import Panorama, gap_deg

_MAP_DPI = 150.0
_DETAIL_SHARE = 0.4
"""A second map is drawn where it shows less than this share of the first one's side."""


def write_match_report(
    folder: Path, matches: Sequence[Matched], surroundings: Surroundings, made_by: str = ""
) -> Path:
    """Write ``index.html``, its pictures, and ``matches.geojson`` into a folder; return the page.

    The pictures are embedded in the page, so that it can be sent as one file. No file repeats the
    position noted in a photo's EXIF.

    Raises `InputError` if a file cannot be written.

    Parameters
    ----------
    folder : Path
        Created if missing; files of the same names are replaced.
    made_by : str
        The program and its version.
    """
    sections = [
        _section(folder, number, matched, surroundings)
        for number, matched in enumerate(matches, start=1)
    ]
    lead = _answered(matches) + _about(surroundings)
    today = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    content = page("Where these were taken", lead, sections, f"{made_by} {today}".strip())
    write_geojson(folder / "matches.geojson", matches, surroundings.frame)
    path = folder / "index.html"
    write_with_folders(path, content)
    return path


def _answered(matches: Sequence[Matched]) -> str:
    """Return the number of answered searches in words; empty if all poses were set by hand."""
    searched = [one for one in matches if not one.candidates or one.candidates[0].rank]
    answered = sum(one.is_answered and bool(one.candidates) for one in searched)
    return f"{answered} of {len(searched)} queries answered. " if searched else ""


def _about(surroundings: Surroundings) -> str:
    if surroundings.terrain is None:
        return (
            "There was no elevation model at hand: the maps have no relief, no skyline could be "
            "rendered for the candidates and no peak is named (give --dem)."
        )
    if surroundings.peaks is None:
        return "No gazetteer was given, so no peak is named (--peaks FILE.csv)."
    return (
        f"Of {len(surroundings.peaks)} peaks given, those are named that the camera sees: "
        "nothing on the line to them stands more than "
        f"{HIDDEN_DEG:g}° above them in the elevation model."
    )


def _section(folder: Path, number: int, matched: Matched, surroundings: Surroundings) -> str:
    best = matched.candidates[0] if matched.candidates else None
    panorama, sightings = (None, []) if best is None else _view_of(best, surroundings)
    overlay, unnamed = draw_overlay(matched.query, matched.photo, best, panorama, sightings)
    caption = _overlay_caption(matched.query, best, panorama, unnamed)
    parts = [
        text(_result(matched), _kind(matched), None if best is None else _map_link(best)),
        figures(
            [
                picture(_keep(folder / f"{number:02d}-overlay.jpg", overlay), caption),
                *_maps(folder, number, matched.candidates, surroundings, sightings),
            ]
        ),
    ]
    if matched.candidates:
        parts.append(_candidate_table(matched.candidates))
    claim = claim_in_words(matched.query.noted, best, matched.is_answered, with_place=False)
    beyond = beyond_in_words(None if best is None else best.beyond_share)
    done = " ".join(matched.done)
    took = f"What was done: {done} It took {matched.seconds:.2f} s.".replace(":  ", ": ")
    return section(matched.name, [*parts, *(text(one) for one in (claim, beyond, took) if one)])


def _keep(path: Path, data: bytes) -> bytes:
    write_with_folders(path, data)
    return data


def _view_of(best: Candidate, surroundings: Surroundings) -> tuple[Panorama | None, list[Sighting]]:
    """Return the skyline rendered at a candidate and its visible peaks, as far as is possible."""
    eye = surroundings.eye_of(best)
    if eye is None or surroundings.terrain is None:
        return None, []
    panorama: Panorama | None = None
    sightings: list[Sighting] = []
    if surroundings.render is not None:
        four = eye[np.zeros(len(HEADINGS), dtype=np.intp)]
        panorama = Panorama.of(surroundings.render(four, HEADINGS))
    if surroundings.peaks is not None:
        terrain = surroundings.terrain
        seen = visible_peaks(terrain, eye, surroundings.peaks, surroundings.curvature)
        sightings = most_prominent_first(terrain, seen)
    return panorama, sightings


def _maps(
    folder: Path,
    number: int,
    candidates: Sequence[Candidate],
    surroundings: Surroundings,
    sightings: Sequence[Sighting],
) -> list[str]:
    """Draw all candidates, and the first from nearby if that shows more."""
    whole = overview_area(candidates, surroundings)
    areas = [("map", whole, "Candidates by rank; wedges show their fields of view")]
    if candidates:
        near = detail_area(candidates[0], surroundings)
        if near.width_m < _DETAIL_SHARE * whole.width_m:
            ellipse = ", its ellipse 95 % of where it may be" if candidates[0].covariance_m2 else ""
            name = pose_name(candidates[0])
            areas.append(("detail", near, f"{name[0].upper()}{name[1:]} from nearby{ellipse}"))
    pictures = []
    for name, area, caption in areas:
        figure = draw_match_map(candidates, surroundings, area, sightings)
        data = _keep(folder / f"{number:02d}-{name}.png", encode_figure(figure, dpi=_MAP_DPI))
        pictures.append(picture(data, f"{caption}. The arrow points to true north.", wide=False))
    return pictures


def _result(matched: Matched) -> str:
    if not matched.candidates:
        return "No place fits."
    shown = matched.candidates[0]
    confidence = confidence_within(shown, matched.within_m)
    sure = "" if confidence is None else f", confidence {100.0 * confidence:.0f}\N{NO-BREAK SPACE}%"
    if matched.is_answered and matched.within_m is not None:
        sure += f", right within {matched.within_m:g} m"
    place = (
        f"latitude {shown.lat:.5f}°, longitude {shown.lon:.5f}°, looking "
        f"{shown.heading_deg:.1f}° from true north{sure}"
    )
    if shown.rank is None:
        failed = ", and the fit has failed" if shown.refined and not matched.is_answered else ""
        apart = apart_in_words(shown)
        return f"{shown.origin.capitalize()}{failed}: {place}{apart and f'; {apart}'}."
    if shown.rank > 1:
        return f"Candidate {shown.rank}, chosen by a person: {place}."
    if not matched.is_answered:
        return f"Not answered: the best candidate is not sure enough ({place})."
    return f"Taken at {place}{'' if shown.refined else ' (not refined by rendering)'}."


def _kind(matched: Matched) -> str:
    """Return the kind of the result; see `skyline.report.html.text`."""
    if matched.candidates and matched.candidates[0].rank != 1:
        return "pose"
    return "answer" if matched.candidates and matched.is_answered else "refusal"


def _map_link(candidate: Candidate) -> tuple[str, str]:
    place = f"{candidate.lat:.5f}", f"{candidate.lon:.5f}"
    address = "https://www.openstreetmap.org/?mlat={0}&mlon={1}#map=14/{0}/{1}".format(*place)
    return address, "On a map."


def _overlay_caption(
    query: QuerySkyline, pose: Candidate | None, panorama: Panorama | None, unnamed: int
) -> str:
    trusted = 100.0 * float(query.trusted.mean())
    caption = f"Skyline found in {trusted:.0f} % of the columns"
    without_name = unnamed_in_words(unnamed, "; ")
    if pose is None or panorama is None:
        return f"{caption}; no skyline was rendered to compare it with{without_name}."
    apart_deg = np.median(np.abs(gap_deg(pose, query, panorama)))
    return (
        f"{caption}, and the skyline rendered at {pose_name(pose)}; they are "
        f"{apart_deg:.2f}° apart in the median column, up or down{without_name}."
    )


def _candidate_table(candidates: Sequence[Candidate]) -> str:
    rows: list[list[object]] = []
    for candidate in candidates:
        ellipse = Ellipse.of(candidate)
        axes_m = ellipse and f"{ellipse.semi_major_m:.0f} × {ellipse.semi_minor_m:.0f}"
        rows.append([candidate.rank, *columns_of(candidate), candidate.refined, axes_m])
    columns = ("#", *COLUMNS, "refined", "95 % ellipse, m")
    return table(columns, rows, "Candidates; headings from true north, a lower score is better")
