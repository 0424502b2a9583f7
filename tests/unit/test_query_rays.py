"""Rays of a query under another field of view."""

import numpy as np
import pytest

from skyline.errors import InputError
from skyline.matching import QueryRays


def _rays(fov_range_deg: tuple[float, float] | None = None) -> QueryRays:
    u = np.array([-0.5, 0.5])
    return QueryRays(u, u**2, np.ones(2), 60.0, fov_range_deg)


def test_the_frame_s_edge_stays_the_frame_s_edge() -> None:
    edge = np.array([np.tan(np.radians(30.0))])
    turned = QueryRays.equally_trusted(edge, edge, 60.0).with_fov(90.0)
    np.testing.assert_allclose([turned.u, turned.v], 1.0)
    assert turned.fov_deg == 90.0


def test_a_known_field_of_view_is_its_own_range() -> None:
    assert _rays().fov_bounds_deg == (60.0, 60.0)
    assert _rays((50.0, 70.0)).with_fov(55.0).fov_bounds_deg == (50.0, 70.0)


@pytest.mark.parametrize("fov_range_deg", [(61.0, 70.0), (50.0, 59.0), (0.0, 70.0), (50.0, 180.0)])
def test_a_range_without_the_field_of_view_is_refused(fov_range_deg: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="range"):
        _rays(fov_range_deg)
