"""The area that a store describes, as reports and views draw it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from skyline.errors import OffMapError
from skyline.geodesy import Curvature, Frame
from skyline.match.candidate import Candidate
from skyline.report.peaks import Peaks
from skyline.skylines import Views
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_on

Render = Callable[[Viewpoints, Sequence[int]], Views]
"""Renders N eyes with one heading each."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The area that a store describes, and a function that renders views in it."""

    frame: Frame
    """Frame of the store and of every candidate."""
    viewpoints: Viewpoints
    """The store's viewpoints."""
    terrain: HeightField | None = None
    """The elevation model; without it no relief, no rendered skyline and no peak is drawn."""
    render: Render | None = None
    """Renders the candidates' skylines; given with ``terrain``."""
    peaks: Peaks | None = None
    """Peaks to name."""
    curvature: Curvature = field(default_factory=Curvature)

    def eye_of(self, candidate: Candidate) -> Viewpoints | None:
        """Return a candidate's eye, lifted to the ground from below it; None without terrain."""
        if self.terrain is None:
            return None
        try:
            eye = stand_on(
                self.terrain,
                easting_m=candidate.easting_m,
                northing_m=candidate.northing_m,
                eye_height_m=0.0,
            )
        except OffMapError:
            return None
        np.maximum(eye.eye_elevation_m, candidate.eye_elevation_m, out=eye.eye_elevation_m)
        return eye
