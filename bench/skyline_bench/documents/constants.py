"""Numbers in pages that are constants of the code.

In a page, the dotted path of a constant follows its number in a comment, which readers do not see::

    at most 1,600<!-- skyline.match.refine.WHOLE.shortlist --> poses
    a deviation of 2.5 %<!-- skyline.MatchConfig.fov_sd_share:.1% -->

A path may lead to a module's constant, an attribute of an object, the default of a dataclass's
field, or, by its position, an item of a tuple. A format of Python's may follow a colon.
"""

import re
from dataclasses import fields, is_dataclass
from importlib import import_module
from types import ModuleType
from typing import Any

from skyline.errors import InputError

_NUMBER = re.compile(
    r"(?P<shown>-?\d(?:[\d,.]*\d)?(?: %)?)?"
    r"(?P<comment><!-- (?P<path>skyline(?:\.\w+)+)(?::(?P<form>\S+))? -->)"
)


def with_constants(text: str, page: str, *, keep_comments: bool = True) -> str:
    """Return the text of a page with the constants' present values.

    Raises `InputError` with the page and the lines if a path does not lead to a number, or if no
    number stands before a path.
    """
    wrong: list[str] = []

    def number(found: re.Match[str]) -> str:
        where = f"`{found['path']}` in line {text.count(chr(10), 0, found.start()) + 1}"
        if found["shown"] is None:
            wrong.append(f"{where} (no number stands right before it)")
            return found[0]
        try:
            shown = _shown(_value_of(found["path"]), found["form"])
        except (AttributeError, IndexError, TypeError, ValueError) as error:
            wrong.append(f"{where} ({error})")
            return found[0]
        return shown + found["comment"] * keep_comments

    written = _NUMBER.sub(number, text)
    if wrong:
        raise InputError(
            f"{page} names what is no number of the code: {', '.join(wrong)}; correct the paths in "
            "the page"
        )
    return written


def _value_of(path: str) -> Any:
    """Return the object at a dotted path, such as `skyline.pose.pose.RIGHT_WITHIN_M`."""
    value: Any = None
    for name in path.split("."):
        value = import_module(name) if value is None else _part(value, name)
    return value


def _part(value: Any, name: str) -> Any:
    """Return a module's submodule, a dataclass's default, an item or an attribute."""
    if isinstance(value, ModuleType):
        try:
            return import_module(f"{value.__name__}.{name}")
        except ModuleNotFoundError:
            return getattr(value, name)
    if name.isdigit():
        return value[int(name)]
    if isinstance(value, type) and is_dataclass(value):
        for field in fields(value):
            if field.name == name:
                return field.default  # a class with slots has it here alone
    return getattr(value, name)


def _shown(value: Any, form: str | None) -> str:
    """Return a number as pages show it: 16,384; 0.72; 2.5 %."""
    if form is None:
        form = ",d" if float(value).is_integer() else ",.6g"
    text = format(int(value) if form.endswith("d") else float(value), form)
    return text.replace("%", " %")
