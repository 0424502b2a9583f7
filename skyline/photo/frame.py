"""The frame of a camera, and the part that a file shows.

A file of the frame's shape was at most resized, which changes nothing. A file of another shape was
cropped, and shows at most the frame. A file of a shape that no camera takes was cropped too, even
if the noted size agrees with it: programs that crop note the new size.
"""

from dataclasses import dataclass
from math import sqrt

from PIL.ExifTags import Base

from skyline.photo.sensors import Sensor, cropped_diagonal
from skyline.photo.tags import Tags, positive

Size = tuple[float, float]
"""Width and height."""


@dataclass(frozen=True, slots=True)
class _Shapes:
    """Width over height of frames."""

    of_cameras: tuple[float, ...] = (1.0, 4 / 3, 3 / 2, 16 / 9)
    """The frames that cameras take."""
    of_screens: tuple[float, ...] = (2.0, 37 / 18, 19 / 9, 13 / 6, 20 / 9)
    """The screens for which phones take photos."""
    of_sensors: tuple[float, ...] = (4 / 3, 3 / 2)
    """Sensors, the usual one first: the frame of a camera whose sensor is not known."""
    tolerance: float = 0.02
    """Largest relative difference of two shapes that are the same."""
    blurred_px: float = 6.0
    """Rows that `skyline.photo.borders` takes from a photo, as its borders have blurred them."""


@dataclass(frozen=True, slots=True)
class Crop:
    """The field of view of a crop, over the greatest possible one."""

    left: tuple[float, float] = (0.5, 1.0)
    """Least and greatest share that is left; evenly distributed."""
    most: float = 1.05
    """Greatest share that is searched."""

    @property
    def mean(self) -> float:
        """Mean of the share."""
        return sum(self.left) / 2.0

    @property
    def sd(self) -> float:
        """Standard deviation of the share."""
        return (self.left[1] - self.left[0]) / sqrt(12.0)


_SHAPES = _Shapes()
CROP = Crop()


def frames_of(
    tags: Tags, size_px: tuple[int, int], sensor: Sensor | None
) -> tuple[Size | None, Size]:
    """Return the frame that the camera noted, and the frame taken.

    The first is None if the camera noted none, or one of a shape that no camera takes. For a photo
    taken upright, some cameras note the frame upright and some lying. Of the two, the frame that
    fits the file better counts; if neither fits, the frame of which the file shows a wider part.
    A frame of a shape that no camera takes is replaced by one of the sensor's shape.
    """
    width = positive(tags.get(Base.ExifImageWidth))
    height = positive(tags.get(Base.ExifImageHeight))
    own = float(size_px[0]), float(size_px[1])
    noted = None
    if width is not None and height is not None:

        def fit(frame: Size) -> tuple[bool, bool, float]:
            kept = cropped_width(size_px, frame)
            return is_whole(size_px, frame), is_unscaled(size_px, frame), kept

        noted = max(((width, height), (height, width)), key=fit)
    taken = noted or own
    possible = _SHAPES.of_cameras + _SHAPES.of_screens
    if sensor is not None:
        possible = _SHAPES.of_cameras if noted else (sensor.shape,)
    shape = max(taken) / min(taken)
    if any(abs(shape / one - 1.0) <= _SHAPES.tolerance for one in possible):
        return noted, taken
    whole = _SHAPES.of_sensors[0] if sensor is None else sensor.shape
    return None, (whole, 1.0) if size_px[0] >= size_px[1] else (1.0, whole)


def frame_diagonal(frame: Size, sensor: Sensor | None) -> float:
    """Return a frame's diagonal over the diagonal of its sensor.

    It is below 1 for a frame of another shape, such as 16:9 or a square, which keeps all columns or
    all rows of the sensor. An unknown sensor is taken to have the frame's shape if sensors of that
    shape exist, and otherwise the usual one. A frame wider than 16:9 counts as whole: it may be a
    panorama, and one was no longer recognized when such frames had two readings.
    """
    shape = max(frame) / min(frame)
    shapes = _SHAPES.of_sensors if sensor is None else (sensor.shape,)
    if shape > (1.0 + _SHAPES.tolerance) * max(_SHAPES.of_cameras):
        return 1.0
    if any(abs(shape / one - 1.0) <= _SHAPES.tolerance for one in shapes):
        return 1.0
    return cropped_diagonal(shapes[0], shape)


def is_bordered(size_px: tuple[int, int], photo_px: tuple[int, int]) -> bool:
    """Return whether a photo, but not its file, has a frame's shape.

    The file has a border or a caption, such as phones write below their photos.
    """

    def off(size: Size) -> float:
        shape = max(size) / min(size)
        return min(abs(shape / one - 1.0) for one in _SHAPES.of_cameras + _SHAPES.of_screens)

    return photo_px != size_px and off(photo_px) <= off(size_px) + _SHAPES.blurred_px / min(
        photo_px
    )


def cropped_width(size_px: tuple[int, int], frame: Size) -> float:
    """Return the width of what a file shows of a frame.

    It is in the frame's pixels. The part is the largest one of the file's shape, unless the file is
    unscaled.
    """
    if is_unscaled(size_px, frame):
        return float(size_px[0])
    return size_px[0] * min(frame[0] / size_px[0], frame[1] / size_px[1])


def is_whole(size_px: tuple[int, int], frame: Size, tolerance: float = _SHAPES.tolerance) -> bool:
    """Return whether a file has the shape of a frame."""
    return abs(size_px[0] / size_px[1] / (frame[0] / frame[1]) - 1.0) <= tolerance


def is_unscaled(size_px: tuple[int, int], frame: Size) -> bool:
    """Return whether a file has all columns or rows of a frame."""
    return max(size_px[0] - frame[0], size_px[1] - frame[1]) == 0.0
