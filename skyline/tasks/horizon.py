"""Horizons round positions, or of a photo, written to a file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skyline.camera.projection import Projection
from skyline.errors import InputError
from skyline.files.disk import check_outputs
from skyline.geodesy.earth import Curvature
from skyline.horizons.horizon import horizons_of, steps_a_turn
from skyline.horizons.local_horizons import LocalHorizons
from skyline.report.horizon_files import check_can_hold, kind_of_horizons, write_horizons
from skyline.tasks.listener import Listener
from skyline.tasks.standing import stand_with_notes, warn_of_border
from skyline.tasks.terrain import curvature_of, read_terrain
from skyline.terrain.heightfield import HeightField
from skyline.terrain.surface_model import read_surface
from skyline.terrain.viewpoints import read_viewpoints


@dataclass(frozen=True, slots=True, kw_only=True)
class HorizonTask:
    """Positions, or a photo with its pose, and the horizons to make."""

    dem: Sequence[str]
    """Elevation files, or folders of them."""
    crs: str | None = None
    """CRS of elevation files that name none."""
    positions: Sequence[tuple[float, float]] = ()
    """Longitudes and latitudes, degrees (WGS 84)."""
    viewpoints: Path | None = None
    """CSV of positions."""
    photo: Path | None = None
    """A photo, a mask or a trace that shows the horizon."""
    pose: Path | None = None
    """File of the photo's pose."""
    projection: Projection | None = None
    """By default from the pose, else from the photo."""
    eye_height_m: float
    summit_within_m: float | None = None
    """As for `stand_on`."""
    step_deg: float
    """Step between azimuths."""
    surface: Sequence[str] = ()
    """Files of a surface or canopy model, or folders of them."""
    refraction_k: float | None = None
    """By default the usual value of the terrain's world."""
    output: Path | None = None
    """File of the kinds of `KINDS`."""

    def check(self) -> None:
        """Check the options and the output.

        Raises `InputError` for options that contradict each other, and for a wrong output.
        """
        if bool(self.positions) + (self.viewpoints is not None) + (self.photo is not None) != 1:
            raise InputError(
                "give positions as --at LON,LAT or as --viewpoints FILE.csv, or a --photo with its "
                "--pose"
            )
        if (self.photo is None) != (self.pose is None):
            raise InputError("one of --photo and --pose is given; expected both or neither")
        if self.photo is not None and self.surface:
            raise InputError("--photo shows trees and houses itself; leave --surface out")
        check_outputs([self.output], filter(None, [self.viewpoints, self.photo, self.pose]))
        if self.output is not None:
            kind_of_horizons(self.output)
        steps_a_turn(self.step_deg)


def find_horizons(task: HorizonTask, listener: Listener) -> LocalHorizons:
    """Return horizons, and write their file.

    Raises as `HorizonTask.check`, `stand_at`, `read_viewpoints` and `photo_horizon`, and
    `InputError` for a file that cannot hold them.
    """
    task.check()
    terrain = read_terrain(listener, task.dem, task.crs)
    curvature = curvature_of(terrain, task.refraction_k)
    if task.photo is not None and task.pose is not None:
        from skyline.tasks.photo_horizon import (  # noqa: PLC0415  (slow to load)
            PhotoHorizonTask,
            photo_horizon,
        )

        shown = PhotoHorizonTask(
            photo=task.photo,
            pose=task.pose,
            step_deg=task.step_deg,
            curvature=curvature,
            projection=task.projection,
        )
        found = photo_horizon(shown, terrain, listener)
    else:
        found = _round_positions(task, terrain, curvature, listener)
    if task.output is not None:
        write_horizons(found, task.output)
    warn_of_border(found)
    return found


def _round_positions(
    task: HorizonTask, terrain: HeightField, curvature: Curvature, listener: Listener
) -> LocalHorizons:
    height_m, within_m = task.eye_height_m, task.summit_within_m
    ids: tuple[str, ...] = ()
    if task.viewpoints is not None:
        eyes, ids = read_viewpoints(task.viewpoints, terrain, height_m, within_m)
    else:
        eyes = stand_with_notes(terrain, task.positions, height_m, within_m, listener)
    if task.output is not None:
        check_can_hold(task.output, len(eyes), bool(task.surface), terrain.frame.lonlat_crs)
    over = read_surface(task.surface, terrain) if task.surface else None
    with listener.progress("rendering") as progress:
        return horizons_of(terrain, eyes, task.step_deg, curvature, progress, over, ids)
