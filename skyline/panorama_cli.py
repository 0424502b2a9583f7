"""``skyline panorama`` and ``skyline peaks``: what is seen from a place, and the names for it."""

from pathlib import Path
from typing import Annotated

import typer

from skyline.console import Crs, Dems, Reproject, Surfaces, parse_bounds, parse_place, patience
from skyline.fetch.overpass import fetch_peaks
from skyline.fetch.remote import HttpOptions
from skyline.pipeline.panorama import PanoramaConfig, save_panorama_of
from skyline.report.peaks import read_peaks
from skyline.terrain.blocks import Blocks
from skyline.terrain.dem import DemOptions, read_blocks, read_dem
from skyline.terrain.surface import read_surface

_HTTP = HttpOptions()
_DEFAULTS = PanoramaConfig()


def panorama(
    dem: Dems,
    at: Annotated[str, typer.Option(metavar="LON,LAT", help="The place, degrees (WGS 84).")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="PNG, SVG or PDF, by its suffix.")
    ],
    peaks: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Peaks to name: GeoJSON, or CSV with name,lon,lat[,height_m]."
        ),
    ] = None,
    heading: Annotated[
        float, typer.Option(metavar="DEG", help="The picture's middle, from true north.")
    ] = _DEFAULTS.heading_deg,
    fov_deg: Annotated[
        float, typer.Option("--fov-deg", help="The picture's angle, 5 to 360.")
    ] = _DEFAULTS.fov_deg,
    eye_height: Annotated[
        float, typer.Option("--eye-height", metavar="M", help="Metres above ground.")
    ] = _DEFAULTS.eye_height_m,
    surface: Surfaces = None,
    crs: Crs = None,
    reproject: Reproject = False,
) -> None:
    """Draw what is seen from a place, with the names of the peaks that are seen."""
    lonlat = parse_place(at)
    config = PanoramaConfig(heading, fov_deg, eye_height)
    options = DemOptions(crs=crs, reproject=reproject)
    with patience(f"drawing {output}"):
        if surface:
            terrain = read_dem(dem, options)
            blocks, over = Blocks.of(terrain), read_surface(surface, terrain)
        else:
            blocks, over = read_blocks(dem, options), None
        gazetteer = None if peaks is None else read_peaks(peaks, blocks.frame)
        seen = save_panorama_of(blocks, lonlat, output, gazetteer, config, over)
    named = "" if gazetteer is None else f", {seen} of {len(gazetteer)} peaks are seen"
    typer.echo(f"{output}: {output.stat().st_size / 1e6:.1f} MB{named}")


def peaks(
    bbox: Annotated[str, typer.Option(metavar="W,S,E,N", help="The box, in degrees (WGS 84).")],
    server: Annotated[
        str,
        typer.Option(metavar="URL", help="An Overpass server: https://host/api/interpreter."),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The GeoJSON to write.")
    ],
    retries: Annotated[
        int, typer.Option(help="How often to repeat a failed request.")
    ] = _HTTP.retries,
    timeout: Annotated[
        int, typer.Option(metavar="SECONDS", help="How long to wait for the whole answer.")
    ] = _HTTP.timeout_s,
) -> None:
    """Fetch the named peaks of a box from an Overpass server, for `--peaks`."""
    options = HttpOptions(retries=retries, timeout_s=timeout)
    count = fetch_peaks(parse_bounds(bbox), server, output, options)
    typer.echo(f"{output}: {count} peaks (OpenStreetMap contributors, ODbL)")
