"""Hypotheses: arrays of camera poses a query may have, and non-maximum suppression among them."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array, IntArray, Rows
from skyline.errors import InputError
from skyline.geodesy import in_turn


@dataclass(frozen=True, slots=True, eq=False)
class Hypotheses(Rows):
    """M poses of the camera that took a query."""

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float64Array
    """``easting_m``, ``northing_m``, ``eye_elevation_m``: (M,) float64. The eye, in the store's
    frame and above the DEM's datum."""
    heading_deg: Float64Array
    """(M,) float64. Grid azimuth of the optical axis, in [0, 360)."""
    pitch_deg: Float64Array
    roll_deg: Float64Array
    fov_deg: Float64Array
    """``pitch_deg``, ``roll_deg``, ``fov_deg``: (M,) float64. Optical axis above the horizon;
    camera turned clockwise as seen from behind; horizontal field of view."""
    distortion: Float64Array
    """(M,) float64. Of the lens; see `QueryRays.distortion_sd`."""
    score: Float64Array
    """(M,) float64. Lower is better; its unit is that of the step that gave it. Infinite where
    nothing fits."""

    @classmethod
    def of_pose(cls, *pose: float) -> "Hypotheses":
        """Return one pose, given in the order of the attributes, that nothing has scored."""
        return cls(*(np.array([float(value)]) for value in (*pose, 0.0)))

    def apart_m(self) -> Float64Array:
        """Return how far the poses stand from one another, (M, M)."""
        place = self.easting_m + 1j * self.northing_m
        return np.asarray(np.abs(place[:, np.newaxis] - place))

    def lead(self, least_m: float) -> Float64Array:
        """Return (M,): score of the best pose farther off than that minus each one's own.

        Infinite where none is so far off.
        """
        rival = np.where(self.apart_m() > least_m, self.score, np.inf).min(axis=1, initial=np.inf)
        return np.asarray(rival - self.score)

    def suppress_non_maxima(
        self, count: int, separation_m: float, turn_deg: float = 360.0
    ) -> IntArray:
        """Return the indices of the best that differ from one another, best first.

        A hypothesis is left out where a better one lies nearer than ``separation_m`` and looks
        within ``turn_deg`` of the same way. Equal scores keep their order; what fits nowhere is
        left out. Raises `InputError` for a ``count`` below 1.
        """
        if count < 1:
            raise InputError(f"count is {count}; expected at least 1 hypothesis")
        place = self.easting_m + 1j * self.northing_m
        left = np.isfinite(self.score)
        chosen: list[int] = []
        for index in np.argsort(self.score, kind="stable"):
            if len(chosen) == count:
                break
            if not left[index]:
                continue
            chosen.append(int(index))
            turn = np.abs(in_turn(self.heading_deg - self.heading_deg[index]))
            left &= (np.abs(place - place[index]) >= separation_m) | (turn > turn_deg)
            left[index] = False
        return np.array(chosen, dtype=np.intp)
