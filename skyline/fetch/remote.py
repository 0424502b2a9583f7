"""Requests to servers, repeated where that may help; the error of a failed one is one line.

GeoTIFFs are read through GDAL's HTTP client.
"""

import logging
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import rasterio
from rasterio.errors import RasterioError

from skyline.errors import FetchError
from skyline.terrain.rasters import shown

RETRIES = 4
"""Default number of repetitions of a failed request."""
TIMEOUT_S = 30
"""Seconds without an answer, or with less than 1 kB a second, after which a request has failed."""

_FIRST_DELAY_S = 1.0
"""Delay before the first repetition; it doubles before each further one."""
_STALLED_BYTES_A_S = 1000
_PASSING = re.compile(
    r"HTTP response code: (429|5\d\d)|CURL error|[Rr]ead (error|failed)|IReadBlock"
)
"""Failures of GDAL that may pass; others are the same every time."""

_T = TypeVar("_T")


class AbsentError(FetchError):
    """The server has no such file (HTTP 404)."""


class RequestError(Exception):
    """A failed request.

    Parameters
    ----------
    reason, advice : str
        The failure, and the next thing to try.
    may_pass : bool
        Whether the same request may succeed later.
    """

    def __init__(self, reason: str, advice: str, may_pass: bool) -> None:
        super().__init__(reason)
        self.reason, self.advice, self.may_pass = reason, advice, may_pass


def repeated(url: str, request: Callable[[], _T], retries: int) -> _T:
    """Return the result of a request, repeated where it raises a `RequestError` that may pass.

    Raises `FetchError` where the last repetition fails too, or repetition cannot help.
    """
    for attempt in range(retries + 1):
        try:
            return request()
        except RequestError as error:
            if not error.may_pass or attempt == retries:
                times = f"tried {attempt + 1} times" if attempt else "not tried again"
                raise FetchError(
                    f"{shown(url)}: {error.reason}, {times}; {error.advice}"
                ) from error
        time.sleep(_FIRST_DELAY_S * 2.0**attempt)
    raise AssertionError("the last attempt returns or raises")


def with_remote(url: str, work: Callable[[Any], _T], retries: int, timeout_s: int) -> _T:
    """Open the GeoTIFF at an address and return ``work`` of the rasterio dataset.

    After a failed connection ``work`` is called again with the file opened anew: GDAL itself
    repeats only requests that are answered 429, 500, 502, 503 or 504.

    Raises
    ------
    AbsentError
        There is no such file (HTTP 404).
    FetchError
        The server fails, is too slow, breaks off, or sends something that is not a GeoTIFF.
    """

    def read() -> _T:
        try:
            # Only the GTiff driver may read: others follow references in an untrusted file.
            with (
                _environment(retries, timeout_s),
                rasterio.open(f"/vsicurl/{url}", driver="GTiff") as file,
            ):
                return work(file)
        except RasterioError as error:
            raise _failure(url, error) from error

    return repeated(url, read, retries)


@contextmanager
def _environment(retries: int, timeout_s: int) -> Iterator[None]:
    """Configure GDAL's HTTP client; the error at the end replaces its log messages."""
    settings = {
        "GDAL_HTTP_MAX_RETRY": retries,
        "GDAL_HTTP_RETRY_DELAY": _FIRST_DELAY_S,
        "GDAL_HTTP_CONNECTTIMEOUT": timeout_s,
        "GDAL_HTTP_LOW_SPEED_TIME": timeout_s,
        "GDAL_HTTP_LOW_SPEED_LIMIT": _STALLED_BYTES_A_S,
        # No requests for the folder or for side-car files.
        "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
        "GDAL_PAM_ENABLED": "NO",
        # A failure must not be remembered when the request is repeated.
        "CPL_VSIL_CURL_NON_CACHED": "/vsicurl/",
    }
    log = logging.getLogger("rasterio")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        with rasterio.Env(**settings):
            yield
    finally:
        log.setLevel(level)


def _failure(url: str, error: RasterioError) -> Exception:
    """Return the error for a failure of GDAL, from its message and those of its causes."""
    messages: list[str] = []
    cause: BaseException | None = error
    while cause is not None:
        messages.append(" ".join(str(cause).split()))
        cause = cause.__cause__
    text = "; ".join(dict.fromkeys(messages)).replace(f"/vsicurl/{url}", shown(url))
    text = text.replace(" - Failure writing output to destination", "")
    may_pass = bool(_PASSING.search(text))
    advice = "check the address and the source's template"
    if status := re.search(r"HTTP response code: (\d+)", text):
        code = int(status[1])
        if code == 404:
            return AbsentError(f"{shown(url)}: there is no such file (HTTP 404)")
        if code in (401, 403):
            advice = (
                "check that the source is open to you (some servers answer this for absent files)"
            )
        elif code == 429 or code >= 500:
            advice = "give the same command again later: fetched tiles are kept"
        return RequestError(f"the server answers HTTP {code}", advice, may_pass)
    if curl := re.search(r"CURL error: (.*?)(;|$)", text):
        advice = (
            "check the address and the connection, then give the same command: fetched tiles are "
            "kept"
        )
        return RequestError(f"no answer ({curl[1]})", advice, may_pass)
    if "not recognized as being in" in text:
        reason = "not a GeoTIFF, or the server does not answer HTTP range requests"
        return RequestError(reason, advice, may_pass)
    return RequestError(
        f"the file breaks off or is damaged ({text.rpartition('; ')[2]})",
        "give the same command again: fetched tiles are kept",
        may_pass,
    )
