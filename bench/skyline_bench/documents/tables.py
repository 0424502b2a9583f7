"""The tables of README and docs/, made from the records."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from skyline.pose.pose import RIGHT_WITHIN_M
from skyline_bench.documents.results import (
    Results,
    Table,
    answered_right,
    count,
    digits,
    linked,
    median_of,
    metres,
    percent,
    with_interval,
)
from skyline_bench.measuring import Row
from skyline_bench.paper import TABLE_1, Setup
from skyline_bench.queries.manifest import LOCATE, REFUSE
from skyline_bench.search.trials import (
    ALL,
    CLASSES,
    THIRDS,
    as_large,
    by_planner,
    gain_points,
)
from skyline_bench.truth.agreement import PIXEL_TAN

# --- skylines -------------------------------------------------------------------------------

# The rows of the record of speed: paths and settings.
FOUR_VIEWS = "horizon", "W = 640"
_ALL_ROUND = "all round", "720 azimuths"
PLACE = "all round", "360 azimuths"
_DEPTH = "depth", "W = 640"
_EMBREE = "embree", "15 bisections"
_GRASS = "grass", "r.horizon"


def speed(results: Results) -> Table:
    """Return a table of the ways to a skyline.

    Errors are in degrees, at the middle of a view.
    """
    ways = {
        FOUR_VIEWS: "**Skyline**, four views of 640 columns",
        _ALL_ROUND: "**Skyline**, all the way round, 720 azimuths",
        PLACE: "**Skyline**, a place: all the way round, 360 azimuths",
        _EMBREE: "Embree's rays, four views, 15 bisections from the neighbouring columns",
        _DEPTH: "depth images, as the paper draws them",
        _GRASS: "GRASS `r.horizon`, 720 azimuths; reads its map anew for each viewpoint",
    }
    table = Table()
    for way, row in _measured(results, ways):
        table.append(
            {
                "way": way,
                "ms a viewpoint": _ms(row["ms_per_viewpoint"]),
                "viewpoints compared": count(row["compared_viewpoints"]),
                "rms error": f"{digits(_degrees(row['rms_px']))}°",
                "greatest error": f"{digits(_degrees(row['max_px']))}°",
            }
        )
    return table


def skylines(results: Results) -> Table:
    """Return a detailed table of the ways to a skyline.

    Errors are in px.
    """
    ways = {
        FOUR_VIEWS: "**horizon rasterizer, four views**",
        _ALL_ROUND: "**horizon rasterizer, all round, 720 azimuths**",
        PLACE: "**horizon rasterizer, all round, 360 azimuths (a place)**",
        _DEPTH: "depth images, four views, read back one by one",
        _EMBREE: "Embree's rays, four views, 15 bisections from the neighbouring columns",
        _GRASS: "GRASS r.horizon, 720 azimuths, one place a call",
        ("oracle", "exact"): "oracle, float64, four views",
    }
    table = Table()
    for way, row in _measured(results, ways):
        cpu_ms = row["cpu_ms_per_viewpoint"]
        table.append(
            {
                "way": way,
                "n": count(row["compared_viewpoints"]),
                "a viewpoint": f"{_ms(row['ms_per_viewpoint'])} ms",
                "processor time": "-" if cpu_ms is None else f"{_ms(cpu_ms)} ms",
                "greatest error": f"{digits(row['max_px'])} px",
                "rms": f"{digits(row['rms_px'])} px",
            }
        )
    return table


def _measured(results: Results, ways: Mapping[tuple[str, str], str]) -> Iterator[tuple[str, Row]]:
    """Yield the words and the row of each way.

    A peer that was not installed has no row and is left out.
    """
    found = {(row["path"], row["setting"]): row for row in results.rows("speed_error")}
    return ((words, found[key]) for key, words in ways.items() if key in found)


def way_of(results: Results, key: tuple[str, str]) -> Row:
    """Return the row of a path and a setting in `speed_error`."""
    return results.row("speed_error", path=key[0], setting=key[1])


def _ms(time_ms: float) -> str:
    return count(time_ms) if time_ms >= 100.0 else digits(time_ms)


def _degrees(error_px: float) -> float:
    """Return an error in px as an angle at a view's middle.

    The view has 640 columns.
    """
    return float(np.degrees(np.arctan(error_px * PIXEL_TAN)))


# --- the paper ------------------------------------------------------------------------------

COMPARED = (
    ("Davos", "the paper's", "paper_figure7_davos"),
    ("Davos", "ours", "placing_davos"),
    ("Owens Valley", "the paper's", "paper_figure7_owens"),
    ("Owens Valley", "ours", "placing_owens"),
    ("Andes", "ours", "placing_andes"),
)
"""Terrain, planner and matcher, and the record in which both kinds of stores were searched."""


def adaptive(results: Results) -> Table:
    """Compare each adaptive store with the uniform grid of as many renderings.

    The two tie unless their difference is greater than its 95 % interval.
    """
    table = Table()
    for terrain, planner, record in COMPARED:
        rows = results.rows(record)
        for plan in by_planner(rows)[1]:
            grid = as_large(plan, rows)
            if grid is None:
                continue
            gain, half = gain_points(plan, grid)
            table.append(
                {
                    "terrain": linked(terrain, record),
                    "km2": count(plan["km2"]),
                    "planner and matcher": planner,
                    "queries": f"`{plan['queries']}`",
                    "n": count(plan["n"]),
                    "renderings": count(plan["renderings"]),
                    "adaptive": with_interval(plan),
                    "uniform": percent(grid["within_200m"]),
                    "of renderings": count(grid["renderings"]),
                    "difference, points": f"{gain:+.1f} (± {half:.1f})",
                    "better": "tie"
                    if abs(gain) <= half
                    else "adaptive"
                    if gain > 0.0
                    else "uniform",
                }
            )
    return table


def planning(results: Results) -> Table:
    """Return how many viewpoints each strategy needs in the paper's simulation."""
    table = Table()
    for number, setup in enumerate(TABLE_1, start=1):
        rows = results.rows("table1", row=number)
        needed = {row["strategy"]: count(row["A"]) for row in rows}
        table.append({"row": _setup(setup), **needed})
    return table


def _setup(setup: Setup) -> str:
    kind = "affine" if setup.affine else "non-affine"
    turned = f", r = {setup.rotation_deg:g}" if setup.rotation_deg else ""
    share = f"{100.0 * setup.coverage:g} %"
    return f"{kind}, p = {setup.peaks}, t = {setup.threshold_px:g}, {share}{turned}"


def predictors(results: Results) -> Table:
    """Return how well reprojection errors tell which moved views look alike."""
    shown = {
        "affine-mean": "Equation 4, mean depth (the paper's)",
        "affine-median": "Equation 4, median depth",
        "affine-least-squares": "least-squares warp of the points",
    }
    table = Table()
    for name, words in shown.items():
        row = results.row("prediction_quality", predictor=name)
        table.append(
            {
                "predictor": words,
                "n": count(row["n"]),
                "precision": f"{row['precision']:.2f}",
                "recall": f"{row['recall']:.2f}",
                "rank correlation": f"{row['rank_correlation']:.2f}",
            }
        )
    return table


def figure_7(results: Results) -> Table:
    """Return the mean errors of the paper's matcher in each store.

    They are given by thirds of the queries.
    """
    table = Table()
    for terrain, planner, record in COMPARED:
        if planner == "ours":
            continue
        every = sorted(results.rows(record, group=ALL), key=lambda row: row["renderings"])
        for row in every:
            about = {key: row[key] for key in ("store", "matcher", "queries")}
            parts = {
                group: count(results.row(record, group=group, **about)["mean_m"])
                for group in (*THIRDS, ALL)
            }
            table.append(
                {
                    "store": f"{linked(terrain, record)}, {_named(row['store'])}",
                    "km2": count(row["km2"]),
                    "n": count(row["n"]),
                    "renderings": count(row["renderings"]),
                    **parts,
                    "within 200 m": percent(row["within_200m"]),
                }
            )
    return table


# --- places ---------------------------------------------------------------------------------

_SEARCHED = {
    "matching": ("Davos", "30 m"),
    "matching_rofental": ("Rofental", "50 m"),
    "matching_owens": ("Owens Valley", "90 m"),
    "matching_california": ("California", "90 m"),
}
"""Records of plain queries, and the terrain and the spacing of its model."""
_GROUPS = {"< 150 m": "under 150 m", "150-400 m": "150 to 400 m", "> 400 m": "over 400 m"}


def how_often(results: Results) -> Table:
    """Return how often plain queries are found and answered on each terrain."""
    table = Table()
    for record, (terrain, model) in _SEARCHED.items():
        row = results.row(record, queries="plain", group=ALL)
        table.append(
            {
                "terrain": linked(terrain, record),
                "km2": count(row["km2"]),
                "model": model,
                "n": count(row["n"]),
                "within 200 m": with_interval(row),
                "within 1 km": percent(row["within_1km"]),
                "median error": metres(row["median_m"]),
                "answered": percent(row["answered"]),
                "answers right": percent(row["precision"]),
            }
        )
    return table


def places(results: Results) -> Table:
    """Return how often queries are found in a store of Davos.

    The shares are given by kind and by the distance of the skyline.
    """
    kinds = {
        "plain": ("**plain**", (ALL, *reversed(CLASSES))),
        "occluded": ("30 % hidden", (ALL, "> 400 m")),
        "bent": ("bent by the lens", (ALL, "> 400 m")),
        "other-dem": ("other DEM, 10 m rms off", (ALL, "> 400 m")),
    }
    table = Table()
    for kind, (words, groups) in kinds.items():
        for group in groups:
            row = results.row("matching", queries=kind, group=group)
            table.append(
                {
                    "queries": words if group == ALL else "",
                    "N": _GROUPS.get(group, "all"),
                    "n": count(row["n"]),
                    "within 200 m": _share(row),
                    "median": metres(row["median_m"]),
                    "answered": percent(row["answered"]),
                    "of these right": percent(row["precision"]),
                    "radius holds": percent(row["radius_holds"]),
                    "lost by the search": percent(row["lost_by_search"]),
                    "processor s": f"{row['query_cpu_s']:.1f}",
                }
            )
    return table


def other_terrain(results: Results) -> Table:
    """Return how often queries are found on Rofental and Owens Valley.

    The queries are plain ones; the shares are given by the distance of the skyline.
    """
    return _by_distance(results, "matching_rofental", "matching_owens")


def large_area(results: Results) -> Table:
    """Return how often queries are found in all of California.

    The queries are plain ones; the shares are given by the distance of the skyline.
    """
    return _by_distance(results, "matching_california")


def _by_distance(results: Results, *records: str) -> Table:
    table = Table()
    for record in records:
        for group in (ALL, *reversed(CLASSES)):
            row = results.row(record, queries="plain", group=group)
            is_whole = group == ALL
            table.append(
                {
                    "terrain": linked(_SEARCHED[record][0], record) if is_whole else "",
                    "km2": count(row["km2"]) if is_whole else "",
                    "N": _GROUPS.get(group, "all"),
                    "n": count(row["n"]),
                    "within 200 m": _share(row),
                    "within 1 km": percent(row["within_1km"]),
                    "answered": percent(row["answered"]),
                    "of these right": percent(row["precision"]),
                    "lost by the search": percent(row["lost_by_search"]),
                    "lost to likeness": percent(row["lost_to_likeness"]),
                }
            )
    return table


def placing_davos(results: Results) -> Table:
    """Return planned stores of Davos beside uniform ones."""
    return _placing(results, "placing_davos")


def placing_owens(results: Results) -> Table:
    """Return planned stores of Owens Valley beside uniform ones."""
    return _placing(results, "placing_owens")


def placing_andes(results: Results) -> Table:
    """Return planned stores of the Andes beside uniform ones."""
    return _placing(results, "placing_andes")


def _placing(results: Results, record: str) -> Table:
    table = Table()
    for row in sorted(results.rows(record, group=ALL), key=lambda row: row["places"]):
        parts = {
            f"{_GROUPS[group]} (n = {part['n']})": percent(part["within_200m"])
            for group in CLASSES
            for part in results.rows(record, store=row["store"], group=group)
        }
        table.append(
            {
                "store": _named(row["store"]),
                "places": count(row["places"]),
                "MB": digits(row["bytes"] / 1e6, 2 if row["bytes"] < 1e8 else 3),
                "processor s to build": count(row["build_cpu_s"]),
                "within 200 m": percent(row["within_200m"]),
                **parts,
                "answered": percent(row["answered"]),
                "of these right": percent(row["precision"]),
                "claimed loss": percent(row["claimed_loss"]),
                "lost": percent(row["lost"]),
                "processor s a query": f"{row['query_cpu_s']:.1f}",
            }
        )
    return table


def _named(store: str) -> str:
    """Return the words for a store's name."""
    kind, _, size = store.partition("-")
    if kind == "planned":
        default = size == "100000"
        return f"**`--places {size}`, the default**" if default else f"`--places {size}`"
    if kind == "places":
        return f"grid of {size} m"
    return f"{size} m" if kind == "uniform" else f"`{kind}`, {size.removesuffix('px')} px"


def _share(row: Row) -> str:
    return with_interval(row) if row["group"] == ALL else percent(row["within_200m"])


def same_place(results: Results) -> Table:
    """Return how photos of one place are found, alone and together."""
    kinds = {"alone": "one by one", "together": "together", "with a stranger": "with a stranger"}
    table = Table()
    for kind, words in kinds.items():
        for group in (ALL, THIRDS[0]):
            row = results.row("same_place", queries=kind, group=group)
            table.append(
                {
                    "photos": words if group == ALL else "",
                    "places": "all" if group == ALL else "nearest third",
                    "n": count(row["n"]),
                    "within 200 m": with_interval(row),
                    "median": metres(row["median_m"]),
                    "answered": percent(row["answered"]),
                    "right of these": percent(row["precision"]),
                    "named": "" if kind == "alone" else percent(row["named"]),
                }
            )
    return table


# --- photographs ----------------------------------------------------------------------------


def photographs(results: Results) -> Table:
    """Return how real photographs are placed."""
    shown = {
        "photos_california": "California",
        "photos_california_gps": "the same with `--use-gps`",
        "photos_california_nine_tiles": "eight of them, in nine tiles",
        "photos_california_tiles": "all ten, in 40 tiles",
        "photos_columbia": "Columbia Glacier, traces",
        "photos_columbia_photos": "Columbia Glacier, the photographs of some of these traces",
        "panoramas": "panoramas, drawn",
    }
    table = Table()
    for record, words in shown.items():
        rows = results.rows(record, kind=LOCATE)
        answered, right = answered_right(rows)
        near = sum(row.get("within_m") == RIGHT_WITHIN_M for row in rows)
        table.append(
            {
                "photographs": linked(words, record),
                "n": count(len(rows)),
                "within 200 m": count(sum(row.get("rank") == 1 for row in rows)),
                "median error": metres(median_of(rows, "error_m")),
                "answered within 200 m": count(near),
                "within 1 km": count(answered - near),
                "of the answers right": count(right),
            }
        )
    return table


def known_places(results: Results) -> Table:
    """Return how photographs at known places are oriented."""
    shown = {
        ("orient_columbia", LOCATE): "Columbia Glacier, traces",
        ("orient_columbia_photos", LOCATE): "Columbia Glacier, photographs",
        ("orient_california", LOCATE): "California",
        ("orient_california", REFUSE): "California, the summit of Half Dome",
    }
    table = Table()
    for (record, kind), words in shown.items():
        row = results.row(record, measured="photos", group=kind)
        answered = [one for one in results.rows(record, kind=kind) if one["answered"]]
        known = [one["off_deg"] for one in answered if one["off_deg"] is not None]
        lenses = [one for one in answered if one["fov_off"] is not None]
        near = round(row.get("fov_within_3_%", 0.0) * len(lenses))
        table.append(
            {
                "photographs": linked(words, record),
                "n": count(row["n"]),
                "answered": count(row["answered"]),
                "heading known": count(len(known)) if answered else "",
                "wrong": count(row["wrong"]) if answered else "",
                "median error": f"{row['median_deg']:.2f} degrees" if known else "",
                "largest": f"{max(known):.2f} degrees" if known else "",
                "standard error claimed": f"{row['median_sd_deg']:.2f} degrees" if known else "",
                "fov within 3 %": f"{near} of {len(lenses)}" if lenses else "",
            }
        )
    return table


def made_photos(results: Results) -> Table:
    """Return how made photos beside the given places are oriented."""
    shown = {
        ALL: "all",
        "> 400 m": "skylines over 400 m away",
        "sd <= 0.15": "standard error below 0.15 degrees",
    }
    table = Table()
    for group, words in shown.items():
        row = results.row("orient_davos", measured="made photos", group=group)
        table.append(
            {
                "photos": words,
                "n": count(row["n"]),
                "answered": count(row["answered"]),
                "within 0.3 degrees": percent(row["within_0.3_deg"]),
                "within 1": percent(row["within_1_deg"]),
                "median error": f"{row['median_deg']:.2f} degrees",
                "within two standard errors": percent(row["within_2_sd"]),
            }
        )
    return table


def names_and_pixels(results: Results) -> Table:
    """Return how well summits are named and pixels are placed.

    The summits and the pixels are in made photos.
    """
    table = Table()
    for labels in results.rows("orient_davos", measured="labels"):
        about = {key: labels[key] for key in ("pose", "model")}
        pixels = results.row("orient_davos", measured="pixels", **about)
        table.append(
            {
                "pose": labels["pose"],
                "model": labels["model"],
                "n": f"{labels['photos']}; {pixels['photos']}",
                "visible summits named": f"{percent(labels['within_5_px'])} of {labels['visible']}",
                "hidden ones": f"{labels['hidden_named']} of {count(labels['hidden'])}",
                "pixels rightly sky or ground": percent(pixels["sky_right"]),
                "places off by": f"{digits(pixels['median_off_m'])} m",
                "within two standard errors": percent(pixels["within_2_sd"]),
            }
        )
    return table


def confidence(results: Results) -> Table:
    """Return how far the confidence holds.

    It is tested on Davos, and on each terrain that is left out of learning.
    """
    table = Table()
    for within, words in (("200 m", "200 m"), ("1000 m", "1 km")):
        model = f"refined, {within}"
        row, left_out, strangers = (
            results.row("confidence", model=model, terrain=terrain, kind=kind)
            for terrain, kind in (
                ("davos", "all"), ("each, left out", "all"), ("davos", "strangers"),
            )
        )  # fmt: skip
        sure = row["answered"] * row["n"]
        others = strangers["answered"] * strangers["n"]
        table.append(
            {
                "within": words,
                "n": count(row["n"]),
                "best candidates right": percent(row["right"]),
                "confidence of at least 0.8": f"{count(sure)} ({percent(row['answered'])})",
                "of these right": count(row["precision"] * sure),
                "of another region": f"{count(others)} of {strangers['n']}",
                "calibration error": f"{row['calibration_error']:.3f}",
                "each terrain left out": f"{left_out['calibration_error']:.3f}",
            }
        )
    return table


def masks(results: Results) -> Table:
    """Return how skylines that are found agree with masks drawn by people."""
    table = Table()
    for half, words in {"development": "examined", "held out": "**held out**"}.items():
        row = results.row("sky_masks", half=half)
        table.append(
            {
                "half": words,
                "refused": f"{row['refused']} of {row['photos']}",
                "right, of the trusted": f"{100.0 * row['within']:.1f} %",
                "off by more than 3 %": f"{100.0 * row['far_off']:.1f} %",
                "trusted": f"{100.0 * row['trusted']:.1f} %",
                "mostly wrong": count(row["mostly_wrong"]),
                "s, 1 MP": f"{row['seconds']:.2f}",
            }
        )
    return table


# --- summits --------------------------------------------------------------------------------

DEMS = {
    "davos": "Davos",
    "sierra": "Sierra Albers",
    "rofental": "Rofental",
    "yosemite": "Yosemite",
    "california": "California, 9 tiles",
    "everest": "Everest",
    "columbia": "Columbia",
}


def summits(results: Results) -> Table:
    """Return how well surfaces keep the summits of their files.

    The files are DEMs in degrees.
    """
    table = Table()
    for name, words in DEMS.items():
        rows = results.rows(f"summits_{name}")
        for row in rows if len(rows) > 1 else ():
            own = row["surface"] == "as read"
            off = max(abs(row["lowest_m"]), abs(row["highest_m"]))
            most = f", by up to {off:.0f} m" if row["summits_off"] else ""
            dem = f"{linked(words, f'summits_{name}')}, {row['file_spacing_m']} m"
            table.append(
                {
                    "DEM": dem if own else "",
                    "surface": "**as read**" if own else row["surface"],
                    "spacing": f"{row['spacing_m']:g} m",
                    "n": count(row["summits"]),
                    "summits off": f"{row['summits_off']}{most}",
                    "as seen": f"{digits(row['median_sight_m'])} m",
                    "rms": f"{row['rms_off_m']:.1f} m",
                }
            )
    return table


def on_a_summit(results: Results) -> Table:
    """Return how horizons beside summits agree with horizons on summits."""
    ways = {
        "slope": "on the slope",
        "summit_height": "as high as the summit",
        "within_100_m": "the highest within 100 m",
    }
    table = Table()
    for name, words in DEMS.items():
        row = results.row(f"summits_{name}", surface="as read")
        stood = {
            heading: f"{percent(row[f'{way}_below'])}; {percent(row[f'{way}_off'])}"
            for way, heading in ways.items()
        }
        table.append(
            {
                "DEM": f"{linked(words, f'summits_{name}')}, {row['spacing_m']:g} m",
                "from the summit itself": percent(row["summit_below"]),
                **stood,
                "random": f"{row['anywhere_on_summits']}; {row['anywhere_else_changed']}",
            }
        )
    return table


def opening(results: Results) -> Table:
    """Return the seconds of one answer in a new process."""
    table = Table()
    for name in dict.fromkeys(row["command"] for row in results.rows("opening")):
        seconds = {
            run: results.row("opening", command=name, run=run)["seconds"]
            for run in ("first", "next")
        }
        shown = {run: f"{one:.1f} s" for run, one in seconds.items()}
        table.append({"command": f"`skyline {name}`", **shown})
    return table


TABLES: Mapping[str, Callable[[Results], Table]] = {
    one.__name__.replace("_", "-"): one
    for one in (
        speed, adaptive, how_often, skylines, planning, predictors, places, other_terrain,
        placing_davos, placing_owens, placing_andes, figure_7, same_place, confidence, photographs,
        known_places, made_photos, names_and_pixels, summits, on_a_summit, masks, large_area,
        opening,
    )
}  # fmt: skip
"""Tables by the names that pages have for them."""


def markdown(table: Sequence[Mapping[str, Any]]) -> str:
    """Return a table in Markdown."""
    lines = [" | ".join(table[0]), " | ".join("---" for _ in table[0])]
    lines += [" | ".join(str(value) for value in row.values()) for row in table]
    return "\n".join(f"| {line} |" for line in lines) + "\n"
