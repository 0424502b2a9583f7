"""How far the skyline at a displaced eye is from that of a stored view: the reprojection error.

Two kinds, one interface. The paper's (`skyline.paper.reprojection`, four variants) move the points
of the stored skyline and ask how far a warp misses their images. `Resemblance` predicts the curve
the displaced eye sees, the upper envelope of the displaced skyline or distance shells, and warps
the stored skyline onto it, which is what a matcher will do with the true one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol

import numpy as np

from skyline.arrays import Float32Array, Float64Array, FloatArray
from skyline.errors import InputError
from skyline.paper.reprojection import (
    AFFINE_LEAST_SQUARES,
    AFFINE_MEAN,
    AFFINE_MEDIAN,
    IDENTITY,
    NON_AFFINE,
    check_displacements,
    equation_4,
    median_depth_m,
)
from skyline.prediction.curves import Reach, Scenery, block_means, seen_from
from skyline.prediction.warp_fit import WarpFit
from skyline.views import Views

_FITS_AT_ONCE = 1600
"""Curves warped together: enough that numpy's calls cost little, few enough for the cache."""


class Predictor(Protocol):
    """Says how far from a view its skyline still serves."""

    @property
    def needs_shells(self) -> bool:
        """Whether views must carry distance shells."""

    def errors_px(
        self, views: Views, displacements_m: FloatArray, within_px: float | None = None
    ) -> Float32Array:
        """Return reprojection errors of candidates, paper 4.2.

        Parameters
        ----------
        views : Views
            N views.
        displacements_m : (N, C, 3) floating
            Right, up, forward of C candidate eyes in each view's own axes; NaN is no eye.
        within_px : float, optional
            The threshold the errors are for: what is clearly on one side of it need not be
            computed any closer.

        Returns
        -------
        (N, C) float32
            Mean distance in px (2 / W in v); inf where the view predicts nothing: no warp, too
            little of the skyline in frame, no eye.

        Raises
        ------
        InputError
            Displacements of another shape, or views without the shells the predictor needs.
        """


@dataclass(frozen=True, slots=True)
class Resemblance:
    """Mean distance of the stored skyline, warped as well as can be, from the predicted curve.

    Attributes
    ----------
    use_shells : bool
        Predict from the distance shells, so that hidden terrain can appear, or from the skyline.
    columns : int
        Columns of both curves, means over runs of the view's own. Few are no loss: on two
        terrains 40 decide as well as 320, since a warp finds its way over a smoother curve.
    fit : WarpFit
    """

    use_shells: bool
    columns: int = 40
    fit: WarpFit = field(default_factory=WarpFit)

    @property
    def needs_shells(self) -> bool:
        """Whether the prediction is from distance shells."""
        return self.use_shells

    def errors_px(
        self, views: Views, displacements_m: FloatArray, within_px: float | None = None
    ) -> Float32Array:
        """See `Predictor.errors_px`."""
        check_displacements(views, displacements_m)
        if self.use_shells and views.shells is None:
            raise InputError(
                "the shell predictor needs distance shells, but the views have none; render them "
                "with shell_edges_m, or use a predictor that does without, such as affine-mean"
            )
        scenery = Scenery.of(views, self.columns, self.use_shells)
        curves = block_means(views.elevation_tan, self.columns)
        starts = self._starts(views, displacements_m)
        view, eye = np.nonzero(np.isfinite(displacements_m).all(axis=2))
        errors = np.full(displacements_m.shape[:2], np.inf, dtype=np.float32)
        for begin in range(0, len(view), _FITS_AT_ONCE):
            part = slice(begin, begin + _FITS_AT_ONCE)
            rows, eyes = view[part], eye[part]
            moved = displacements_m[rows, eyes]
            ends = np.flatnonzero(np.diff(rows, append=-1)) + 1
            seen = [
                seen_from(scenery.polylines(one, Reach.of(there)), there, curves.shape[1])
                for one, there in zip(rows[ends - 1], np.split(moved, ends[:-1]), strict=True)
            ]
            distances_px, _ = self.fit.distances_px(
                curves[rows], np.concatenate(seen), starts[rows, eyes], views.width, within_px
            )
            errors[rows, eyes] = distances_px
        return errors

    @staticmethod
    def _starts(views: Views, displacements_m: FloatArray) -> Float64Array:
        """Return the warps to begin with, the identity and Equation 4's, (N, C, 2, 2, 3)."""
        warps = equation_4(median_depth_m(views.depth_m), displacements_m)
        return np.stack([np.broadcast_to(IDENTITY, warps.shape), warps], axis=2)


PREDICTORS: Mapping[str, Predictor] = MappingProxyType(
    {
        "non-affine": NON_AFFINE,
        "affine-mean": AFFINE_MEAN,
        "affine-median": AFFINE_MEDIAN,
        "affine-least-squares": AFFINE_LEAST_SQUARES,
        "curve": Resemblance(use_shells=False, columns=80),
        "shells": Resemblance(use_shells=True),
    }
)
"""Predictors by name; the paper's is ``affine-mean``."""
