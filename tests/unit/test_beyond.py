"""What is said of skylines that terrain past the elevation model's edge may make."""

import pytest

from skyline.match.records import beyond_in_words


@pytest.mark.parametrize("share", [None, 0.0, 0.09])
def test_little_is_not_worth_a_line(share):
    assert beyond_in_words(share) is None


def test_a_tenth_is_said():
    assert str(beyond_in_words(0.214)).startswith("21 % of the skyline may be of terrain beyond")
