"""Reports of matches: a folder with one page, its pictures, and GeoJSON."""

from __future__ import annotations

import contextlib
import datetime
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from skyline.arrays import UInt8Array
from skyline.errors import InputError, OffMapError
from skyline.files.disk import REPORT_PAGE, write_whole
from skyline.match.areas import terrain_at_hand
from skyline.match.matcher import Matcher
from skyline.match.result import MatchResult, listed
from skyline.photo.read import read_picture
from skyline.photo.skyline import PhotoSkyline
from skyline.pose.outlines import Ellipse
from skyline.pose.pose import COLUMNS, Pose
from skyline.report.exports import export_matches
from skyline.report.figure_files import encode_figure
from skyline.report.folder import CANDIDATES, check_report_folder
from skyline.report.html import figures, page, picture, section, table, text
from skyline.report.labels import UnnamedPeaks
from skyline.report.maps import detail_area, draw_match_map, overview_area
from skyline.report.overlay import draw_overlay
from skyline.store.layout import PACKAGE_VERSION
from skyline.view.peaks import Peaks
from skyline.view.sightings import Sighting
from skyline.view.viewer import SeenPeak, Sight, Viewer, peaks_in_picture


def report_matches(
    folder: str | Path,
    matcher: Matcher,
    results: Iterable[MatchResult],
    peaks: Peaks | None = None,
    photos: Iterable[UInt8Array | None] | None = None,
    done: str = "",
    served: tuple[str, str] | None = None,
) -> Path:
    """Write a report into a folder, and return its page.

    The report is ``index.html``, its pictures and ``matches.geojson``. The page embeds its
    pictures, so it can be sent as one file. None of them has the GPS position of a photo's EXIF. If
    a file cannot be written, no new folder is left.

    Parameters
    ----------
    folder : str or Path
        Made if it is missing. Files of an earlier report are replaced.
    matcher : Matcher
        The matcher that made the results. Relief and the candidates' skylines are drawn from its
        terrain, or else from the DEM that its store names; without either they are left out.
    results : iterable of MatchResult
        Each is shown with its photo, its candidates and a map. The first candidate is drawn over
        the photo.
    peaks : Peaks, optional
        Peaks to name in pictures and maps.
    photos : iterable of (H, W, 3) uint8 or None, optional
        RGB of each result's photo, of its skyline's size; None for a trace or a mask. By default
        read from the files that the results are named after.
    done : str
        Sentences about how the results were found.
    served : (str, str), optional
        Command that serves these photos on a page, and the address of that page.

    Raises
    ------
    InputError
        A photo cannot be read, a file cannot be written, or a file of another origin would be
        replaced.
    """
    folder = Path(folder)
    results = listed(results)
    check_report_folder(folder)
    if photos is None:
        photos = (read_picture(one.name) if one.name else None for one in results)
    terrain = matcher.terrain or terrain_at_hand(matcher.header, "no relief")
    viewer = None
    if terrain is not None:
        viewer = Viewer(
            terrain,
            peaks,
            curvature=matcher.header.curvature,
            render_thread=matcher.render_thread,
        )
    with viewer or contextlib.nullcontext():
        shown = [
            _section(number, one, photo, matcher, viewer, done)
            for number, (one, photo) in enumerate(zip(results, photos, strict=True), start=1)
        ]
    sections = [html for html, _ in shown]
    if served is not None:
        how = f"To mend a skyline or to place a camera by hand, run: {served[0]}"
        sections.insert(0, text(how, links=[(served[1], "Then open the page.")]))
    lead = _answered(results) + _about(viewer)
    today = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")
    made_by = f"skyline {PACKAGE_VERSION} {today}"
    is_new = not folder.exists()
    path = folder / REPORT_PAGE
    try:
        # The page first: its mark says whose the other files are, should this be stopped.
        write_whole(path, page("Where the photos were taken", lead, sections, made_by))
        for one in (drawn for _, pictures in shown for drawn in pictures):
            write_whole(folder / one.name, one.data)
        export_matches(folder / CANDIDATES, results, matcher.frame)
    except InputError:
        if is_new:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    return path


@dataclass(frozen=True, slots=True)
class _Picture:
    """A picture of the report."""

    name: str
    """Name of its file."""
    data: bytes
    """PNG or JPEG."""
    caption: str
    is_wide: bool = False
    """Whether it has the whole width of the page."""


def _answered(results: Sequence[MatchResult]) -> str:
    """Return the number of answered searches in words.

    Empty if all poses were set by hand.
    """
    searched = [one for one in results if one.best is None or one.best.rank]
    answered = sum(one.answer is not None for one in searched)
    return f"{answered} of {len(searched)} photos answered. " if searched else ""


def _about(viewer: Viewer | None) -> str:
    """Return sentences on the elevation model and the names of peaks."""
    if viewer is None:
        return (
            "There was no elevation model, so the maps have no relief, no skyline could be "
            "rendered for the candidates and no peak is named (give --dem)."
        )
    if viewer.peaks is None:
        return "No file of peaks was given, so no peak is named (--peaks FILE)."
    return (
        f"Of {len(viewer.peaks)} peaks given, the ones that the camera sees are named: "
        "no terrain of the elevation model hides them."
    )


def _section(
    number: int,
    result: MatchResult,
    photo: UInt8Array | None,
    matcher: Matcher,
    viewer: Viewer | None,
    done: str,
) -> tuple[str, list[_Picture]]:
    """Return the section of one result, and its pictures."""
    skyline = result.skyline
    best = result.best
    sight: Sight | None = None
    sightings: list[Sighting] = []
    peaks: list[SeenPeak] = []
    if best is not None and viewer is not None:
        with contextlib.suppress(OffMapError):
            sight = viewer.look(best, skyline)
            sightings = viewer.sightings(best)
            peaks = peaks_in_picture(best, skyline, sightings)
    overlay, unnamed = draw_overlay(skyline, photo, best, sight, peaks)
    caption = _overlay_caption(skyline, best, sight, unnamed)
    pictures = [
        _Picture(f"{number:02d}-overlay.jpg", overlay, caption, is_wide=True),
        *_maps(number, result.candidates, matcher, viewer, sightings),
    ]
    parts = [
        text(result.summary, _kind(result), () if best is None else _map_links(best)),
        figures(picture(one.data, one.caption, wide=one.is_wide) for one in pictures),
    ]
    if result.candidates:
        parts.append(_candidate_table(result.candidates))
    how = " ".join(filter(None, ["What was done:", done, f"It took {result.seconds:.2f} s."]))
    lens = "" if skyline.lens is None else skyline.lens.in_words
    notes = result.exif_in_words(with_place=False), lens, result.beyond, how
    return section(result.name, [*parts, *(text(note) for note in notes if note)]), pictures


def _maps(
    number: int,
    candidates: Sequence[Pose],
    matcher: Matcher,
    viewer: Viewer | None,
    sightings: Sequence[Sighting],
) -> list[_Picture]:
    """Draw a map of all candidates, and perhaps one of the first.

    The second map is drawn if its side is less than 0.4 of the first one's.
    """
    terrain = None if viewer is None else viewer.terrain
    viewpoints = matcher.viewpoints
    whole = overview_area(candidates or [viewpoints], terrain)
    areas = [("map", whole, "Candidates by rank; wedges show their fields of view")]
    if candidates:
        near = detail_area(candidates[0], terrain)
        if near.width < 0.4 * whole.width:
            ellipse = ", its ellipse 95 % of where it may be" if candidates[0].covariance_m2 else ""
            title = candidates[0].title
            areas.append(("detail", near, f"{title[0].upper()}{title[1:]} from nearby{ellipse}"))
    maps = []
    for kind, area, caption in areas:
        figure = draw_match_map(candidates, area, matcher.frame, viewpoints, terrain, sightings)
        words = f"{caption}. The arrow points to true north."
        maps.append(_Picture(f"{number:02d}-{kind}.png", encode_figure(figure), words))
    return maps


def _kind(result: MatchResult) -> str:
    """Return the kind of the result; see `skyline.report.html.text`."""
    if result.best is not None and result.best.rank != 1:
        return "pose"
    return "answer" if result.answer is not None else "refusal"


def _map_links(candidate: Pose) -> list[tuple[str, str]]:
    """Return links to maps at a candidate, with their words."""
    lat, lon, *_ = candidate.cells()
    address = f"https://www.openstreetmap.org/?mlat={lat}&mlon={lon}#map=14/{lat}/{lon}"
    return [(address, "On OpenStreetMap."), (f"geo:{lat},{lon}", "In a map program.")]


def _overlay_caption(
    skyline: PhotoSkyline, pose: Pose | None, sight: Sight | None, unnamed: UnnamedPeaks
) -> str:
    """Return the caption of a photo with its skylines."""
    trusted = 100.0 * float(skyline.trusted.mean())
    caption = f"Skyline found in {trusted:.0f} % of the columns"
    if pose is None or sight is None or sight.median_gap_deg is None:
        return f"{caption}; no skyline was rendered to compare it with{unnamed.named}."
    return (
        f"{caption}, and the skyline rendered at {pose.title}; they are "
        f"{sight.median_gap_deg:.2f}° apart in the median column, up or down{unnamed.named}."
    )


def _candidate_table(candidates: Sequence[Pose]) -> str:
    rows = []
    for one in candidates:
        ellipse = Ellipse.of(one)
        axes_m = f"{ellipse.semi_major_m:.0f} × {ellipse.semi_minor_m:.0f}" if ellipse else "–"
        refined = "yes" if one.refined else "no"
        rows.append([str(one.rank or "–"), *one.cells(), refined, axes_m])
    columns = ("#", *COLUMNS, "refined", "95 % ellipse, m")
    return table(columns, rows, "Candidates, best first; headings from true north")
