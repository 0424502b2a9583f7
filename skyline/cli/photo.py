"""``skyline extract`` and ``skyline serve``: a photo's skyline, and the page in the browser."""

from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path
from typing import Annotated

import numpy as np
from typer import Argument, Option

from skyline.batch import Query
from skyline.camera import Projection
from skyline.cli.console import (
    PEAKS,
    StoreDem,
    StoreFile,
    check_outputs,
    output_option,
    panel,
    print_written,
)
from skyline.errors import InputError, MissingFileError, SkylineError, check_suffix, suffix_of
from skyline.photo.overlay import OVERLAYS, write_overlay
from skyline.photo.photo import read_photo
from skyline.photo.read import find_skyline
from skyline.photo.trace import TRACES, write_trace
from skyline.store.read import is_store

FieldOfView = Annotated[
    float | None,
    Option(
        metavar="DEG",
        help="Horizontal field of view in degrees; by default from the photo's EXIF or XMP.",
    ),
]
PhotoFile = Annotated[Path, Argument(metavar="PHOTO", help="The photo.")]
PhotoProjection = Annotated[
    Projection | None,
    panel("The photos")("--projection", help="Projection of a panorama, usually cylindrical."),
]


def extract(
    photo: PhotoFile,
    output: Annotated[Path, output_option("The trace to write.", "FILE.csv")],
    overlay: Annotated[
        Path | None, Option(metavar="PNG", help="Also write the photo with its skyline drawn.")
    ] = None,
    fov_deg: FieldOfView = None,
    projection: PhotoProjection = None,
    sky_model: Annotated[
        Path | None, Option(metavar="ONNX", help="Your own sky segmentation model (extra `onnx`).")
    ] = None,
) -> None:
    """Find the skyline in a photo and write it as a trace that a person can correct."""
    check_outputs([output, overlay], [photo])
    check_suffix(output, TRACES)
    if overlay is not None:
        suffix_of(overlay, OVERLAYS)
    read = read_photo(photo, fov_deg, projection=projection)
    skyline = find_skyline(read, sky_model)
    if overlay is not None:
        write_overlay(read.rgb, skyline, overlay)
    write_trace(skyline, output)
    trusted = np.count_nonzero(skyline.trusted)
    print_written(output, f"skyline found in {trusted} of {skyline.width_px} columns")
    if skyline.lens is not None and skyline.lens.reason:
        print_written(output, skyline.lens.in_words)


def serve(
    store: StoreFile,
    photos: Annotated[
        list[Path] | None,
        Argument(
            metavar="[PHOTO...]",
            help="Photos that are open on the page at first. Before them may come more stores of "
            "the same DEM, which are searched as one.",
        ),
    ] = None,
    dem: StoreDem = None,
    peaks: Annotated[Path | None, PEAKS] = None,
    port: Annotated[
        int,
        Option(min=0, max=65535, metavar="PORT", help="Port of the page; 0 takes any free port."),
    ] = 8765,
    host: Annotated[
        str,
        Option(
            metavar="ADDRESS",
            help="Address to listen on; 0.0.0.0 or :: lets other machines in, by all addresses of "
            "this machine.",
        ),
    ] = "127.0.0.1",
) -> None:
    """Serve a page for the browser: drop photos, mend skylines, find places, fit by hand."""
    stores, given = split_stores(store, photos or [])
    for photo in given:
        if not photo.is_file():
            raise MissingFileError(f"{photo} does not exist; expected a photo or a store")
        if is_store(photo):
            raise InputError(f"{photo} is a store; name the stores before the photos")
    try:
        from skyline.web.engine import Engine  # noqa: PLC0415  (an extra)
        from skyline.web.server import serve as serve_page  # noqa: PLC0415
    except ImportError as error:
        raise InputError(
            f"the page needs packages that are not installed ({error.name}); "
            "pip install starlette uvicorn websockets XStatic-Leaflet"
        ) from error
    first = [path.absolute() for path in given]
    serve_page(lambda: Engine(stores, dem, first, peaks), host, port)


def split_stores(store: Path, others: Sequence[Path]) -> tuple[tuple[Path, ...], Sequence[Path]]:
    """Return the first store with the stores named after it, and the files named after those."""
    stores = (store, *takewhile(is_store, others))
    return stores, others[len(stores) - 1 :]


def usable_queries(queries: Sequence[Query]) -> list[Query]:
    """Return the queries that can be read; raises the error of the first if there are none."""
    usable, errors = [], []
    for one in queries:
        try:
            one.check()
            usable.append(one)
        except SkylineError as error:
            errors.append(error)
    if not usable:
        raise errors[0]
    return usable
