"""Fonts made for tests: every letter is a square."""

from fontTools.fontBuilder import FontBuilder
from fontTools.pens.ttGlyphPen import TTGlyphPen

UNDRAWN = "\U0010abcd\U0010abce"
"""Letters for private use, which no font of a system has."""


def font_of(path, family, letters, *, is_coloured=False):
    """Write a font that has some letters, the digits and signs of labels not among them."""
    pen = TTGlyphPen(None)
    pen.moveTo((100, 0))
    for corner in ((100, 700), (700, 700), (700, 0)):
        pen.lineTo(corner)
    pen.closePath()
    names = [".notdef", *(f"letter{index}" for index in range(len(letters)))]
    font = FontBuilder(1000, isTTF=True)
    font.setupGlyphOrder(names)
    font.setupCharacterMap(dict(zip(map(ord, letters), names[1:], strict=True)))
    font.setupGlyf(dict.fromkeys(names, pen.glyph()))
    font.setupHorizontalMetrics(dict.fromkeys(names, (800, 100)))
    font.setupHorizontalHeader(ascent=800, descent=-200)
    font.setupOS2(usWeightClass=400)
    font.setupPost()
    font.setupNameTable({"familyName": family, "styleName": "Regular"})
    if is_coloured:
        font.setupCPAL([[(1.0, 0.0, 0.0, 1.0)]])
        font.setupCOLR({names[1]: [(names[1], 0)]})
    font.save(path)
    return path
