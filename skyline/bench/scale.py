"""Size measured: what areas cost, and what larger ones would."""

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from skyline.bench.options import (
    Crs,
    Dems,
    JsonFile,
    PlotFile,
    Quick,
    Seed,
    check_outputs,
    print_rows,
    store_folder,
)
from skyline.console import progress_bar
from skyline.experiments.record import write_record
from skyline.experiments.scale import EXTRAPOLATED, ScaleConfig, measure
from skyline.experiments.scale_plot import save_scale
from skyline.terrain.dem import DemOptions, read_dem

_SCALE = ScaleConfig()


def scale(
    dem: Dems,
    area: Annotated[
        list[float] | None,
        typer.Option(
            metavar="KM2",
            help="In the DEM's middle; may be repeated [50 200 800 3000]. What is larger than the "
            "DEM is left out.",
        ),
    ] = None,
    spacing: Annotated[
        float, typer.Option(help="Of the uniform grids, metres.")
    ] = _SCALE.spacing_m,
    shells: Annotated[
        list[int] | None,
        typer.Option(
            help="Distance shells the stores keep; may be repeated, all areas are built for each "
            "[0 12]."
        ),
    ] = None,
    queries: Annotated[int, typer.Option(help="Matched to each store.")] = _SCALE.queries,
    open_limit: Annotated[
        float,
        typer.Option(
            metavar="SECONDS", help="Stores that would take longer to open are not matched."
        ),
    ] = _SCALE.open_limit_s,
    json_file: JsonFile = None,
    plot: PlotFile = None,
    seed: Seed = _SCALE.seed,
    quick: Quick = False,
    crs: Crs = None,
) -> None:
    """Cost against size: renderings, seconds, bytes and query time of growing areas.

    What 10,000 km2 at 50 m would take is extrapolated from them, and its assumptions are said.
    """
    config = ScaleConfig(
        areas_km2=tuple(area or _SCALE.areas_km2),
        spacing_m=spacing,
        shells=tuple(shells if shells is not None else _SCALE.shells),
        queries=queries,
        seed=seed,
        open_limit_s=open_limit,
    )
    check_outputs(json_file, plot)
    terrain = read_dem(dem, DemOptions(crs=crs))
    with store_folder(None) as folder, progress_bar("building and matching") as progress:
        rows = measure(terrain, config.quick() if quick else config, folder, progress)
    columns = {
        "kind": "",
        "area_km2": "km2",
        "spacing_m": "apart m",
        "shells": "shells",
        "renderings": "renderings",
        "build_s": "build s",
        "ms_a_rendering": "ms each",
        "cpu_ms_a_rendering": "cpu ms",
        "megabytes": "MB",
        "bytes_a_rendering": "bytes each",
        "places": "places",
        "open_s": "open s",
        "query_ms": "query ms",
        "within_200m": "in 200 m",
        "median_m": "median m",
        "peak_gigabytes": "peak GB",
    }
    print_rows([{**row, **_readable(row)} for row in rows], columns)
    for row in rows:
        _say_more(row)
    if json_file is not None:
        write_record(json_file, "scale", rows)
    if plot is not None:
        save_scale(rows, plot)


def _readable(row: Mapping[str, Any]) -> dict[str, object]:
    peak = row.get("peak_bytes")
    return {
        "megabytes": row["bytes"] / 1e6,
        "peak_gigabytes": None if peak is None else peak / 1e9,
    }


def _say_more(row: Mapping[str, Any]) -> None:
    """Print what a table has no room for: why there is no query time, and what was assumed."""
    of = f"{row['area_km2']:,g} km2, {row['spacing_m']:g} m apart, {row['shells']} shells"
    if row["kind"] != EXTRAPOLATED:
        if row["not_matched"]:
            typer.echo(f"{of}: not matched: {row['not_matched']}")
        return
    fitted = _cost(row["build_s"], row["build_cpu_s"], row["bytes"])
    probed = _cost(
        row["build_s_at_probe_rate"], row["build_cpu_s_at_probe_rate"], row["bytes_at_probe_rate"]
    )
    typer.echo(
        f"{of}: {fitted}; at the probe's rate {probed}; opening it would take "
        f"{row['opening_bytes'] / 1e9:.3g} GB of memory. Assumed:"
    )
    for assumption in row["assumptions"]:
        typer.echo(f"  - {assumption}")


def _cost(build_s: float, cpu_s: float, size: float) -> str:
    hours, cpu_hours = build_s / 3600.0, cpu_s / 3600.0
    return f"{hours:.3g} hours ({cpu_hours:.3g} of processor time), {size / 1e9:.3g} GB"
