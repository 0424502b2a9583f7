"""Reports of matches: what a store's terrain and a renderer add to what was found."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from skyline.match.matcher import Matcher
from skyline.match.rendered_scene import RenderedScene
from skyline.match.results import MatchResult
from skyline.photo.read import read_picture
from skyline.render.horizon import RenderConfig
from skyline.report.matched import Matched, Surroundings
from skyline.report.peaks import Peaks
from skyline.store.format import package_version
from skyline.store.stored_dem import curvature_of
from skyline.terrain.heightfield import HeightField

_PICTURE_WIDTH = 2048
"""Columns of a view drawn over a photo: about one a pixel at 1600 px and 60 degrees."""


def report_matches(
    folder: Path,
    matcher: Matcher,
    matches: Iterable[Matched],
    terrain: HeightField | None,
    peaks: Peaks | None = None,
) -> Path:
    """Write a page of matches, its pictures and GeoJSON into a folder; return the page.

    Parameters
    ----------
    matcher : Matcher
        That made the matches.
    matches : iterable of Matched
        See `matched`.
    terrain : HeightField, optional
        Of the matcher's store, for relief and for the candidates' skylines.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    from skyline.report.match_report import write_match_report  # noqa: PLC0415  (slow to load)

    frame, places, told = matcher.frame, matcher.viewpoints, list(matches)
    made_by = f"skyline {package_version()}"
    if terrain is None:
        return write_match_report(folder, told, Surroundings(frame, places), made_by)
    curvature = curvature_of(matcher.header)
    config = RenderConfig(width=_PICTURE_WIDTH, curvature=curvature)
    scene = RenderedScene(terrain, config, matcher.render_thread)
    try:
        around = Surroundings(frame, places, terrain, scene.render, peaks, curvature)
        return write_match_report(folder, told, around, made_by)
    finally:
        scene.release()


def matched(
    path: str | Path, result: MatchResult, done: Sequence[str] = (), with_photo: bool = True
) -> Matched:
    """Return a match as reports and exports take it.

    Parameters
    ----------
    path : str or Path
        The query's file.
    done : sequence of str
        What was done, a sentence each.
    with_photo : bool
        Whether the photo is read again for its pixels.
    """
    return Matched(
        str(path),
        result.query,
        result.candidates,
        result.seconds,
        result.answer is not None,
        read_picture(path) if with_photo else None,
        done,
        result.within_m,
    )
