"""Polyline keypoints: the tolerance holds in every column, gaps split, the cap keeps the best."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from skyline.skylines import NO_KEYPOINT, polyline_vertices


def curves_of(seed, rows=3, width=97, gaps=False):
    generator = np.random.default_rng(seed)
    curves = generator.normal(size=(rows, width)).cumsum(axis=1)
    if gaps:
        curves[generator.random(curves.shape) < 0.1] = np.nan
    return curves


def runs_of(curve):
    finite = np.flatnonzero(np.isfinite(curve))
    return np.split(finite, np.flatnonzero(np.diff(finite) > 1) + 1) if finite.size else []


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 5.0), st.booleans())
def test_polyline_stays_within_its_tolerance(seed, tolerance, gaps):
    curves = curves_of(seed, gaps=gaps)
    table = polyline_vertices(curves, tolerance, 97)
    for curve, row in zip(curves, table, strict=True):
        vertices = row[row != NO_KEYPOINT].astype(int)
        assert (np.diff(vertices) > 0).all()
        assert np.isfinite(curve[vertices]).all()
        for run in runs_of(curve):
            inside = vertices[(vertices >= run[0]) & (vertices <= run[-1])]
            assert inside[0] == run[0]
            assert inside[-1] == run[-1]
            polyline = np.interp(run, inside, curve[inside])
            assert np.abs(polyline - curve[run]).max() <= tolerance + 1e-9


def test_the_cap_keeps_the_greatest():
    curve = np.zeros((1, 101))
    curve[0, 30], curve[0, 70] = 1.0, 10.0
    kept = polyline_vertices(curve, 0.1, 3)[0]
    assert 70 in kept
    assert 30 not in kept
