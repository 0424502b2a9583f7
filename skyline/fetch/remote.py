"""GeoTIFFs on HTTP servers, through GDAL: what fails is tried again, then told in one line."""

import logging
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar
from urllib.parse import urlsplit

import rasterio
from rasterio.errors import RasterioError

from skyline.errors import FetchError, InputError

_T = TypeVar("_T")

_STALLED_BYTES_A_S = 1000

_AGAIN = re.compile(r"HTTP response code: (429|5\d\d)|CURL error|[Rr]ead (error|failed)|IReadBlock")
"""What another attempt may mend; other answers are the same every time."""


@dataclass(frozen=True, slots=True)
class HttpOptions:
    """How patient a fetch is."""

    retries: int = 4
    """How often a request that failed is made again."""
    retry_delay_s: float = 1.0
    """Seconds before the first time; twice as long before each further one."""
    timeout_s: int = 30
    """Seconds without an answer, or with less than 1 kB a second, after which a request failed."""

    def __post_init__(self) -> None:
        if not 0 <= self.retries <= 100:
            raise InputError(f"retries is {self.retries}; expected 0 to 100")
        if not 0.0 < self.retry_delay_s <= 3600.0:
            raise InputError(f"retry delay is {self.retry_delay_s} s; expected 0 to 3600 seconds")
        if not 1 <= self.timeout_s <= 3600:
            raise InputError(f"timeout is {self.timeout_s} s; expected 1 to 3600 seconds")


class AbsentError(FetchError):
    """The server says that there is no such file."""


def with_remote(url: str, options: HttpOptions, work: Callable[[Any], _T]) -> _T:
    """Open the GeoTIFF at an address and return what ``work`` makes of the rasterio dataset.

    ``work`` is called again with the file opened anew where the connection failed it.

    Raises
    ------
    AbsentError
        There is no such file (HTTP 404).
    FetchError
        The server fails, is too slow, breaks off, or sends something that is not a GeoTIFF.
    """
    attempts, delay_s = 0, options.retry_delay_s
    while True:
        attempts += 1
        try:
            # GTiff alone: other drivers follow what a stranger's file refers to.
            with _environment(options), rasterio.open(f"/vsicurl/{url}", driver="GTiff") as file:
                return work(file)
        except RasterioError as error:
            reason = _reason(error, url)
            if "HTTP response code: 404" in reason:
                raise AbsentError(f"{shown(url)}: there is no such file (HTTP 404)") from error
            if attempts > options.retries or not _AGAIN.search(reason):
                raise FetchError(_failure(url, reason, attempts)) from error
        time.sleep(delay_s)
        delay_s *= 2.0


def shown(url: str) -> str:
    """Return an address without what may be secret in it: user, password and query."""
    parts = urlsplit(url)
    return parts._replace(netloc=parts.netloc.rpartition("@")[2], query="", fragment="").geturl()


@contextmanager
def _environment(options: HttpOptions) -> Iterator[None]:
    """Configure GDAL's HTTP client; what it logs on the way is told by the error at the end."""
    settings = {
        # GDAL repeats a request that is answered 429, 500, 502, 503 or 504; `with_remote` the rest.
        "GDAL_HTTP_MAX_RETRY": options.retries,
        "GDAL_HTTP_RETRY_DELAY": options.retry_delay_s,
        "GDAL_HTTP_CONNECTTIMEOUT": options.timeout_s,
        "GDAL_HTTP_LOW_SPEED_TIME": options.timeout_s,
        "GDAL_HTTP_LOW_SPEED_LIMIT": _STALLED_BYTES_A_S,
        # No look at what else is in the folder, no side-car files.
        "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",
        "GDAL_PAM_ENABLED": "NO",
        # What failed or broke off must not be remembered when it is tried again.
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


def _reason(error: BaseException, url: str) -> str:
    """Return what GDAL said, from the outermost error to its cause, in one line."""
    said: list[str] = []
    cause: BaseException | None = error
    while cause is not None:
        said.append(" ".join(str(cause).split()))
        cause = cause.__cause__
    told = "; ".join(dict.fromkeys(said)).replace(f"/vsicurl/{url}", shown(url))
    return told.replace(" - Failure writing output to destination", "")


def _failure(url: str, reason: str, attempts: int) -> str:
    where = shown(url)
    times = f"tried {attempts} times" if attempts > 1 else "not tried again"
    if status := re.search(r"HTTP response code: (\d+)", reason):
        code = int(status[1])
        advice = "check the address and the source's template"
        if code in (401, 403):
            advice = (
                "check that the source is open to you (some servers answer this for what is absent)"
            )
        elif code == 429 or code >= 500:
            advice = "give the same command again later: what was fetched is kept"
        return f"{where}: the server answers HTTP {code}, {times}; {advice}"
    if said := re.search(r"CURL error: (.*?)(;|$)", reason):
        return (
            f"{where}: no answer ({said[1]}), {times}; check the address and the connection, then "
            "give the same command: what was fetched is kept"
        )
    if "not recognized as being in" in reason:
        return (
            f"{where}: not a GeoTIFF, or the server does not answer HTTP range requests; check the "
            "address and the source's template"
        )
    return (
        f"{where}: the file breaks off or is damaged ({reason.rpartition('; ')[2]}), {times}; give "
        "the same command again: what was fetched is kept"
    )
