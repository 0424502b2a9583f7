"""What the sun needs of a place: its horizon, when the sun is above it, how much sky there is."""

from skyline.solar.horizon_files import SUFFIXES, horizon_csv, write_horizons
from skyline.solar.local_horizons import LocalHorizons
from skyline.solar.sky_view import sky_view_factor
from skyline.solar.sun import sun_above

__all__ = [
    "SUFFIXES",
    "LocalHorizons",
    "horizon_csv",
    "sky_view_factor",
    "sun_above",
    "write_horizons",
]
