"""The values of EXIF and XMP: a text, a number, a time."""

import re
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from math import isfinite

Tags = Mapping[int, object]
"""The values of an EXIF directory, by their tags."""

_RATIONAL = re.compile(r"([+-]?\d+\.?\d*)/([1-9]\d*)")
_NUMBER = re.compile(r"[+-]?\d+\.?\d*(?:/[1-9]\d*)?")
"""A decimal or a rational, as XMP writes them."""


def text_of(tags: Tags, tag: int) -> str:
    """Return a tag's text in capitals; "" if it has none."""
    value = tags.get(tag, "")
    text = value.decode("ascii", "replace") if isinstance(value, bytes) else str(value)
    return text.strip("\0 ").upper()


def number_of(value: object) -> float | None:
    """Return a value as a number; None if it is not one.

    A number that is not finite, such as the rational 0/0, does not count. EXIF has numbers and
    rationals, XMP has them as text.
    """
    rational = _RATIONAL.fullmatch(value) if isinstance(value, str) else None
    above, below = rational.groups() if rational else (value, 1.0)
    try:
        number = float(above) / float(below)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if isfinite(number) else None


def leading_number(text: str) -> float | None:
    """Return the number with which a text begins; None without one."""
    number = _NUMBER.match(text)
    return None if number is None else number_of(number[0])


def positive(value: object) -> float | None:
    """Return a number if it is above 0, else None."""
    number = number_of(value)
    return number if number is not None and number > 0.0 else None


def noted_time(tags: Tags, tag: int, zone_tag: int | None = None) -> datetime | None:
    """Return the camera's time in a tag; None without one.

    It has the zone in another tag, if that notes one.
    """
    text = text_of(tags, tag)
    zone = "" if zone_tag is None else text_of(tags, zone_tag)
    for given, form in ((text + zone, "%Y:%m:%d %H:%M:%S%z"), (text, "%Y:%m:%d %H:%M:%S")):
        with suppress(ValueError):
            return datetime.strptime(given, form)
    return None
