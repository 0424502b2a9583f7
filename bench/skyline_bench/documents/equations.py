"""Equations of pages, copied from the docstrings that derive them.

A page names the equation in a comment, and the equation follows::

    <!-- equation 1 of skyline.match.screen -->

    $$s_t = ...$$

It is the first block ``.. math::`` in the docstring of that module.
"""

import inspect
import re
from importlib import import_module

from skyline.errors import InputError

_EQUATION = re.compile(
    r"(?P<comment><!-- equation (?P<number>[1-9]\d*) of (?P<module>[\w.]+) -->\n\n)\$\$[^$]*\$\$"
)
_MATH = re.compile(r"^( *)\.\. math::((?:.*\n)(?:\1 +\S.*\n|\s*\n)*)", re.MULTILINE)


def with_equations(text: str, page: str) -> str:
    """Return a page's text with the code's present equations.

    Raises `InputError` where a module has no such equation.
    """

    def equation(found: re.Match[str]) -> str:
        try:
            latex = _equations_of(found["module"])[int(found["number"]) - 1]
        except (ImportError, IndexError) as error:
            named = f"equation {found['number']} of {found['module']}"
            raise InputError(
                f"{page} names {named}, which the code does not have ({error}); correct the page"
            ) from error
        return f"{found['comment']}$${latex}$$"

    return _EQUATION.sub(equation, text)


def _equations_of(module: str) -> list[str]:
    """Return the equations in a module's docstring, each in one line."""
    text = inspect.getdoc(import_module(module)) or ""
    return [" ".join(block.split()) for _, block in _MATH.findall(f"{text}\n")]
