"""How a camera was held, as sentences, JSON and rows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from skyline.angles import wrapped_deg
from skyline.errors import printable
from skyline.match.noted_errors import noted_heading_sd_deg
from skyline.match.result import NORTHS, to_dataframe
from skyline.photo.skyline import PhotoSkyline
from skyline.pose.pose import Pose
from skyline.pose.pose_errors import ANGLES

if TYPE_CHECKING:
    from pandas import DataFrame

RIGHT_DEG = 1.0
"""Largest error of a heading that is right."""
LEAST_CONFIDENCE = 0.85
"""Least confidence of a heading that is trusted. It was chosen on the Sierra, Rofental and Everest:
none of 169 photos from other regions reaches it, and 2 % of the headings that reach it are wrong.
At 0.8, 4 % are wrong."""
LEAST_LIKELY = 0.5
"""Least confidence of a heading that is more likely right than wrong, trusted or not."""
_COMPASS_SDS = 0.5
"""A compass that is off by more than this many of its standard deviations is mentioned: 10
degrees from true north, 15 from magnetic north."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Orientation:
    """How a camera was held at a known place.

    Attributes
    ----------
    skyline : PhotoSkyline
        The skyline that was fitted.
    pose : Pose or None
        The best pose; None if nothing fits. Its place is the known one, moved as the skyline asks.
    heading_sd_deg, pitch_sd_deg, roll_sd_deg, fov_sd_deg : float
        Standard errors of the pose's angles, degrees; NaN without a pose.
    confidence : float
        Estimated probability that the heading is right within 1 degree.
    moved_m : float
        Distance of the pose from the known place; NaN without a pose.
    eye_height_m : float
        Height of the eye above the DEM's ground; NaN without a pose.
    seconds : float
        From the photo to the pose.
    refusal : str or None
        Why the pose cannot be trusted; None if it can.
    lacks_confidence_only : bool
        Whether the low confidence is the only reason not to trust the pose.
    name : str
        The photo's file; empty for a skyline.
    """

    skyline: PhotoSkyline
    pose: Pose | None
    heading_sd_deg: float = math.nan
    pitch_sd_deg: float = math.nan
    roll_sd_deg: float = math.nan
    fov_sd_deg: float = math.nan
    confidence: float = 0.0
    moved_m: float = math.nan
    eye_height_m: float = math.nan
    seconds: float = 0.0
    refusal: str | None = None
    lacks_confidence_only: bool = False
    name: str = ""

    def __repr__(self) -> str:
        pose = self.pose
        held = "no pose fits"
        if pose is not None:
            angles = (
                f"{name} {getattr(pose, f'{name}_deg'):.2f} +- {sd_deg:.2f}"
                for name, sd_deg in self.sds_deg.items()
            )
            held = f"{', '.join(angles)} degrees, confidence {self.confidence:.2f}"
        return f"Orientation({held}{f'; not trusted: {self.refusal}' if self.refusal else ''})"

    @property
    def sds_deg(self) -> dict[str, float]:
        """Standard errors of heading, pitch, roll and field of view, degrees."""
        return {name: getattr(self, f"{name}_sd_deg") for name in ANGLES}

    @property
    def answer(self) -> Pose | None:
        """The pose, if it can be trusted."""
        return None if self.refusal else self.pose

    @property
    def likely(self) -> Pose | None:
        """The pose, if it is trusted or more likely right than wrong."""
        is_likely = self.lacks_confidence_only and self.confidence >= LEAST_LIKELY
        return self.pose if is_likely else self.answer

    @property
    def heading_off_deg(self) -> float | None:
        """How far the pose's heading is clockwise of the photo's, degrees.

        None without a pose, or if the photo notes no heading.
        """
        if self.pose is None or self.skyline.noted.heading_deg is None:
            return None
        return float(wrapped_deg(self.pose.heading_deg - self.skyline.noted.heading_deg))

    @property
    def _compass_in_words(self) -> str | None:
        """A sentence on the photo's compass, if unusually far off."""
        noted = self.skyline.noted
        off_deg = self.heading_off_deg
        usual_deg = _COMPASS_SDS * noted_heading_sd_deg(noted)
        if off_deg is None or abs(off_deg) <= usual_deg:
            return None
        return (
            f"EXIF's compass says {noted.heading_deg:.0f} degrees{NORTHS[noted.is_magnetic]}, "
            f"which is {abs(off_deg):.0f} degrees off"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the orientation as ``skyline orient --json`` prints it."""
        pose = {} if self.pose is None else self.pose.to_dict()
        lists = {"wander": pose.get("wander", ()), "covariance": pose.get("covariance")}
        return self.to_row() | self.skyline.form | lists

    def to_dataframe(self) -> DataFrame:
        """Return the orientation as a pandas DataFrame of one row."""
        return to_dataframe([self])

    def to_row(self) -> dict[str, Any]:
        """Return the row of ``skyline orient -o``."""
        pose = {} if self.pose is None else self.pose.to_dict()
        row: dict[str, Any] = {"photo": printable(self.name), "trusted": int(not self.refusal)}
        for angle, sd_deg in self.sds_deg.items():
            row[f"{angle}_deg"] = pose.get(f"{angle}_deg")
            row[f"{angle}_sd_deg"] = None if self.pose is None else sd_deg
        for name in ("distortion", "lon", "lat", "eye_elevation_m", "residual_deg"):
            row[name] = pose.get(name)
        return row | {
            "moved_m": None if self.pose is None else self.moved_m,
            "eye_height_m": None if self.pose is None else self.eye_height_m,
            "confidence": self.confidence,
            "heading_off_deg": self.heading_off_deg,
            "seconds": self.seconds,
            "refusal": self.refusal and printable(self.refusal),
        }

    def to_text(self) -> str:
        """Return the lines that ``skyline orient`` prints."""
        lines = [f"{printable(self.name) or 'photo'} ({self.seconds:.2f} s)"]
        if self.refusal:
            lines.append(f"not trusted: {self.refusal}")
        if self.pose is not None:
            lines.append(self.pose.angles_in_words(self.sds_deg))
            lines.append(
                f"the heading is right within {RIGHT_DEG:g} degree with confidence "
                f"{self.confidence:.2f}"
            )
            lines.append(
                f"the eye is {self.moved_m:.0f} m from the place given, and "
                f"{self.eye_height_m:.0f} m above the ground"
            )
            lines.append(self._compass_in_words or "")
        if self.skyline.lens is not None:
            lines.append(self.skyline.lens.in_words)
        return "\n  ".join(filter(None, lines))
