"""Requests to servers, repeated where that may help.

A request that fails raises an error of one line.
"""

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import rasterio
from rasterio.errors import RasterioError

from skyline.errors import FetchError, one_line
from skyline.terrain.raster_files import NOT_RECOGNIZED, without_secrets

PASSING = (429, 500, 502, 503, 504)
"""HTTP status codes of failures that may pass."""

_UNREACHABLE = re.compile(r"resolve host|connect to|unreachable", re.IGNORECASE)
"""Curl's words for a server that cannot be found: without a network, every attempt fails."""

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Patience:
    """How long requests wait, and how often they are repeated."""

    retries: int = 4
    """Greatest number of repetitions of a failed request."""
    timeout_s: int = 30
    """Seconds without an answer, or with less than 1 kB a second, after which a request has
    failed."""
    first_delay_s: float = 1.0
    """Delay before the first repetition; it doubles before each further one."""


PATIENT = Patience()
"""The patience of commands."""


class AbsentError(FetchError):
    """The server has no such file (HTTP 404)."""


class RefusedError(FetchError):
    """The server refuses a file, or has something else under its address."""


class SpoiledError(FetchError):
    """The server answers every request, but never sends the file whole."""


@dataclass(eq=False)
class RequestError(Exception):
    """A failed request: what failed, and what to try next."""

    reason: str
    advice: str
    retries: int | None = None
    """Number of repetitions that may help; None for as many as are allowed."""
    kind: type[FetchError] = FetchError
    """The error of the last repetition."""


def repeated(url: str, request: Callable[[], _T], patience: Patience) -> _T:
    """Return the result of a request, repeated if it raises a `RequestError`.

    If the last repetition fails too, raises its `FetchError`.
    """
    attempt = 0
    while True:
        try:
            return request()
        except RequestError as error:
            most = patience.retries if error.retries is None else error.retries
            if attempt >= min(most, patience.retries):
                times = f"tried {attempt + 1} times" if attempt else "not tried again"
                raise error.kind(
                    f"{without_secrets(url)}: {error.reason}, {times}; {error.advice}"
                ) from error
        time.sleep(patience.first_delay_s * 2.0**attempt)
        attempt += 1


def with_remote(url: str, work: Callable[[Any], _T], patience: Patience) -> _T:
    """Return the result of ``work`` on a remote GeoTIFF's rasterio dataset.

    After a failure that may pass, ``work`` is called again with the file opened anew. Raises
    `AbsentError`, `RefusedError` if the server refuses the file or sends something other than a
    GeoTIFF, `SpoiledError` if it fails or breaks off, and another `FetchError` if it does not
    answer in time.
    """
    settings = {
        "GDAL_HTTP_MAX_RETRY": 0,
        "GDAL_HTTP_CONNECTTIMEOUT": patience.timeout_s,
        "GDAL_HTTP_LOW_SPEED_TIME": patience.timeout_s,
        "GDAL_HTTP_LOW_SPEED_LIMIT": 1000,
        # No requests for the folder or for side-car files.
        "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
        "GDAL_PAM_ENABLED": "NO",
        # A failure must not be remembered when the request is repeated.
        "CPL_VSIL_CURL_NON_CACHED": "/vsicurl/",
    }

    def read() -> _T:
        try:
            # Only the GTiff driver may read: others follow references in an untrusted file.
            with (
                rasterio.Env(**settings),
                rasterio.open(f"/vsicurl/{url}", driver="GTiff") as file,
            ):
                return work(file)
        except RasterioError as error:
            if NOT_RECOGNIZED in str(error):
                # GDAL hides the status of a refused GET that follows a good HEAD.
                settings["CPL_VSIL_CURL_USE_HEAD"] = "NO"
            raise _failure(url, error) from error

    return repeated(url, read, patience)


def _failure(url: str, error: RasterioError) -> Exception:
    """Return the error for a failure of GDAL, from its messages."""
    messages: list[str] = []
    cause: BaseException | None = error
    while cause is not None:
        messages.append(one_line(cause))
        cause = cause.__cause__
    text = "; ".join(messages).replace(f"/vsicurl/{url}", without_secrets(url))
    again = "give the same command again: fetched tiles are kept"
    check = "check the address and the source's template"
    if status := re.search(r"HTTP response code: (\d+)", text):
        code = int(status[1])
        if code == 404:
            return AbsentError(f"{without_secrets(url)}: there is no such file (HTTP 404)")
        if code in (401, 403):
            check = "check that the source is open to you (or the file is absent)"
        reason = f"the server answers HTTP {code}"
        if code in PASSING:
            return RequestError(reason, again, kind=SpoiledError)
        return RequestError(reason, check, 0, RefusedError)
    if curl := re.search(r"CURL error: (.*?)( - Failure writing output to destination|;|$)", text):
        advice = f"check the address and the connection, then {again}"
        retries = 2 if _UNREACHABLE.search(curl[1]) else None
        return RequestError(f"no answer ({curl[1]})", advice, retries)
    if NOT_RECOGNIZED in text:
        reason = "not a GeoTIFF, or the server does not answer HTTP range requests"
        return RequestError(reason, check, 2, RefusedError)
    reason = f"the file breaks off or is damaged ({text.rpartition('; ')[2]})"
    return RequestError(reason, again, kind=SpoiledError)
