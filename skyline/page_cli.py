"""``skyline serve``: the page on which a person finds the place."""

from pathlib import Path
from typing import Annotated

import typer

from skyline.errors import InputError, MissingFileError


def serve(
    store: Annotated[Path, typer.Argument(metavar="STORE.h5")],
    photos: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[PHOTO...]", help="Photos that the page begins with."),
    ] = None,
    dem: Annotated[
        list[str] | None,
        typer.Option(metavar="DEM", help="The store's DEM, if it has moved; repeat for each tile."),
    ] = None,
    peaks: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Peaks to name: name,lon,lat[,height_m]."),
    ] = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the page; 0 takes any that is free.")
    ] = 8765,
    host: Annotated[
        str, typer.Option(help="Address to listen on; another lets other machines in.")
    ] = "127.0.0.1",
) -> None:
    """Open a page in the browser: drop photos, mend skylines, find places, fit by hand."""
    for photo in photos or ():
        if not photo.is_file():
            raise MissingFileError(f"{photo} does not exist; expected a photo")
    try:
        from skyline.web.engine import Given  # noqa: PLC0415  (an extra)
        from skyline.web.server import serve as serve_page  # noqa: PLC0415
    except ImportError as error:
        raise InputError(
            f"the page needs packages that are not installed ({error.name}); "
            "pip install 'skyline[web]'"
        ) from error
    given = Given(store, tuple(dem or ()), tuple(path.absolute() for path in photos or ()), peaks)
    serve_page(given, host, port)
