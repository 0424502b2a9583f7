"""What a photo notes of its place, as a prior."""

import numpy as np

from skyline.geodesy import Frame
from skyline.matching.claim import Claim
from skyline.photo.exif import NotedPlace

_GPS_SD_M, _LEAST_GPS_SD_M = 30.0, 15.0
"""Scales of positions without an accuracy, and of those with a good one: the model is off too."""
_LEAST_ALTITUDE_SD_M, _ALTITUDE_ACCURACIES = 15.0, 3.0
"""Heights are two to three times as uncertain as places, and the model's datum may be another."""
_COMPASS_SD_DEG, _MAGNETIC_SD_DEG = 20.0, 30.0
"""The declination, which nothing here knows, is up to 20 degrees where people live. A compass that
does not say which north it points to may point to the magnetic one."""


def claim_of(noted: NotedPlace, frame: Frame) -> Claim | None:
    """Return what a photo notes of its place as a prior in a frame; None where it notes none."""
    if noted.lonlat_deg is None:
        return None
    east, north = (float(value) for value in frame.from_lonlat(*noted.lonlat_deg))
    if not (np.isfinite(east) and np.isfinite(north)):
        return None  # Too far from the frame to have a place in it.
    heading_deg = noted.heading_deg
    if heading_deg is not None:
        heading_deg -= float(frame.convergence_deg(easting_m=east, northing_m=north))
    sd_m = max(_LEAST_GPS_SD_M, noted.accuracy_m or _GPS_SD_M)
    compass_sd_deg = _COMPASS_SD_DEG if noted.is_magnetic is False else _MAGNETIC_SD_DEG
    elevation_m, elevation_sd_m = None, _LEAST_ALTITUDE_SD_M
    if noted.accuracy_m is not None:
        # Who says how good a position is has satellites in view, and corrects for the geoid.
        elevation_m = noted.elevation_m
        elevation_sd_m = max(_LEAST_ALTITUDE_SD_M, _ALTITUDE_ACCURACIES * noted.accuracy_m)
    return Claim(east, north, sd_m, heading_deg, compass_sd_deg, elevation_m, elevation_sd_m)
