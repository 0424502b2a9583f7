"""The installed fonts with which Matplotlib draws names in any script.

Matplotlib draws each letter of a text in the first of several fonts that has it, and shapes, joins
and orders letters as their script demands. The fonts are chosen here, for each text.
"""

import unicodedata
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from matplotlib import rcParams
from matplotlib.font_manager import (
    FontEntry,
    FontProperties,
    findfont,
    findSystemFonts,
    fontManager,
    weight_dict,
)
from matplotlib.ft2font import FaceFlags, FT2Font

_REGULAR = 400
"""The weight of a font that is neither light nor bold."""
_CJK = ("CJK", "HIRAGANA", "KATAKANA", "HANGUL", "BOPOMOFO", "HALFWIDTH", "FULLWIDTH")
"""First words of the Unicode names of Chinese, Japanese and Korean letters."""


def fonts_for(texts: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the families that draw each text, to be tried in order.

    A text that no font can draw has none. The families that Matplotlib uses by default
    (``font.family``) come first, then as few others as draw the remaining letters. Fonts that were
    installed after Matplotlib made its list are added to the list.
    """
    missing = [_letters(text) for text in texts]
    usual = _drawn_as_usual(set().union(*missing))
    missing = [letters - usual for letters in missing]
    others = _drawn_by_others(set().union(*missing))
    return [_families(letters, others) for letters in missing]


def undrawn_letters(texts: Iterable[str]) -> set[str]:
    """Return the letters of texts that no installed font draws.

    Each letter comes with the marks that follow it.
    """
    letters = set().union(*map(_letters, texts))
    letters -= _drawn_as_usual(letters)
    return letters.difference(*_drawn_by_others(letters).values())


def packages_with(letters: Iterable[str]) -> list[str]:
    """Return the Debian packages of fonts that draw most such letters.

    Matplotlib draws outlines, so fonts-noto-color-emoji, which has coloured pixels, is none of
    them.
    """
    return sorted({_package(letter[0]) for letter in letters} - {""})


def _package(letter: str) -> str:
    """Return the Debian package of fonts for a letter, or ""."""
    if unicodedata.name(letter, "").startswith(_CJK):
        return "fonts-noto-cjk"
    kind = unicodedata.category(letter)
    if kind.startswith("C"):
        return ""  # Unicode does not define it.
    return "fonts-symbola" if kind == "So" else "fonts-noto-core"


def _letters(text: str) -> set[str]:
    """Return a text's visible letters, each with the marks after it."""
    found: list[str] = []
    for letter in unicodedata.normalize("NFC", text):
        kind = unicodedata.category(letter)
        if kind in {"Cf", "Zs"} or "VARIATION SELECTOR" in unicodedata.name(letter, ""):
            continue
        if found and kind.startswith("M"):
            found[-1] += letter
        else:
            found.append(letter)
    return set(found)


def _families(missing: set[str], others: dict[str, set[str]]) -> tuple[str, ...]:
    """Return the default families, and as few others as draw the rest."""
    families = list(rcParams["font.family"])
    while missing:
        best = max(others, key=lambda family: len(others[family] & missing), default="")
        if not missing & others.get(best, set()):
            return ()
        families.append(best)
        missing = missing - others[best]
    return tuple(families)


def _drawn_as_usual(letters: set[str]) -> set[str]:
    """Return the letters that Matplotlib's default families draw."""
    files = [findfont(FontProperties(family=[family])) for family in rcParams["font.family"]]
    fonts = [FT2Font(file, face_index=file.face_index) for file in files]
    return {letter for letter in letters if any(_has(font, letter) for font in fonts)}


def _drawn_by_others(letters: set[str]) -> dict[str, set[str]]:
    """Return the letters that each installed family draws, preferred ones first."""
    drawn: dict[str, set[str]] = {}
    if not letters:
        return drawn
    _add_new_fonts()
    for entry in sorted(fontManager.ttflist, key=_preference):
        name = entry.name.lower().replace(" ", "")
        # Fonts of last resort show which letters are missing, and draw none.
        if entry.name in drawn or "lastresort" in name:
            continue
        with suppress(OSError, RuntimeError):  # The file is gone, or damaged.
            # One font is open at a time: a process may not open as many files as there are fonts.
            font = FT2Font(entry.fname, face_index=entry.index)
            if FaceFlags.COLOR not in font.face_flags:
                drawn[entry.name] = {letter for letter in letters if _has(font, letter)}
    return drawn


def _add_new_fonts() -> None:
    """Add fonts that are newer than Matplotlib's list to it."""
    known = {entry.fname for entry in fontManager.ttflist}
    for path in sorted(set(findSystemFonts()) - known):
        with suppress(Exception):  # Matplotlib, too, leaves out each font that it cannot read.
            fontManager.addfont(path)


def _preference(entry: FontEntry) -> tuple[object, ...]:
    """Return a key that sorts regular sans-serif fonts first."""
    weight = entry.weight
    if isinstance(weight, str):
        weight = weight_dict.get(weight, _REGULAR)
    shape = abs(weight - _REGULAR), entry.style != "normal"
    name = entry.name.lower()
    return *shape, "sans" not in name, "mono" in name, Path(entry.fname).name, entry.index


def _has(font: FT2Font, letter: str) -> bool:
    """Return whether a font draws a letter with its marks.

    The font may draw them as one character or as several.
    """
    forms = letter, unicodedata.normalize("NFD", letter)
    return any(all(font.get_char_index(ord(part)) for part in form) for form in forms)
