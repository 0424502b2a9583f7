"""Names by which GDAL opens files, also members of zip archives."""

import re
from pathlib import Path

from skyline.errors import InputError

_MEMBER = re.compile(r"/vsizip/\{(.+?\.zip)\}/(.+)", re.DOTALL | re.IGNORECASE)
"""The name by which GDAL opens a member of a zip archive."""


def for_gdal(name: str) -> str:
    """Return a path or an address for GDAL to open.

    Raises `InputError` if it is not UTF-8.
    """
    try:
        name.encode()
    except UnicodeEncodeError:
        raise InputError(
            f"{name} cannot be opened by GDAL, since it is not UTF-8; rename the file or folder, "
            "or name a link to it"
        ) from None
    return name


def member_name(archive: str | Path, member: str) -> str:
    """Return GDAL's name for a member of a zip archive."""
    return f"/vsizip/{{{archive}}}/{member}"


def archive_of(name: str) -> tuple[str, str] | None:
    """Return the archive and the member of a `member_name`.

    Returns None for any other name.
    """
    parts = _MEMBER.fullmatch(name)
    return None if parts is None else (parts[1], parts[2])


def on_disk(name: str | Path) -> str | Path:
    """Return the file that GDAL reads under a name.

    It is a member's archive, or the name itself.
    """
    parts = archive_of(str(name))
    return name if parts is None else parts[0]
