"""Libraries that come with an extra: optional, and some of them slow to load."""

from importlib import import_module
from typing import Any

from skyline.errors import InputError


def library(name: str, extra: str, what: str) -> Any:
    """Import a library that ``what`` needs; `InputError` names the extra where it is not there."""
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(
            f"{what} needs {name}, which is not installed; pip install 'skyline[{extra}]'"
        ) from error
