"""The skyline of a photo, written as a trace."""

from dataclasses import dataclass
from pathlib import Path

from skyline.camera.projection import Projection
from skyline.errors import check_suffix, suffix_of
from skyline.files.disk import check_outputs
from skyline.photo.photo import read_photo
from skyline.photo.read import find_skyline
from skyline.photo.skyline import PhotoSkyline
from skyline.photo.trace import TRACES, write_trace
from skyline.report.skyline_overlay import OVERLAYS, write_overlay


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtractTask:
    """A photo, and the files to write."""

    photo: Path
    output: Path
    """The trace."""
    overlay: Path | None = None
    """The photo with its skyline drawn, of the kinds of `OVERLAYS`."""
    fov_deg: float | None = None
    """By default from the photo."""
    projection: Projection | None = None
    """By default from the photo."""
    sky_model: Path | None = None
    """As for `find_skyline`."""


def write_extracted(task: ExtractTask) -> PhotoSkyline:
    """Find the skyline in a photo, and write it.

    Raises `InputError` for files of other kinds, and as `read_photo` and `find_skyline`.
    """
    check_outputs([task.output, task.overlay], [task.photo])
    check_suffix(task.output, TRACES)
    if task.overlay is not None:
        suffix_of(task.overlay, OVERLAYS)
    photo = read_photo(task.photo, task.fov_deg, projection=task.projection)
    skyline = find_skyline(photo, task.sky_model)
    if task.overlay is not None:
        write_overlay(photo.rgb, skyline, task.overlay)
    write_trace(skyline, task.output)
    return skyline
