"""Stores with their terrain, in which photos are searched and seen."""

import hashlib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from skyline import (
    InputError,
    Matcher,
    Pose,
    ReliefTiles,
    RenderThread,
    Viewer,
    read_peaks,
    stand_at,
)
from skyline.cache import title_of

_PAGE_ZOOM = 18
"""Greatest zoom of the page's map."""
_NAME_LENGTH = 100


def area_id(stores: Sequence[Path]) -> str:
    """Return the page's name for an area of stores."""
    return hashlib.sha256(repr([str(one.resolve()) for one in stores]).encode()).hexdigest()


class PageArea:
    """Stores of one DEM, opened for many sessions at a time.

    Raises `SkylineError` if the stores, their DEM or the gazetteer cannot be used.

    Parameters
    ----------
    stores : sequence of Path
        Stores of one DEM, searched as one.
    dem : list of str, optional
        Files of that DEM, if they have moved since the stores were built.
    peaks : Path, optional
        Gazetteer of summits; see `skyline.read_peaks`.
    thread : RenderThread
        Renders everything.
    """

    def __init__(
        self,
        stores: Sequence[Path],
        dem: list[str] | None,
        peaks: Path | None,
        thread: RenderThread,
    ) -> None:
        self.id = area_id(stores)
        self.stores = stores
        self.matcher = Matcher(stores, dem, render_thread=thread)
        self.peaks = None if peaks is None else read_peaks(peaks, self.matcher.frame)
        self.relief = None
        self._viewer = None
        if self.matcher.terrain is not None:
            self.relief = ReliefTiles(self.matcher.terrain)
            self._viewer = Viewer(
                self.matcher.terrain,
                self.peaks,
                curvature=self.matcher.header.curvature,
                render_thread=thread,
            )

    @property
    def viewer(self) -> Viewer:
        """The terrain as cameras see it; raises `InputError` without a DEM."""
        if self._viewer is None:
            raise InputError("the store's DEM is not at hand; start skyline serve with --dem DEM")
        return self._viewer

    @cached_property
    def about(self) -> dict[str, Any]:
        """The facts about the stores that the page shows."""
        eyes = self.matcher.viewpoints
        return {
            "id": self.id,
            "store": ", ".join(shown_name(title_of(path)) for path in self.stores),
            "places": self.matcher.rows,
            "bounds": list(
                self.matcher.frame.box_deg(easting_m=eyes.easting_m, northing_m=eyes.northing_m)
            ),
            "terrain": self.relief and list(self.relief.bounds_deg),
            "contours_m": [self.relief.contours_m(zoom) for zoom in range(_PAGE_ZOOM + 1)]
            if self.relief
            else None,
            "peaks": self._viewer is not None and self.peaks is not None,
        }

    @cached_property
    def names(self) -> list[tuple[str, float, float]]:
        """The gazetteer's names with longitude and latitude, highest first."""
        peaks, terrain = self.peaks, self.matcher.terrain
        if peaks is None:
            return []
        lon, lat = self.matcher.frame.to_lonlat(peaks.easting_m, peaks.northing_m)
        height_m = peaks.height_m
        if terrain is not None:
            height_m = terrain.height_at(easting_m=peaks.easting_m, northing_m=peaks.northing_m)
        order = np.argsort(-np.nan_to_num(height_m), kind="stable")
        return [(peaks.names[k], round(float(lon[k]), 6), round(float(lat[k]), 6)) for k in order]

    def height_m(self, lon: float, lat: float) -> float | None:
        """Return the terrain's height at a position; None where unknown."""
        terrain = self.matcher.terrain
        if terrain is None:
            return None
        height = float(terrain.height_at(lon=lon, lat=lat))
        return height if np.isfinite(height) else None

    def eye_height_m(self, pose: Pose) -> float | None:
        """Return the height of a pose's eye above the ground.

        It is the height that `Viewer.pose` takes. An eye below the surface counts as on it. The
        height is None without terrain.
        """
        surface_m = self.height_m(pose.lon, pose.lat)
        if surface_m is None or self.matcher.terrain is None:
            return None
        ground = stand_at(self.matcher.terrain, lon=pose.lon, lat=pose.lat, eye_height_m=0.0)
        return max(surface_m, pose.eye_elevation_m) - float(ground.eye_elevation_m[0])

    def close(self) -> None:
        """Release what renders."""
        if self._viewer is not None:
            self._viewer.close()
        self.matcher.close()


def shown_name(name: str) -> str:
    """Return a file's name without folders and control characters."""
    last = name.replace("\\", "/").rsplit("/", 1)[-1]
    plain = "".join(letter for letter in last if letter.isprintable()).strip()
    return plain[-_NAME_LENGTH:] or "photo"
