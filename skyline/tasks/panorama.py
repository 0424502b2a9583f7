"""A drawing of the view from a position."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skyline.errors import suffix_of
from skyline.report.panorama_view import PanoramaConfig, panorama_view
from skyline.tasks.listener import Listener
from skyline.tasks.standing import stand_with_notes
from skyline.tasks.terrain import read_terrain
from skyline.terrain.surface_model import read_surface
from skyline.view.peaks import read_peaks


@dataclass(frozen=True, slots=True, kw_only=True)
class PanoramaTask:
    """A position, what to draw there, and the file to write."""

    dem: Sequence[str]
    """Elevation files, or folders of them."""
    crs: str | None = None
    """CRS of elevation files that name none."""
    position: tuple[float, float]
    """Longitude and latitude, degrees (WGS 84)."""
    config: PanoramaConfig
    peaks: Path | None = None
    """Gazetteer."""
    surface: Sequence[str] = ()
    """Files of a surface or canopy model, or folders of them."""
    output: Path
    """File of the kinds of `PANORAMA_SUFFIXES`."""


def write_panorama(task: PanoramaTask, listener: Listener) -> str:
    """Write the view from a position; return which peaks it names, in words.

    Raises `InputError` for an output of another kind, and as `stand_at` and `read_peaks`.
    """
    from skyline.report import panorama as pictures  # noqa: PLC0415  (slow to load)

    suffix_of(task.output, pictures.PANORAMA_SUFFIXES)
    terrain = read_terrain(listener, task.dem, task.crs)
    height_m, within_m = task.config.eye_height_m, task.config.summit_within_m
    eye = stand_with_notes(terrain, [task.position], height_m, within_m, listener)
    with listener.slow(f"drawing {task.output}"):
        over = read_surface(task.surface, terrain) if task.surface else None
        gazetteer = None if task.peaks is None else read_peaks(task.peaks, terrain.frame)
        view = panorama_view(terrain, eye, gazetteer, task.config, over)
        unnamed = pictures.save_view(view, task.output)
    if gazetteer is None:
        return unnamed.named
    return f", {len(view.sightings)} of {len(gazetteer)} peaks are seen{unnamed.named}"
