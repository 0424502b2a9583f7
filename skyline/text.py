"""Text from outside, file names above all, as any output can hold it."""

import os
import re

_UNSHOWN = re.compile(
    "[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]"
)
"""Control characters, line ends, marks that turn the direction of text, and no characters."""


def printable(text: str | os.PathLike[str]) -> str:
    r"""Return text as one line of characters that UTF-8, JSON and XML can hold.

    A byte of a file's name that is not UTF-8 becomes ``\xe4``, a line end ``\n``, an escape
    ``\x1b``; everything else stays as it is.
    """
    return _UNSHOWN.sub(lambda found: _escaped(found[0]), os.fspath(text))


def _escaped(letter: str) -> str:
    # Python keeps a byte that is not UTF-8 as the surrogate U+DC00 plus the byte (PEP 383).
    is_byte = "\udc80" <= letter <= "\udcff"
    return f"\\x{ord(letter) - 0xDC00:02x}" if is_byte else ascii(letter)[1:-1]
