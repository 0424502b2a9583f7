"""Names of files as text that every output can hold."""

import os
from pathlib import Path

import pytest

from skyline.errors import printable


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (b"Z\xc3\xbcrich 100%#\xe2\x80\x99.jpg", "Zürich 100%#’.jpg"),
        (b"b\xe4r.jpg", r"b\xe4r.jpg"),
        (b"\xff\xfe", r"\xff\xfe"),
        (b"a\nb\r\tc.jpg", r"a\nb\r\tc.jpg"),
        (b"\x1b[31mred\x07.jpg", r"\x1b[31mred\x07.jpg"),
        ("a\u2028b\x85c".encode(), r"a\u2028b\x85c"),
        ("gpj\u202eexe\uffff".encode(), r"gpj\u202eexe\uffff"),
        ("山\u3000e\u0301\U0001f3d4\ufe0f.jpg".encode(), "山\u3000e\u0301\U0001f3d4\ufe0f.jpg"),
    ],
)
def test_a_name_is_one_line_of_characters_that_files_can_hold(name, text):
    assert printable(os.fsdecode(name)) == text
    assert printable(Path(os.fsdecode(name))) == text
