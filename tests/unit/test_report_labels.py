"""No label hides another, nor another's leader line."""

from itertools import combinations

from hypothesis import given
from hypothesis import strategies as st

from skyline.report.figures import place_labels

WIDTH_PX = 1000.0
PEAKS = st.lists(st.tuples(st.floats(0.0, WIDTH_PX), st.floats(5.0, 300.0)), max_size=25)


@given(PEAKS)
def test_labels_and_leaders_keep_apart(peaks):
    placed = place_labels([at for at, _ in peaks], [w for _, w in peaks], WIDTH_PX, rows=4)
    for label in placed:
        assert 0.0 <= label.left_px <= label.anchor_px <= label.right_px <= WIDTH_PX
        assert 0 <= label.row < 4
    for one, other in combinations(placed, 2):
        if one.row == other.row:
            assert one.right_px <= other.left_px or other.right_px <= one.left_px
        low, high = sorted((one, other), key=lambda label: label.row)
        if low.row < high.row:
            assert not low.left_px <= high.anchor_px <= low.right_px


def test_a_label_without_room_is_left_out():
    placed = place_labels([500.0] * 4, [100.0] * 4, WIDTH_PX, rows=2)
    assert [label.index for label in placed] == [0]
