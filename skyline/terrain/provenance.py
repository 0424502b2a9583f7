"""Provenance of a height field.

It names the files, the options with which they were read, and the changes to their samples.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields

from pyproj import CRS

from skyline.arrays import ShortRepr
from skyline.errors import InputError
from skyline.geodesy.crs import parse_crs


@dataclass(frozen=True, slots=True)
class DemOptions:
    """Options for reading DEM files.

    Attributes
    ----------
    crs : str or None
        Coordinate reference system (an EPSG code or WKT) of files that name none. Its vertical
        part, as in ``EPSG:2263+6360``, also counts for files that name the same CRS without one.
    """

    crs: str | None = None

    @classmethod
    def from_json(cls, options: object) -> "DemOptions":
        """Return the options that a store holds; the defaults for None.

        Unknown names are left out, since other releases may write more options. Raises `InputError`
        for anything but a mapping.
        """
        if not isinstance(options, Mapping | None):
            raise InputError(f"DEM options are {options!r}; expected names and values")
        names = {field.name for field in fields(cls)}
        return cls(**{name: one for name, one in (options or {}).items() if name in names})

    @property
    def default_crs(self) -> CRS | None:
        """The parsed `crs`; raises `InputError` if it is not understood."""
        return None if self.crs is None else parse_crs(self.crs)


@dataclass(frozen=True, repr=False)
class Provenance(ShortRepr):
    """The files of a height field, and the treatment of their samples.

    Attributes
    ----------
    files : tuple of str
        Absolute paths of the DEM files, empty for a field made in memory.
    resampling : str
        ``"none"`` if the file's own grid is used, else the method and the source CRS.
    filled : int
        Number of samples in voids that were filled by interpolation.
    hollow : int
        Number of samples in voids that were left as holes.
    despiked : int
        Number of samples in spikes, which were removed.
    undeclared : int
        Number of samples in voids that the files do not declare (`skyline.terrain.repair`).
    options : mapping
        The fields of `skyline.DemOptions`.
    conventions : mapping
        Units, datums, axes and the prime meridian of the files by name, in words.
    """

    files: tuple[str, ...] = ()
    resampling: str = "none"
    filled: int = 0
    hollow: int = 0
    despiked: int = 0
    undeclared: int = 0
    options: Mapping[str, object] = field(default_factory=dict)
    conventions: Mapping[str, str] = field(default_factory=dict)
