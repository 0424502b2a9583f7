"""The terrain one eye sees: how far away it is in every direction, and its ridges.

A renderer's shells are the skylines of adjoining ranges of distance. The highest of the nearer ones
hides what is farther, so that between two of them the eye sees the farther shell.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from skyline.arrays import BoolArray, Float64Array
from skyline.camera import columns_u
from skyline.views import Views

_NOTHING_DEG = -90.0
_RIDGE_JUMP, _RIDGE_SAMPLES = 1.04, 4.0
"""How much farther what is behind a ridge must be: times as far, and samples beyond that."""


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """What one eye sees in C columns, as K shells of distance, the nearest first.

    Attributes
    ----------
    azimuth_deg : (C,) float64
        From true north, increasing from ``start_deg`` of `Landscape.of`.
    top_deg : (K, C) float64
        Highest elevation angle of each shell and all nearer ones: increasing along K; -90 before
        anything is seen.
    top_m : (K, C) float64
        Horizontal distance of each shell's own highest point, NaN where it shows nothing.
    nearest_m : (K, C) float64
        Where each shell begins.
    """

    azimuth_deg: Float64Array
    top_deg: Float64Array
    top_m: Float64Array
    nearest_m: Float64Array

    @classmethod
    def of(cls, views: Views, convergence_deg: float, start_deg: float) -> Self:
        """Return the landscape of one eye's views, which have shells.

        Parameters
        ----------
        views : Views
            Of one viewpoint, any headings.
        convergence_deg : float
            Azimuth from true north minus grid azimuth.
        start_deg : float
            The azimuth from true north that columns are sorted from, clockwise.
        """
        if views.shells is None:
            raise ValueError("the views have no shells")
        ahead_m = np.hypot(1.0, columns_u(views.width))
        azimuth = (views.azimuth_deg().ravel() + convergence_deg - start_deg) % 360.0
        order = np.argsort(azimuth)
        tan = np.moveaxis(views.shells.elevation_tan / ahead_m, 1, 0).reshape(-1, len(order))
        own_deg = np.nan_to_num(np.degrees(np.arctan(tan[:, order])), nan=_NOTHING_DEG)
        top_m = np.moveaxis(views.shells.depth_m * ahead_m, 1, 0).reshape(-1, len(order))
        begins = views.shells.edges_m[:-1, np.newaxis]
        return cls(
            azimuth[order] + start_deg,
            np.maximum.accumulate(own_deg, axis=0),
            np.where(own_deg > _NOTHING_DEG, top_m[:, order], np.nan),
            (begins * np.tile(ahead_m, len(views)))[:, order],
        )

    @property
    def skyline_deg(self) -> Float64Array:
        """The highest elevation angle in each column, (C,)."""
        return np.asarray(self.top_deg[-1])

    @property
    def is_seen(self) -> BoolArray:
        """Whether some of a shell shows over all nearer ones, (K, C)."""
        before = np.vstack([np.full(self.top_deg.shape[1], _NOTHING_DEG), self.top_deg[:-1]])
        return np.asarray(self.top_deg > before)

    def distance_m(self, azimuth_deg: Float64Array, elevation_deg: Float64Array) -> Float64Array:
        """Return how far away what is seen is, (R, P), in the columns nearest to azimuths (P,).

        Parameters
        ----------
        azimuth_deg : (P,) float64
            Within the landscape's own.
        elevation_deg : (R,) float64
            Increasing.

        Returns
        -------
        (R, P) float64
            Horizontal metres; inf for the sky.
        """
        middle = 0.5 * (self.azimuth_deg[1:] + self.azimuth_deg[:-1])
        columns = np.searchsorted(middle, azimuth_deg)
        shells = len(self.top_deg)
        found = np.full((len(elevation_deg), len(columns)), np.inf)
        for pixel, column in enumerate(columns):
            top = self.top_deg[:, column]
            shell = np.searchsorted(top, elevation_deg)
            ground = shell < shells
            at = shell[ground]
            below = np.where(at > 0, top[at - 1], _NOTHING_DEG)
            low = np.where(below > _NOTHING_DEG, below, np.minimum(elevation_deg[0], top[at]))
            share = (elevation_deg[ground] - low) / np.maximum(top[at] - low, 1e-9)
            near, far = self.nearest_m[at, column], self.top_m[at, column]
            found[ground, pixel] = near + np.clip(share, 0.0, 1.0) * (far - near)
        return found

    def ridges(self, spacing_m: float) -> tuple[Float64Array, Float64Array]:
        """Return the lines behind which the terrain drops out of sight, the farthest first.

        Parameters
        ----------
        spacing_m : float
            Of the samples; what drops out of sight within a few of them makes no ridge.

        Returns
        -------
        begins_m : (K,) float64
            Where the shells begin.
        lines_deg : (K, C) float64
            Elevation angles, NaN where a shell has no ridge.
        """
        seen = self.is_seen
        behind = np.full(self.top_deg.shape[1], np.inf)
        lines = np.full(self.top_deg.shape, np.nan)
        for shell in range(len(seen))[::-1]:
            least = _RIDGE_JUMP * self.top_m[shell] + _RIDGE_SAMPLES * spacing_m
            ridge = seen[shell] & (behind > least)
            lines[shell, ridge] = self.top_deg[shell, ridge]
            behind = np.where(seen[shell], self.nearest_m[shell], behind)
        return self.nearest_m.min(axis=1)[::-1], lines[::-1]
