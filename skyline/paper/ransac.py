"""RANSAC for many affine maps at once: all samples of all of them are drawn and judged together."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import BoolArray, Float64Array, IntArray

_SEED = 0
_JUDGED = 1 << 20
"""Distances of points to be computed at a time, about."""


@dataclass(frozen=True, slots=True)
class Ransac:
    """How maps are drawn and which are taken."""

    iterations: int
    """Samples drawn, each of three correspondences; equal input has equal output."""
    inlier_px: float
    """A correspondence agrees with a map that puts its point this near."""
    min_inliers: int
    """A map with fewer is none."""
    max_scale: float
    """Singular values of a map must lie between 1 / max_scale and max_scale."""
    max_turn_deg: float
    """Greatest turn of a map."""

    def maps(self, source: Float64Array, target: Float64Array, used: BoolArray) -> Float64Array:
        """Return the plausible maps that most correspondences agree on.

        Points of a low skyline lie nearly on a line, which leaves an affine map's action across
        it open; a similarity is then what they can tell. So every sample of three proposes the
        affine map they define, and the similarity that its first two define, and of all that
        are plausible the one with most inliers is taken, of equals the first. It is fitted
        again to its inliers: as an affine map where that is plausible, else as a similarity.

        Parameters
        ----------
        source : (P, 2) float64
        target : (F, P, 2) float64
            Where the points are in each of F sets of correspondences.
        used : (F, P) bool
            Which correspondences there are; target may be NaN elsewhere.

        Returns
        -------
        (F, 2, 3) float64
            NaN where there is none.
        """
        count = used.sum(axis=1)
        most = int(count.max(initial=0))
        order = np.argsort(~used, axis=1, kind="stable")[:, :most]
        there = np.arange(most) < count[:, np.newaxis]
        a = source[order]
        b = np.take_along_axis(target, order[:, :, np.newaxis], axis=1)
        b = np.where(there[:, :, np.newaxis], b, np.inf)
        maps = np.full((len(target), 2, 3), np.nan)
        enough = np.flatnonzero(count >= self.min_inliers)
        if len(enough):
            a, b = a[enough], b[enough]
            maps[enough] = self._refitted(a, b, self._drawn(a, b, count[enough]))
        return maps

    def plausible(self, maps: Float64Array) -> BoolArray:
        """Return which maps (..., 2, 2 or 3) neither mirror nor turn nor scale too much."""
        (a, b), (c, d) = np.moveaxis(maps[..., :2], (-2, -1), (0, 1))
        with np.errstate(invalid="ignore", over="ignore"):
            determinant = a * d - b * c
            # The singular values' product and the sum of their squares give the values.
            total = a * a + b * b + c * c + d * d
            spread = np.sqrt(np.maximum(total * total - 4.0 * determinant * determinant, 0.0))
            greatest = np.sqrt((total + spread) / 2.0)
            # The turn is within the limit, below a right angle.
            steep = np.tan(np.radians(self.max_turn_deg))
            return np.asarray(
                (determinant > 0.0)
                & (greatest <= self.max_scale)
                & (determinant * self.max_scale >= greatest)
                & (np.abs(c) <= steep * a)
            )

    def _drawn(self, a: Float64Array, b: Float64Array, count: IntArray) -> Float64Array:
        """Return of all maps drawn the plausible ones with most inliers (F, 2, 3), or NaN."""
        draws = np.random.default_rng(_SEED).random((self.iterations, 3))
        sample = (draws * count[:, np.newaxis, np.newaxis]).astype(np.intp)
        fit = np.arange(len(a))[:, np.newaxis, np.newaxis]
        maps = proposals(a[fit, sample], b[fit, sample])
        fit, draw = np.nonzero(self.plausible(maps))
        agreeing = np.zeros(maps.shape[:2], dtype=np.intp)
        step = max(1, _JUDGED // a.shape[1])
        for k in range(0, len(fit), step):
            f, h = fit[k : k + step], draw[k : k + step]
            agreeing[f, h] = self._inliers(maps[f, h], a[f], b[f]).sum(axis=1)
        best = agreeing.argmax(axis=1)
        row = np.arange(len(a))
        taken = agreeing[row, best] >= self.min_inliers
        return np.where(taken[:, np.newaxis, np.newaxis], maps[row, best], np.nan)

    def _inliers(self, maps: Float64Array, a: Float64Array, b: Float64Array) -> BoolArray:
        """Return which of the points a (F, P, 2) the maps put near b."""
        x, y = np.moveaxis(a, 2, 0)
        with np.errstate(invalid="ignore"):
            squared = sum(
                np.square(
                    maps[:, k, 0, np.newaxis] * x
                    + maps[:, k, 1, np.newaxis] * y
                    + (maps[:, k, 2, np.newaxis] - b[:, :, k])
                )
                for k in (0, 1)
            )
            return np.asarray(squared <= self.inlier_px**2)

    def _refitted(self, a: Float64Array, b: Float64Array, maps: Float64Array) -> Float64Array:
        """Return the least-squares maps of the maps' inliers, where those are plausible."""
        inlier = self._inliers(maps, a, b)[:, :, np.newaxis]
        count = np.maximum(inlier.sum(axis=1), 1)
        mean_a = np.where(inlier, a, 0.0).sum(axis=1) / count
        mean_b = np.where(inlier, b, 0.0).sum(axis=1) / count
        a = np.where(inlier, a - mean_a[:, np.newaxis], 0.0)
        b = np.where(inlier, b - mean_b[:, np.newaxis], 0.0)
        among, across = a.transpose(0, 2, 1) @ a, b.transpose(0, 2, 1) @ a
        with np.errstate(invalid="ignore", divide="ignore"):
            affine = across @ _inverse(among)
            size = np.trace(among, axis1=1, axis2=2)
            along = np.trace(across, axis1=1, axis2=2) / size
            turned = (across[:, 1, 0] - across[:, 0, 1]) / size
        for linear in (_similarity(along, turned), affine):
            moved = mean_b - np.einsum("fij,fj->fi", np.nan_to_num(linear), mean_a)
            better = self.plausible(linear)[:, np.newaxis, np.newaxis] & np.isfinite(maps)
            maps = np.where(better, np.concatenate([linear, moved[:, :, np.newaxis]], axis=2), maps)
        return maps


def proposals(a: Float64Array, b: Float64Array) -> Float64Array:
    """Return the maps that samples of three correspondences define.

    Parameters
    ----------
    a, b : (F, H, 3, 2) float64
        Points and where they are put.

    Returns
    -------
    (F, 2 H, 2, 3) float64
        H affine maps of all three points, then H similarities of the first two; not finite
        where the points define none.
    """
    side_a, side_b = a[:, :, 1:] - a[:, :, :1], b[:, :, 1:] - b[:, :, :1]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        affine = np.swapaxes(side_b, 2, 3) @ _inverse(np.swapaxes(side_a, 2, 3))
        (x, y), (to_x, to_y) = (
            np.moveaxis(side_a[:, :, 0], 2, 0),
            np.moveaxis(side_b[:, :, 0], 2, 0),
        )
        squared = x * x + y * y
        similar = _similarity((x * to_x + y * to_y) / squared, (x * to_y - y * to_x) / squared)
        linear = np.concatenate([affine, similar], axis=1)
        first_a, first_b = (np.concatenate([p[:, :, 0]] * 2, axis=1) for p in (a, b))
        moved = first_b - (linear * first_a[:, :, np.newaxis]).sum(axis=3)
    return np.concatenate([linear, moved[..., np.newaxis]], axis=3)


def _similarity(along: Float64Array, turned: Float64Array) -> Float64Array:
    """Return matrices (..., 2, 2) that scale and turn."""
    return np.stack(
        [np.stack([along, -turned], axis=-1), np.stack([turned, along], axis=-1)], axis=-2
    )


def _inverse(matrix: Float64Array) -> Float64Array:
    """Return inverses (..., 2, 2), not finite where there is none."""
    (a, b), (c, d) = np.moveaxis(matrix, (-2, -1), (0, 1))
    determinant = (a * d - b * c)[..., np.newaxis, np.newaxis]
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-2)
    return np.asarray(adjugate / determinant)
