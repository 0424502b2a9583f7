"""Helpers for tests of the command line."""

import math
import re

from PIL import Image
from PIL.ExifTags import GPS, IFD
from PIL.TiffImagePlugin import IFDRational

from skyline import read_dem


def csv_of(path, rows, header="easting,northing"):
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def trace_of(path, wave_px, notes=""):
    """Write a trace of even hills, 2 pi times as wide; return its path."""
    rows = [f"{q},{40 + 10 * math.sin(q / wave_px):.2f}" for q in range(160)]
    return csv_of(path, rows, f"# width=160 height=120{notes}\ncolumn_px,row_px")


def full_name(name):
    """Return the full name of a function that a command or a task calls."""
    return f"skyline.{name}" if name.startswith("tasks.") else f"skyline.cli.{name}"


def assert_refused(done, message=""):
    """Require that a command has refused its input in one line, with a message if given."""
    assert done.code == 2, done
    assert message in done.err
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1
    assert done.out == ""


def headings(out):
    """Return the headings of each printed table, which a rule of dashes follows."""
    lines = out.splitlines()
    rules = [number for number, line in enumerate(lines) if set(line.strip()) == {"─"}]
    return [re.split(r"\s{2,}", lines[number - 1].strip()) for number in rules]


def lonlat_of(dem, easting_m=601_800.0, northing_m=5_178_000.0):
    """Return a place on a DEM in degrees, by default where the photo was taken."""
    lon, lat = read_dem([dem]).frame.to_lonlat(easting_m, northing_m)
    return float(lon), float(lat)


def off_m(place, easting_m=601_800.0, northing_m=5_178_000.0):
    """Return how far a candidate is from where the photo was taken."""
    return math.hypot(place["easting_m"] - easting_m, place["northing_m"] - northing_m)


def gps_of(lon, lat):
    """Return the GPS tags of a position."""

    def written(angle):
        return IFDRational(round(abs(angle) * 1e6), 1_000_000), 0.0, 0.0

    return {
        GPS.GPSLongitude: written(lon),
        GPS.GPSLongitudeRef: "EW"[lon < 0.0],
        GPS.GPSLatitude: written(lat),
        GPS.GPSLatitudeRef: "NS"[lat < 0.0],
    }


def noting(photo, path, camera=None, gps=None, size=None):
    """Write a photo, or the part of it of a size, with tags of camera and GPS in its EXIF."""
    with Image.open(photo) as image:
        exif = image.getexif()
        for part, tags in ((IFD.Exif, camera), (IFD.GPSInfo, gps)):
            exif.get_ifd(part).update(tags or {})
        image.crop((0, 0, *(size or image.size))).save(path, exif=exif, quality=95)
    return path
