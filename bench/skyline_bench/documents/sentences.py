"""The sentences of README and docs/ that have figures from records.

They are listed by page.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from skyline_bench.documents.results import Results, answered_right, count, digits
from skyline_bench.documents.tables import COMPARED, DEMS, FOUR_VIEWS, way_of
from skyline_bench.documents.writing import Sentence
from skyline_bench.measuring import Row
from skyline_bench.queries.manifest import LOCATE
from skyline_bench.search.trials import ALL, CLASSES, THIRDS, against_equal

_NEAR, _BETWEEN, _FAR = CLASSES
_DEFAULT = "planned-100000"
"""The name of a store as it is planned by default."""


def counts(*numbers: float) -> list[str]:
    """Return whole numbers."""
    return [count(number) for number in numbers]


def number_of(row: Row, share: str) -> float:
    """Return how many of a row's queries a share of them is."""
    return float(row[share] * row["n"])


def _plain(results: Results, record: str, group: str = ALL) -> Row:
    return results.row(record, queries="plain", group=group)


def _picture(results: Results) -> list[str]:
    row = results.row("readme_picture")
    return [digits(row["error_m"]), f"{row['confidence']:.2f}"]


def _without_a_hint(results: Results) -> list[str]:
    rows = results.rows("photos_california_tiles", kind=LOCATE)
    found = sum(row.get("rank") == 1 for row in rows)
    answered, right = answered_right(rows)
    return counts(len(rows), found, answered, answered - right)


def _near_slopes(results: Results) -> list[str]:
    row = _plain(results, "matching", _NEAR)
    return counts(row["n"], *(number_of(row, share) for share in ("within_200m", "answered")))


def _warped(results: Results) -> list[str]:
    names = "summits_davos", "summits_yosemite"
    rows = (results.row(name, surface="as read") for name in names)
    return [f"{row['rms_off_m']:.1f}" for row in rows]


def _hard_cases(results: Results) -> list[str]:
    rows = results.rows("stability")
    cases = {row["case"] for row in rows}
    return counts(len(cases - {row["case"] for row in rows if not row["ok"]}), len(cases))


def _strangers(results: Results) -> list[str]:
    rows = [*results.rows("strangers"), *results.rows("strangers1")]
    answered = [
        sum(number_of(row, "answered") for row in rows if row["group"] == group)
        for group in (ALL, _NEAR, _BETWEEN, _FAR)
    ]
    queries = sum(row["n"] for row in rows if row["group"] == ALL)
    surest = max(row["highest_confidence"] for row in rows)
    return [*counts(queries, *answered), f"{surest:.2f}"]


def _projections(results: Results) -> list[str]:
    fisheyes, unmarked, panoramas = (
        results.row("fisheyes", queries=kind, group=ALL)
        for kind in ("fisheyes", "unmarked fisheyes", "unmarked panoramas")
    )
    answered = [number_of(row, "answered") for row in (unmarked, panoramas)]
    wrong = answered[1] - round(answered[1] * panoramas["precision"])
    return counts(
        fisheyes["n"], number_of(fisheyes, "within_200m"), unmarked["n"], answered[0],
        panoramas["n"], answered[1], wrong,
    )  # fmt: skip


def _elsewhere(results: Results) -> list[str]:
    rows = results.rows("photos_elsewhere")
    return counts(len(rows), answered_right(rows)[0])


def _gains(results: Results) -> list[str]:
    """Return the ratios of errors, plan over grid, and the numbers of plans that gain."""
    records = [record for _, planner, record in COMPARED if planner != "ours"]
    ratios = {
        group: {
            (held["store"], record): held["error_ratio"]
            for record in records
            for held in against_equal(
                [{**row, "group": ALL} for row in results.rows(record, group=group)]
            )
        }
        for group in (ALL, THIRDS[-1], THIRDS[0])
    }
    plans = "lpov-36px", "lpov-120px"
    over = [ratios[ALL][plan, record] for plan in plans for record in records]
    figures = [f"{error:.2f}" for error in over]
    for group in (THIRDS[-1], THIRDS[0]):
        figures += counts(sum(one < 1.0 for one in ratios[group].values()), len(ratios[group]))
    return figures


def _learned(results: Results) -> list[str]:
    terrains = "sierra", "rofental", "everest"
    about = {"model": "refined, 200 m", "kind": "all"}
    return counts(sum(results.row("confidence", terrain=one, **about)["n"] for one in terrains))


def _webcam(results: Results) -> list[str]:
    row = results.row("orient_davos", measured="webcam")
    steady = row["within_0.1_deg"] * row["answered"]
    figures = counts(row["frames"] + row["fog"], row["answered"], row["frames"], steady)
    return [*figures, f"{row['greatest_deg']:.2f}", *counts(row["fog_answered"], row["fog"])]


def _heights_kept(results: Results) -> list[str]:
    rows = [results.row(f"summits_{name}", surface="as read") for name in DEMS]
    off_m = max(abs(row[end]) for row in rows for end in ("lowest_m", "highest_m"))
    bias_m = max(abs(row["bias_m"]) for row in rows)
    tenths_mm = max(1.0, np.ceil(1e4 * off_m))
    return [f"{tenths_mm / 10.0:.1f}", f"{bias_m:.3f}"]


def _damaged_files(results: Results) -> list[str]:
    rows = results.rows("input_fuzz")
    ended = sum(row["answered"] + row["refused"] for row in rows)
    return counts(ended, sum(row["cases"] for row in rows))


def _durability(results: Results) -> list[str]:
    kills, flips, mutated = (
        results.rows("store_durability", test=test) for test in ("kills", "flips", "mutated")
    )
    killed = (sum(row[key] for row in kills) for key in ("lost", "kills", "equal", "builds"))
    flipped = (sum(row[key] for row in flips) for key in ("found", "harmful"))
    ended = sum(row["read"] + row["refused"] for row in mutated)
    return counts(*killed, *flipped, ended, sum(row["cases"] for row in mutated))


def _store_size(row: Row) -> list[str]:
    """Return the km2, the places and the GB of a large store."""
    return [*counts(row["km2"], row["places"]), f"{row['bytes'] / 1e9:.2f}"]


def _large_store(results: Results) -> list[str]:
    row = _plain(results, "matching_california")
    return [*_store_size(row), *counts(np.sqrt(1e6 * row["km2"] / row["places"]))]


def _tiles_found(results: Results) -> list[str]:
    row = _plain(results, "matching_tiles")
    shares = "within_200m", "within_1km", "answered"
    return counts(row["n"], *(number_of(row, share) for share in shares))


def _tiles_seconds(results: Results) -> list[str]:
    seconds = [row["seconds"] for row in results.rows("photos_california_tiles")]
    return counts(min(seconds), max(seconds), np.median(seconds))


def _held_places(results: Results) -> list[str]:
    rows = results.rows("probability", group=ALL)
    photos = sum(row["posteriors"] for row in rows)
    held = [sum(row[f"in_{share}"] * row["posteriors"] for row in rows) for share in (50, 80, 95)]
    return [f"{100.0 * one / photos:.0f}" for one in held] + counts(photos)


def _default_stores(results: Results) -> list[str]:
    """Return the cost of stores that are planned by default.

    These are the least and the greatest processor time, and the greatest size in MB.
    """
    placed = [
        results.row(f"placing_{one}", store=_DEFAULT, group=ALL) for one in ("davos", "owens")
    ]
    rows = [*placed, *(_plain(results, f"matching_{one}") for one in ("rofental", "owens"))]
    times = [row["build_cpu_s"] for row in rows]
    return counts(min(times), max(times), max(row["bytes"] for row in rows) / 1e6)


def _rendering_bytes(results: Results) -> list[str]:
    row = results.row("paper_figure7_davos", store="uniform-128", group=ALL)
    return counts(row["bytes"] / row["renderings"])


SENTENCES: Mapping[str, Sequence[Sentence]] = {
    "docs/howto/searching.md": (
        Sentence(
            "The areas of 50, 80 and 95 % hold the true places of {}, {} and {} % of {} synthetic "
            "photos of Davos",
            _held_places,
        ),
    ),
    "README.md": (
        Sentence("The place found is {} m off; its confidence is {}.", _picture),
        Sentence(
            "A query on Davos takes {} s in the median",
            lambda results: [f"{_plain(results, 'matching')['query_s']:.1f}"],
        ),
        Sentence(
            "Of {} real photographs, searched in 455,000 km2 without a hint of the place, {} "
            "are placed within 200 m; {} are answered, {} of these wrongly",
            _without_a_hint,
        ),
        Sentence(
            "Of {} such queries on Davos, {} are placed within 200 m, and {} are answered",
            _near_slopes,
        ),
        Sentence(
            "The greatest error measured is {} px",
            lambda results: [digits(way_of(results, FOUR_VIEWS)["max_px"])],
        ),
    ),
    "docs/accuracy.md": (
        Sentence(
            "horizon rasterizer | at most {} px, rms {} px (float32)",
            lambda results: [
                digits(way_of(results, FOUR_VIEWS)[key]) for key in ("max_px", "rms_px")
            ],
        ),
        Sentence(
            "depth images, W = 640 | at most {} px, rms {} px",
            lambda results: [
                digits(way_of(results, ("depth", "W = 640"))[key]) for key in ("max_px", "rms_px")
            ],
        ),
        Sentence("none at summits; {} m rms at 1 arc-second, {} m at 3", _warped),
        Sentence(
            "{} % of the trusted columns of real photographs within 1 %",
            lambda results: [f"{100.0 * results.row('sky_masks', half='held out')['within']:.0f}"],
        ),
        Sentence("{} hard cases (", lambda results: _hard_cases(results)[1:]),
        Sentence(
            "{} places as planned by default, {} MB",
            lambda results: counts(
                _plain(results, "matching")["places"], _plain(results, "matching")["bytes"] / 1e6
            ),
        ),
        Sentence(
            "{} queries of the Sierra Nevada were searched in the store of Davos, and {} got an "
            "answer: {} with a skyline under 150 m away, {} from 150 to 400 m, and {} over 400 m. "
            "The surest has a confidence of {}",
            _strangers,
        ),
        Sentence(
            "Of {} fisheyes of a named projection {} are placed within 200 m. Of {} fisheyes whose "
            "projection nothing names {} gets an answer, and of {} such panoramas {}, {} of them "
            "wrong",
            _projections,
        ),
        Sentence(
            "Of {} real photographs of other mountains, with unknown fields of view, {} got an "
            "answer",
            _elsewhere,
        ),
        Sentence(
            "The plan for 36 px has {} times the error of the uniform grid on Davos, and {} times "
            "on Owens Valley; the plan for 120 px has {} and {} times. Where the skyline is far, "
            "{} of {} plans gain; where it is close, {} of {}",
            _gains,
        ),
        Sentence("have learned from {} examples", _learned),
        Sentence(
            "{} of {} photos of the Sierra Nevada is answered",
            lambda results: counts(
                *(
                    results.row("orient_davos", measured="strangers")[key]
                    for key in ("answered", "n")
                )
            ),
        ),
        Sentence(
            "{} frames of a fixed camera were drawn in changing weather and season. {} of the {} "
            "clear ones are answered; the headings of {} lie within 0.1 degrees of their median, "
            "and all within {}. {} of the {} in fog are answered",
            _webcam,
        ),
        Sentence("keeps the height of every summit to {} mm", lambda r: _heights_kept(r)[:1]),
        Sentence("the surface is at most {} m too high or too low", lambda r: _heights_kept(r)[1:]),
        Sentence(
            "{} of {} damaged input files (DEMs, lists of viewpoints, traces, images) gave an "
            "answer or one line of error",
            _damaged_files,
        ),
        Sentence("{} of the {} hard cases stay within their bounds", _hard_cases),
        Sentence(
            "{} finished parts were lost in {} kills of builds, and {} of {} stores have the bytes "
            "of an unbroken build; {} of {} flipped bits that did harm were found, and {} of {} "
            "damaged stores were read or refused in one line",
            _durability,
        ),
        Sentence(
            "of California (3 arc-seconds, {} km2), as `build` does by default. It has {} planned "
            "places and {} GB; the places lie {} m apart in the mean",
            _large_store,
        ),
        Sentence(
            "of processor time for each; this one takes {} s",
            lambda results: counts(_plain(results, "matching_california")["query_cpu_s"]),
        ),
        Sentence(
            "40 tiles of California and Nevada, {} km2 with a part of sea, has {} planned places "
            "and {} GB",
            lambda results: _store_size(_plain(results, "matching_tiles")),
        ),
        Sentence("each in {} to {} s beside another process, in {} s in", _tiles_seconds),
        Sentence(
            "Of {} plain queries {} were found within 200 m and {} within 1 km; {} were answered",
            _tiles_found,
        ),
        Sentence(
            "is rendered in {} GB of memory",
            lambda results: [f"{results.row('large_dem')['peak_resident_bytes'] / 1e9:.1f}"],
        ),
    ),
    "docs/guide/your-own-area.md": (
        Sentence("{} to {} s of processor time, and up to {} MB", _default_stores),
    ),
    "docs/store.md": (Sentence("A rendering of 640 columns takes {} bytes", _rendering_bytes),),
}
