"""The fonts that draw a text: as few as have its letters, and none where a letter has none."""

import os
import subprocess
import sys

import pytest
from font_scenes import UNDRAWN, font_of
from matplotlib import rcParams

from skyline.fonts import fonts_for, packages_with, undrawn_letters

FIRST, SECOND = UNDRAWN


def others_for(*texts):
    """Return the fonts that draw each text besides Matplotlib's own; None if no font can."""
    usual = len(rcParams["font.family"])
    return [families[usual:] if families else None for families in fonts_for(texts)]


def test_the_usual_font_draws_what_it_has_and_an_installed_one_the_rest(install_font):
    texts = "Piz Buin 3312 m", f"{FIRST} 3312 m", f"{FIRST}{SECOND}"
    assert others_for(*texts) == [(), None, None]
    install_font("Tiny", FIRST)
    assert others_for(*texts) == [(), ("Tiny",), None]
    assert undrawn_letters(texts) == {SECOND}


def test_one_font_with_all_letters_goes_before_two(install_font):
    install_font("A Sans", FIRST)
    install_font("B Sans", SECOND)
    assert others_for(UNDRAWN) == [("A Sans", "B Sans")]
    install_font("Both", UNDRAWN)
    assert others_for(UNDRAWN) == [("Both",)]


def test_a_letter_and_its_mark_need_one_font(install_font):
    text = f"{FIRST}\N{COMBINING DIAERESIS}"
    install_font("Base", FIRST)
    assert others_for(FIRST, text) == [("Base",), None]
    install_font("Marked", text)
    assert others_for(text) == [("Marked",)]


def test_spaces_and_signs_that_are_not_seen_need_no_font(install_font):
    install_font("Tiny", FIRST)
    text = f"\N{LEFT-TO-RIGHT MARK}{FIRST}\ufe0f\N{ZERO WIDTH JOINER}\N{IDEOGRAPHIC SPACE}3 m"
    assert others_for(text) == [("Tiny",)]


def test_colours_are_not_drawn(install_font):
    install_font("Coloured", FIRST, is_coloured=True)
    assert others_for(FIRST) == [None]


def test_a_font_installed_after_matplotlib_made_its_list_is_used(tmp_path):
    fonts = tmp_path / "data" / "fonts"
    fonts.mkdir(parents=True)
    own = {"XDG_DATA_HOME": str(tmp_path / "data"), "MPLCONFIGDIR": str(tmp_path / "matplotlib")}
    code = f"from skyline.fonts import fonts_for; print(*fonts_for({[FIRST]!a})[0][1:])"

    def families():
        command = [sys.executable, "-c", code]
        done = subprocess.run(
            command, capture_output=True, text=True, check=True, env=os.environ | own
        )
        return done.stdout.strip()

    assert families() == ""
    font_of(fonts / "tiny.ttf", "Tiny", FIRST)
    assert families() == "Tiny"


@pytest.mark.parametrize(
    ("name", "packages"),
    [
        ("백두산", ["fonts-noto-cjk"]),
        ("カラ山", ["fonts-noto-cjk"]),
        ("ยอด", ["fonts-noto-core"]),
        ("सगरमाथा ኤርታ", ["fonts-noto-core"]),
        ("🏔山", ["fonts-noto-cjk", "fonts-symbola"]),
        (UNDRAWN, []),
    ],
)
def test_debian_s_package_with_letters_of_a_script(name, packages):
    assert packages_with(name.replace(" ", "")) == packages
