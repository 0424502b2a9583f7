"""What refinement may be asked, and how heights that err near by are taken."""

import numpy as np
import pytest

from skyline.errors import InputError
from skyline.match.match_config import RefineConfig
from skyline.match.noise import HeightErrors, Noise


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"slope_reach_m": 0.0}, "slope's reach 0.0 m"),
        ({"longest_step_m": 10.0}, "to 10.0 m"),
        ({"keep_share": 1.1}, "keep_share is 1.1"),
    ],
)
def test_what_no_refinement_can_be_is_refused(change: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        RefineConfig(**change)


def test_an_error_of_the_eye_s_height_shows_in_full_far_away_and_not_at_all_near_by() -> None:
    """Near by the terrain errs as the ground under the eye does."""
    distance = np.geomspace(1.0, 1e6, 60)[np.newaxis]
    noise = Noise(nodes=0, reach_m=300.0)
    errors = HeightErrors.of(0.0 * distance, distance, 0.0 * distance, noise)
    # Of a metre's error, what is left of the angle it would have without that.
    left = errors.factor[0, :, 0] * distance[0]
    assert (np.diff(left) > 0.0).all()
    assert 0.0 < left[0] < 1e-4
    assert left[-1] == pytest.approx(1.0, abs=1e-6)
    assert (errors.rough[0] * distance[0] <= 1.0).all()
