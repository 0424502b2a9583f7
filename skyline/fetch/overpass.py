"""Named peaks of an area from an Overpass server.

An Overpass server answers queries about OpenStreetMap.
"""

import http.client
import json
import math
import time
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlencode, urlsplit
from urllib.request import Request, urlopen

from skyline.errors import FetchError, InputError, one_line, printable, suffix_of
from skyline.fetch.remote import PASSING, PATIENT, Patience, RequestError, repeated
from skyline.files.disk import STANDARD, write_whole
from skyline.files.geojson import GEOJSON, Json, collection, feature
from skyline.geodesy.bounds import Bounds, check_bounds
from skyline.terrain.raster_files import without_secrets

DEFAULT_SERVER = "https://overpass-api.de/api/interpreter"
"""The public server of the OpenStreetMap wiki's page Overpass API, free for small areas."""


def fetch_peaks(bounds_deg: Bounds, server: str, path: Path, patience: Patience = PATIENT) -> int:
    """Write the named peaks of a box as GeoJSON; return their number.

    Volcanoes are peaks, too. `skyline.read_peaks` reads the file, which is written whole or not at
    all. ``server`` is the address of an Overpass interpreter. A failed request is repeated up to
    ``patience.retries`` times; the whole answer must arrive within ``patience.timeout_s`` seconds.

    Raises `InputError` if the path has no GeoJSON suffix, the bounds are not in order, the server
    is not an http address, or the file cannot be written. Raises `FetchError` if the server fails,
    is too slow, or answers with anything but a list of peaks in the box.
    """
    if str(path) != STANDARD:
        suffix_of(path, GEOJSON)
    west, south, east, north = check_bounds(bounds_deg)
    if urlsplit(server).scheme not in ("http", "https") or not urlsplit(server).hostname:
        raise InputError(
            f"server is {server!r}; expected the address of an Overpass interpreter, e.g. "
            "https://host/api/interpreter"
        )
    spans = [(west, east)] if west < east else [(west, 180.0), (-180.0, east)]
    wanted = "".join(
        f'node["natural"~"^(peak|volcano)$"]["name"]({south},{begin},{north},{end});'
        for begin, end in spans
    )
    query = f"[out:json][timeout:{patience.timeout_s}];({wanted});out;"
    body = urlencode({"data": query}).encode()
    answer = repeated(server, lambda: _ask(server, body, patience.timeout_s), patience)
    features = [_feature(server, one, (south, north), spans) for one in _elements(server, answer)]
    if not features:
        raise FetchError(
            f"{without_secrets(server)} knows no named peak in the bounds; choose larger bounds"
        )
    content = collection(features, attribution="OpenStreetMap contributors, ODbL")
    write_whole(path, json.dumps(content, ensure_ascii=False, indent=1) + "\n")
    return len(features)


def _ask(server: str, query: bytes, timeout_s: int) -> bytes:
    """Return the whole answer, which must arrive in time; raises `RequestError`."""
    request = Request(server, query, {"User-Agent": "skyline", "Accept": "application/json"})
    deadline = time.monotonic() + timeout_s
    body = bytearray()
    retries = None
    try:
        with urlopen(request, timeout=timeout_s) as answer:
            promised = answer.length
            # Piece by piece, since a server that sends a byte a second never times out.
            while piece := answer.read1(1 << 16):
                body += piece
                if time.monotonic() > deadline:
                    raise TimeoutError(f"incomplete after {timeout_s} s")
        if promised is None or len(body) == promised:
            return bytes(body)
        reason = f"no whole answer ({len(body)} of {promised} bytes)"
    except HTTPError as error:
        reason = f"the server answers HTTP {error.code}"
        retries = None if error.code in PASSING else 0
    except URLError as error:
        reason = f"no answer ({error.reason})"
    except (OSError, http.client.HTTPException) as error:
        reason = f"no whole answer ({error or type(error).__name__})"
    # Outside the handlers, so that the error does not keep the connection open.
    raise RequestError(reason, "check the address, or give the same command again later", retries)


def _elements(server: str, answer: bytes) -> list[Any]:
    """Return an answer's elements; raises `FetchError` unless it is whole."""
    try:
        content = json.loads(answer)
        elements = [*content["elements"]]
        note = content.get("remark", "")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        begins = one_line(answer[:60].decode("utf-8", "replace"))
        raise FetchError(
            f"{without_secrets(server)}: the answer is not one of Overpass (it begins `{begins}`); "
            "check the address"
        ) from None
    if "error" in str(note):
        raise FetchError(
            f"{without_secrets(server)}: the server gave up ({one_line(note)[:120]}); "
            "choose smaller bounds, or try again later"
        )
    return elements


def _feature(
    server: str, element: Any, lats: tuple[float, float], spans: list[tuple[float, float]]
) -> Json:
    """Return a GeoJSON feature; `FetchError` unless a named peak in the box."""
    try:
        lon = float(element["lon"])
        lat = float(element["lat"])
        name = element["tags"]["name"]
        height = element["tags"].get("ele")
    except (KeyError, TypeError, ValueError, AttributeError):
        lon = lat = math.nan
        name = height = None
    inside = lats[0] <= lat <= lats[1] and any(west <= lon <= east for west, east in spans)
    if not inside or not isinstance(name, str):
        raise FetchError(
            f"{without_secrets(server)}: the answer has {str(element)[:80]!r}, which is not a "
            "named peak in the bounds; nothing was written"
        )
    properties = {"name": printable(name)}
    if height is not None:
        properties["ele"] = printable(str(height))
    return feature("Point", [lon, lat], properties)
