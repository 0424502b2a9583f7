"""What tests of the command line share."""

import math

from skyline import read_dem


def csv_of(path, rows, header="easting,northing"):
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def assert_refused(done, message):
    assert done.code == 2, done
    assert message in done.err
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1
    assert done.out == ""


def lonlat_of(dem, easting_m, northing_m):
    lon, lat = read_dem([dem]).frame.to_lonlat(easting_m, northing_m)
    return float(lon), float(lat)


def off_m(place, easting_m=601_800.0, northing_m=5_178_000.0):
    """Return how far a candidate is from where the photo was taken."""
    return math.hypot(place["easting_m"] - easting_m, place["northing_m"] - northing_m)
