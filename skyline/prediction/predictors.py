"""How far the skyline at a displaced eye is from that of a stored view: the reprojection error.

Two kinds, one interface. The paper's move the points of the stored skyline and ask how far a
warp misses their images; `Reprojection` has its four variants. `Resemblance` predicts the curve
the displaced eye sees, the upper envelope of the displaced skyline or distance shells, and warps
the stored skyline onto it, which is what a matcher will do with the true one.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from skyline.errors import InputError
from skyline.prediction.affine import (
    IDENTITY,
    CurveFit,
    equation_4,
    least_squares,
    mean_depth_m,
    median_depth_m,
)
from skyline.prediction.curves import Scenery, block_means, seen_from
from skyline.prediction.displacement import Reach, check_displacements
from skyline.prediction.points import Projected
from skyline.views import Views

FloatArray = NDArray[np.floating]
Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_AT_ONCE = 1 << 18
"""Projected points evaluated together, to stay in the processor's cache."""

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


Warp = Callable[[Projected], Float64Array]


@dataclass(frozen=True, slots=True)
class Reprojection:
    """Mean distance between warped points and their true images, over those in front and in frame.

    Attributes
    ----------
    warp : callable
        Returns the warps (N, C, 2, 3), NaN where there is none.
    columns : int
        At most so many points a view, evenly spread. On Davos, 80 decide as 640 do.
    min_points : int
        Fewer in frame are no answer.
    """

    warp: Warp
    columns: int = 80
    min_points: int = 3

    @property
    def needs_shells(self) -> bool:
        """False: the skyline and its depth suffice."""
        return False

    def errors_px(
        self, views: Views, displacements_m: FloatArray, within_px: float | None = None
    ) -> Float32Array:
        """See `Predictor.errors_px`."""
        check_displacements(views, displacements_m)
        candidates = displacements_m.shape[1]
        errors = np.empty((len(views), candidates), dtype=np.float32)
        some = max(1, _AT_ONCE // max(1, candidates * min(self.columns, views.width)))
        for begin in range(0, len(views), some):
            part = slice(begin, begin + some)
            errors[part] = self._errors_px(views[part], displacements_m[part])
        return errors

    def _errors_px(self, views: Views, displacements_m: FloatArray) -> FloatArray:
        projected = Projected.of(views, displacements_m, self.columns)
        affine = self.warp(projected)
        warped = projected.points_uv[:, np.newaxis] @ np.swapaxes(affine[..., :2], 2, 3)
        warped += affine[..., np.newaxis, :, 2]
        usable = projected.usable
        missed = np.where(usable[..., np.newaxis], warped - projected.there_uv, 0.0)
        count = usable.sum(axis=2)
        mean = np.hypot(missed[..., 0], missed[..., 1]).sum(axis=2) / np.maximum(count, 1)
        answered = (count >= self.min_points) & np.isfinite(mean)
        return np.where(answered, mean * (views.width / 2.0), np.inf)


def _no_warp(projected: Projected) -> Float64Array:
    return np.broadcast_to(IDENTITY, (*projected.usable.shape[:2], 2, 3))


def _mean_depth_warp(projected: Projected) -> Float64Array:
    return equation_4(mean_depth_m(projected.depth_m), projected.displacements_m)


def _median_depth_warp(projected: Projected) -> Float64Array:
    return equation_4(median_depth_m(projected.depth_m), projected.displacements_m)


def _least_squares_warp(projected: Projected) -> Float64Array:
    return least_squares(projected.points_uv, projected.there_uv, projected.usable)


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
    fit : CurveFit
    """

    use_shells: bool
    columns: int = 40
    fit: CurveFit = field(default_factory=CurveFit)

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
        "non-affine": Reprojection(_no_warp),
        "affine-mean": Reprojection(_mean_depth_warp),
        "affine-median": Reprojection(_median_depth_warp),
        "affine-least-squares": Reprojection(_least_squares_warp),
        "curve": Resemblance(use_shells=False, columns=80),
        "shells": Resemblance(use_shells=True),
    }
)
"""Predictors by name; the paper's is ``affine-mean``."""


def predictor_named(name: str) -> Predictor:
    """Return a predictor by its name; raises `InputError` for one that is not known."""
    try:
        return PREDICTORS[name]
    except KeyError as error:
        raise InputError(
            f"predictor is {name!r}; expected one of {', '.join(PREDICTORS)}"
        ) from error
