"""Photos of one place matched together: how often one finds it, and how often all of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from skyline.build.cluster import Progress
from skyline.build.grid import map_bounds
from skyline.build.plans import PlacePlan
from skyline.errors import InputError
from skyline.geodesy import Bounds
from skyline.matching.confidence import RIGHT_WITHIN_M
from skyline.pipeline.match import Matcher
from skyline.pipeline.matchers import FULL
from skyline.pipeline.results import JointResult
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import unseen
from skyline_bench.queries.synthetic import SyntheticQuery, make_queries_together
from skyline_bench.runs.matching import middle_deg
from skyline_bench.stores.reference import laid_out_store
from skyline_bench.trials.trials import Trial, accuracy, errors, open_matcher, run_trials

Photos = tuple[SyntheticQuery, ...]


@dataclass(frozen=True, slots=True)
class SamePlaceConfig:
    """What is measured."""

    # West, south, east, north; by default 5 x 10 km in the DEM's middle.
    bounds_deg: Bounds | None = None
    spacing_m: float = 80.0  # Of the store of places
    places: int = 30  # Where photos are taken
    photos: int = 3  # Of each place, looking anywhere
    seed: int = 0

    def __post_init__(self) -> None:
        if self.places < 2 or self.photos < 3:
            raise InputError(
                f"{self.photos} photos of each of {self.places} places; expected 3 or more of 2 or "
                "more: one of them is exchanged for another place's"
            )

    def quick(self) -> "SamePlaceConfig":
        """Return a version of two minutes: three places."""
        return replace(self, places=min(self.places, 3))


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """What was found of the photos of one place."""

    alone: tuple[Trial, ...]  # Of each photo
    together: JointResult  # Of all
    mixed: JointResult  # Of all but the last, and one of another place
    # Of the two joint places; infinite where there is none.
    error_m: float
    mixed_error_m: float

    @property
    def found_alone(self) -> float:
        """The share of the photos that are found alone."""
        return float(np.mean([trial.right for trial in self.alone]))

    @property
    def distance_m(self) -> float:
        """Mean of the median distances of the photos' skylines."""
        return float(np.nanmean([trial.distance_m for trial in self.alone]))


def measure(
    terrain: HeightField, config: SamePlaceConfig, folder: Path, progress: Progress = unseen
) -> list[Row]:
    """Match photos of one place alone, together, and with one of another place among them.

    Return a row for all places and one for each third that is hardest: where the fewest photos are
    found alone, and where skylines are nearest, which does not ask what was found. A place is found
    within 200 m. ``radius_holds`` is the share of the places found whose error is within the radius
    that 68 % should be within, ``own_named_wrong`` that of the places where a photo is said not to
    agree, ``stranger_named`` that where the photo of another place is.
    """
    bounds_deg = config.bounds_deg or middle_deg(terrain)
    store = laid_out_store(terrain, folder, PlacePlan(config.spacing_m, bounds_deg))
    area = map_bounds(terrain, bounds_deg)
    made = make_queries_together(terrain, area, config.places, config.photos, config.seed)
    measured = []
    with open_matcher(FULL, store.path, terrain) as matcher:
        for index, photos in enumerate(made):
            progress(index, len(made))
            measured.append(_measured(matcher, photos, made[(index + 1) % len(made)][-1]))
    return [{"group": name, **_row(some)} for name, some in _groups(measured).items()]


def _measured(matcher: Matcher, photos: Photos, stranger: SyntheticQuery) -> _Measured:
    together, mixed = (
        matcher.match_together([one.skyline for one in some])
        for some in (photos, (*photos[:-1], stranger))
    )
    error_m, mixed_error_m = (
        errors(found.places[0], photos[0].truth)[0] if found.places else np.inf
        for found in (together, mixed)
    )
    alone = tuple(run_trials(matcher, photos, np.inf, 1))
    return _Measured(alone, together, mixed, error_m, mixed_error_m)


def _groups(measured: Sequence[_Measured]) -> Mapping[str, Sequence[_Measured]]:
    third = max(1, len(measured) // 3)
    by_found = sorted(measured, key=lambda one: (one.found_alone, one.distance_m))
    by_distance = sorted(measured, key=lambda one: one.distance_m)
    return {
        "all": measured,
        "third found least alone": by_found[:third],
        "third of nearest skylines": by_distance[:third],
    }


def _row(measured: Sequence[_Measured]) -> Row:
    alone = [trial for one in measured for trial in one.alone]
    alone_m, error_m = [trial.error_m for trial in alone], [one.error_m for one in measured]
    mixed_m = [one.mixed_error_m for one in measured]
    one_by_one = accuracy(alone_m, [trial.answered_within_m for trial in alone])
    together = accuracy(error_m, [one.together.within_m for one in measured])
    mixed = accuracy(mixed_m, [one.mixed.within_m for one in measured])
    best = [next(iter(one.together.places), None) for one in measured]
    names = ("within_200m", "median_m", "answered", "precision")
    return {
        "places": len(measured),
        "photos": len(alone) // len(measured),
        **{f"alone_{name}": one_by_one[name] for name in names},
        "alone_radius_holds": _radius_holds(alone_m, [trial.radius_m for trial in alone]),
        "alone_seconds": float(np.median([trial.seconds for trial in alone])),
        **{name: together[name] for name in names},
        "radius_holds": _radius_holds(
            error_m, [place.radius_m if place else None for place in best]
        ),
        "own_named_wrong": float(np.mean([not all(one.together.agrees) for one in measured])),
        "seconds": float(np.median([one.together.seconds for one in measured])),
        **{f"mixed_{name}": mixed[name] for name in names},
        "stranger_named": float(np.mean([not one.mixed.agrees[-1] for one in measured])),
    }


def _radius_holds(error_m: Sequence[float], radius_m: Sequence[float | None]) -> float | None:
    """Return the share of right places whose error is within their radius."""
    off_m, told_m = np.array(error_m), np.array(radius_m, dtype=np.float64)
    right = ~np.isnan(told_m) & (off_m <= RIGHT_WITHIN_M)
    return float((off_m <= told_m)[right].mean()) if right.any() else None
