"""Tasks with one photo, whose camera's pose is given or found."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skyline.camera.projection import Projection
from skyline.errors import InputError
from skyline.photo.photo import Photo, read_photo
from skyline.pose.noted_pose import NotedPose
from skyline.pose.pose_files import read_posed
from skyline.tasks.orient import CameraAt


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoTask:
    """A photo, and the elevation of what it shows."""

    photo: Path
    dem: Sequence[str]
    """Elevation files, or folders of them."""
    crs: str | None = None
    """CRS of elevation files that name none."""
    projection: Projection | None = None
    """By default from the pose, else from the photo."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PosedTask(PhotoTask):
    """A photo and its camera's pose."""

    pose: Path
    """File of the pose."""

    def read(self) -> tuple[Photo, NotedPose]:
        """Read the photo and its pose; raises as `read_posed`."""
        return read_posed(self.photo, self.pose, self.projection)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraTask(PhotoTask):
    """A photo, and its camera's pose or what is known of it."""

    at: CameraAt = CameraAt()  # noqa: RUF009  (it is frozen)
    pose: Path | None = None
    """File of the pose, in place of a position."""
    fov_deg: float | None = None
    """By default from the photo."""

    def __post_init__(self) -> None:
        if self.pose is not None and (self.at != CameraAt() or self.fov_deg is not None):
            raise InputError(
                "--pose has the position, the heading and the field of view; leave --at, "
                "--elevation, --heading, --fov-deg and their errors out"
            )

    def read(self) -> tuple[Photo, NotedPose | None]:
        """Read the photo, and its pose if a file has it.

        Raises `InputError` for a photo whose position neither it nor the user gives, and as
        `read_photo` and `read_posed`.
        """
        if self.pose is not None:
            return read_posed(self.photo, self.pose, self.projection)
        photo = read_photo(self.photo, self.fov_deg, projection=self.projection)
        self.at.position_of(photo.noted, str(self.photo))  # Refused before the DEM is read
        return photo, None
