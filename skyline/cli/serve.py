"""``skyline serve``: the page in the browser."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from skyline.cli.options import PEAKS, StoreDem, StoreFile
from skyline.errors import InputError, MissingFileError
from skyline.tasks.match import split_stores


def serve(
    store: StoreFile,
    photo: Annotated[
        list[Path] | None,
        Argument(
            metavar="PHOTO",
            help="Photos that are open on the page at first. More stores of the same DEM may be "
            "named before them; all stores are searched as one.",
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
    """Serve a page that finds the places of photos in a browser.

    On the page, drop photos, mend their skylines, find places, and fit poses by
    hand.
    """
    stores, photos = split_stores(store, photo or [])
    for one in photos:
        if not one.is_file():
            raise MissingFileError(f"{one} does not exist; expected a photo or a store")
    try:
        from skyline.web.engine import Engine  # noqa: PLC0415  (an extra)
        from skyline.web.server import serve as serve_page  # noqa: PLC0415
    except ImportError as error:
        raise InputError(
            f"the page needs packages that are not installed ({error.name}); "
            "pip install starlette uvicorn websockets XStatic-Leaflet"
        ) from error
    first = [path.absolute() for path in photos]
    serve_page(lambda: Engine(stores, dem, first, peaks), host, port)
