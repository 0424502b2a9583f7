"""Files of a report, whole or not there."""

from pathlib import Path

from skyline.errors import InputError


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file at once, with the folders it needs; a failure leaves what was there before.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(content.encode() if isinstance(content, str) else content)
        partial.replace(path)
    except OSError as error:
        if partial.is_file():
            partial.unlink()
        raise InputError(
            f"{path} cannot be written ({error.strerror}); name another place for it"
        ) from error
