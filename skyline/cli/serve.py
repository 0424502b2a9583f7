"""``skyline serve``: the page in the browser."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from skyline.cli.options import PEAKS
from skyline.errors import InputError, MissingFileError
from skyline.store.read import is_store
from skyline.tasks.match import PAGE_PORT, split_stores


def serve(
    named: Annotated[
        list[Path] | None,
        Argument(
            metavar="STORE.h5|PHOTO",
            help="Stores of one DEM, searched as one, and photos that are open on the page at "
            "first. A store is as `build` writes it, or the folder of an area that `cache` lists. "
            "Without a store, the area of each photo is fetched and built, as `locate` does.",
        ),
    ] = None,
    dem: Annotated[
        list[str] | None,
        Option(
            metavar="DEM",
            help="The store's DEM, if it has moved, or without a store the elevation of the "
            "photos' areas: a file, or a folder or zip of files; may be repeated.",
            show_default="the files from which the store was built, or fetched tiles",
        ),
    ] = None,
    peaks: Annotated[Path | None, PEAKS] = None,
    port: Annotated[
        int,
        Option(min=0, max=65535, metavar="PORT", help="Port of the page; 0 takes any free port."),
    ] = PAGE_PORT,
    host: Annotated[
        str,
        Option(
            metavar="ADDRESS",
            help="Address to listen on; 0.0.0.0 or :: lets other machines in by any address of "
            "this machine.",
        ),
    ] = "127.0.0.1",
) -> None:
    """Serve a page that finds the places of photos in a browser.

    On the page, drop photos, mend their skylines, find places, and fit poses by
    hand.
    """
    stores, photos = _split(named or [])
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


def _split(named: Sequence[Path]) -> tuple[Sequence[Path], Sequence[Path]]:
    """Return the stores, if any, and the photos of the arguments."""
    if not named:
        return (), ()
    stores, photos = split_stores(named[0], named[1:])
    is_photo = stores[0].is_file() and not is_store(stores[0])
    return ((), named) if is_photo else (stores, photos)
