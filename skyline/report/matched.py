"""What a report is made of: queries with what was found for them, and the place all around."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from skyline.arrays import UInt8Array
from skyline.errors import OffMapError
from skyline.geodesy import Curvature, Frame
from skyline.match.ranking import Candidate
from skyline.photo.query import QuerySkyline
from skyline.report.peaks import Peaks
from skyline.skylines import Views
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_on

Render = Callable[[Viewpoints, Sequence[int]], Views]
"""Renders N eyes with one heading each."""


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """One query and what was found for it.

    Attributes
    ----------
    name : str
        The query's file, as the user has named it.
    candidates : sequence of Candidate
        The pose to show first, then others; each has its own rank.
    is_answered : bool
        Whether the first of them is the answer.
    photo : (H, W, 3) uint8, optional
        RGB, of the query's size; None for a trace or a mask.
    done : sequence of str
        What was done to find it, a sentence each.
    within_m : float, optional
        How near the answer is sure to be; None without an answer.
    is_upload : bool
        Whether the file lies on another machine, so that its name is no path on this one.
    """

    name: str
    query: QuerySkyline
    candidates: Sequence[Candidate]
    seconds: float
    is_answered: bool = True
    photo: UInt8Array | None = None
    done: Sequence[str] = ()
    within_m: float | None = None
    is_upload: bool = False


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
