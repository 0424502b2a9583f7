"""Where elevation tiles lie: one address for each degree of latitude and longitude."""

import math
import string
from dataclasses import dataclass
from typing import Self
from urllib.parse import urlsplit

from skyline.errors import InputError
from skyline.geodesy import Bounds, check_bounds

MAX_TILES = 64
"""The largest fetch: 8 x 8 degrees."""

SOURCES = {
    "copernicus": (
        "https://copernicus-dem-30m.s3.amazonaws.com/"
        "Copernicus_DSM_COG_10_{ns}{lat:02d}_00_{ew}{lon:03d}_00_DEM/"
        "Copernicus_DSM_COG_10_{ns}{lat:02d}_00_{ew}{lon:03d}_00_DEM.tif"
    )
}
"""Sources with a name: Copernicus GLO-30, a surface model of 1 arc-second, as AWS hosts it."""

_FIELDS = ("lat", "lon", "ns", "ew")
_ARC_SECOND_BYTES = 4 * 3600**2


@dataclass(frozen=True, slots=True, order=True)
class DegreeTile:
    """A square degree, named by its south-west corner."""

    lat: int
    lon: int
    """``lat``, ``lon``: degrees; north and east are positive."""

    @property
    def name(self) -> str:
        """As SRTM names it: N46E009, S01W070."""
        fields = self.fields
        return f"{fields['ns']}{fields['lat']:02d}{fields['ew']}{fields['lon']:03d}"

    @property
    def fields(self) -> dict[str, int | str]:
        """What a template's fields stand for; the numbers are absolute."""
        return {
            "lat": abs(self.lat),
            "lon": abs(self.lon),
            "ns": "N" if self.lat >= 0 else "S",
            "ew": "E" if self.lon >= 0 else "W",
        }


@dataclass(frozen=True, slots=True)
class TileSource:
    """A template of addresses.

    Raises `InputError` for what is no http(s) address, or a field that is none of these.
    """

    template: str
    """An http or https address. ``{lat}``, ``{lon}`` are the whole degrees, without sign, of a
    tile's south-west corner, ``{ns}``, ``{ew}`` its hemispheres (N or S, E or W); numbers take a
    format, as in ``{lat:02d}``. Without any of them the address is one file over all."""

    def __post_init__(self) -> None:
        try:
            address = urlsplit(self.url(DegreeTile(0, 0)))
            usable = address.scheme in ("http", "https") and bool(address.hostname)
        except (ValueError, KeyError) as error:
            raise InputError(
                f"source {self.template!r} is not understood ({error}); expected an address with "
                "the fields {lat}, {lon}, {ns}, {ew}, e.g. "
                "https://host/{ns}{lat:02d}{ew}{lon:03d}.tif"
            ) from error
        if not usable:
            raise InputError(
                f"source {self.template!r} is not an http or https address; give one, or the name "
                f"of a source: {', '.join(SOURCES)}"
            )

    @classmethod
    def named(cls, name: str) -> Self:
        """Return the source of that name in `SOURCES`, or the one whose template it is."""
        return cls(SOURCES.get(name, name))

    @property
    def tiled(self) -> bool:
        """Whether there is a file a degree."""
        return any(field for _, field, _, _ in string.Formatter().parse(self.template))

    def url(self, tile: DegreeTile) -> str:
        """Return the address of a tile."""
        for _, field, _, conversion in string.Formatter().parse(self.template):
            # format() would follow attributes and indices of a field, which no template needs.
            if field is not None and (field not in _FIELDS or conversion):
                raise ValueError(f"unknown field {field!r}")
        return self.template.format(**tile.fields)

    def tiles(self, bounds_deg: Bounds) -> list[DegreeTile]:
        """Return the tiles that bounds need, from the south-west, row by row.

        Raises `InputError` for bounds that are not numbers in order, or that need more than
        `MAX_TILES`.
        """
        west, south, east, north = check_bounds(bounds_deg)
        if not self.tiled:
            return [DegreeTile(math.floor(south), math.floor(west))]
        lats = range(math.floor(south), math.ceil(north))
        lons = range(math.floor(west), math.ceil(west + (east - west) % 360.0))
        count = len(lats) * len(lons)
        if count > MAX_TILES:
            size_gb = (north - south) * ((east - west) % 360.0) * _ARC_SECOND_BYTES / 1e9
            raise InputError(
                f"bounds {west:g},{south:g},{east:g},{north:g} need {count} tiles, about "
                f"{size_gb:.1f} GB at one arc-second; at most {MAX_TILES} tiles are fetched at a "
                "time: choose smaller bounds"
            )
        return [DegreeTile(lat, (lon + 180) % 360 - 180) for lat in lats for lon in lons]
