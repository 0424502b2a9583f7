"""What a report knows of the place it speaks of, beside the matches themselves."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from skyline.errors import OffMapError
from skyline.geodesy import Curvature, Frame
from skyline.matching.ranking import Candidate
from skyline.report.peaks import Peaks
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline.views import Views

Render = Callable[[Viewpoints, Sequence[int]], Views]
"""Renders N eyes with one heading each."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The place a store describes."""

    frame: Frame
    """Of the store, and so of every candidate."""
    viewpoints: Viewpoints
    """The store's."""
    terrain: HeightField | None = None
    """Without it there is no relief, no rendered skyline and no peak."""
    render: Render | None = None
    """How the candidates' skylines are made; goes with ``terrain``."""
    peaks: Peaks | None = None
    """Names to put to summits."""
    curvature: Curvature = field(default_factory=Curvature)

    def eye_of(self, candidate: Candidate) -> Viewpoints | None:
        """Return a candidate's eye, lifted to the ground from below it; None without terrain."""
        if self.terrain is None:
            return None
        try:
            eye = stand_on(self.terrain, candidate.easting_m, candidate.northing_m, 0.0)
        except OffMapError:
            return None
        np.maximum(eye.eye_elevation_m, candidate.eye_elevation_m, out=eye.eye_elevation_m)
        return eye
