"""The stores of a comparison, built once or given as files."""

import json
import logging
import math
from dataclasses import asdict, dataclass
from functools import partial, reduce
from pathlib import Path
from typing import Any

from skyline import build_places, build_uniform
from skyline.errors import InputError
from skyline.geodesy.bounds import Bounds, box_around
from skyline.paper.build import build_planned
from skyline.paper.plan import PlanConfig
from skyline.progress import Progress
from skyline.skylines import HEADINGS
from skyline.store.layout import PLACES, RENDERINGS
from skyline.store.places import Places
from skyline.store.read import open_store, parts_folder
from skyline.survey.expected_losses import expected_finds
from skyline.survey.plans import map_bounds, uniform_grid
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring import Row, middle_of, square_km, timed

_log = logging.getLogger(__name__)

UNIFORM = "uniform"
"""The planner of uniform grids; the paper's planners are named by their strategy."""
PLANNED = "planned"
"""The planner of places."""

_AS_MANY = math.log(1.1)
"""Places count as equally many if the logarithms of their numbers differ by less."""

_NOTE = ".build.json"
"""The suffix of the file beside a store that notes its settings and its times."""


@dataclass(frozen=True, slots=True)
class StoreSpec:
    """A store to search.

    It is uniform, planned, planned as in the paper, or a file.
    """

    holds: str = PLACES  # Places or renderings
    spacing_m: float | None = None  # Spacing of a uniform grid; places are planned without it
    places: int | None = None  # About so many planned places; by default as many as a build plans
    plan: PlanConfig | None = None  # A plan of the paper's, which is of renderings
    path: Path | None = None  # A store that exists already

    @property
    def planner(self) -> str:
        """The planner of the viewpoints of a store that is built."""
        if self.plan is not None:
            return self.plan.strategy
        return PLANNED if self.spacing_m is None else UNIFORM

    @property
    def held(self) -> str:
        """The kind of rows that the store holds; a file is opened."""
        return self.holds if self.path is None else BuiltStore.read(self, self.path).holds

    @property
    def name(self) -> str:
        """The name of the store's file, without its ending."""
        if self.path is not None:
            return self.path.stem
        if self.plan is not None:
            return f"{self.plan.strategy}-{self.plan.threshold_px:g}px"
        if self.spacing_m is None:
            return "planned" if self.places is None else f"planned-{self.places}"
        return f"{'places' if self.holds == PLACES else 'uniform'}-{self.spacing_m:g}"

    def check(self, terrain: HeightField, bounds_deg: Bounds | None) -> None:
        """Check that the store can be built in an area, or opened.

        Raises `InputError` where it cannot.
        """
        area = map_bounds(terrain, bounds_deg)
        if self.path is not None:
            BuiltStore.read(self, self.path)
        elif self.spacing_m is not None:
            uniform_grid(terrain, self.spacing_m, area)
            width = area[2] - area[0]
            height = area[3] - area[1]
            if min(width, height) < self.spacing_m:
                raise InputError(
                    f"the area is {width:.0f} x {height:.0f} m, too small for a grid of "
                    f"{self.spacing_m:g} m; choose larger bounds or a smaller spacing"
                )

    def build(
        self,
        terrain: HeightField,
        folder: Path,
        bounds_deg: Bounds | None,
        progress: Progress | None = None,
    ) -> "BuiltStore":
        """Return the store in a folder, built unless it is there."""
        if self.path is not None:
            return BuiltStore.read(self, self.path)
        path = folder / f"{self.name}.h5"
        settings = json.loads(json.dumps([terrain.digest, bounds_deg, asdict(self)], default=str))
        noted = _noted(path).get("settings")
        if path.exists() and noted not in (None, settings):
            raise InputError(f"{path} has other bounds or another DEM; name another --folder")
        if not path.exists() or noted is None:
            resumed = path.exists() or parts_folder(path).exists()
            _, timing = timed(partial(self._build, terrain, path, bounds_deg, progress))
            times = {"build_s": timing.seconds, "build_cpu_s": timing.cpu_seconds}
            note = {} if resumed else times
            text = json.dumps({**note, "settings": settings}) + "\n"
            path.with_suffix(_NOTE).write_text(text, encoding="utf-8")
        return BuiltStore.read(self, path)

    def _build(
        self,
        terrain: HeightField,
        path: Path,
        bounds_deg: Bounds | None,
        progress: Progress | None,
    ) -> None:
        if self.plan is not None:
            build_planned(terrain, path, self.plan, bounds_deg)
        elif self.holds == RENDERINGS and self.spacing_m is not None:
            build_uniform(terrain, path, self.spacing_m, bounds_deg, progress=progress)
        else:
            build_places(terrain, path, self.spacing_m, bounds_deg, progress, places=self.places)


@dataclass(frozen=True, slots=True)
class BuiltStore:
    """A store and its cost."""

    spec: StoreSpec
    path: Path
    holds: str  # Renderings or places
    bounds_deg: Bounds | None  # Around the boxes it was built for; None for all of the DEM
    digest: str
    figures: Row  # The columns of rows that describe the store

    @classmethod
    def read(cls, spec: StoreSpec, path: Path) -> "BuiltStore":
        """Return a store that exists.

        Times are NaN where a build was interrupted or not noted.
        """
        note = _noted(path)
        with open_store(path) as store:
            rows = len(store)
            holds = store.header.holds
            boxes_deg = store.header.boxes_deg
            planner = spec.planner if spec.path is None else store.header.config["planner"]
            digest = store.digest
        # A place counts as four renderings, since it looks all the way round.
        renderings = len(HEADINGS) * rows if holds == PLACES else rows
        figures = {
            "store": spec.name,
            "planner": planner,
            "renderings": renderings,
            "places": renderings / len(HEADINGS),
            "bytes": path.stat().st_size,
            "build_s": note.get("build_s", math.nan),
            "build_cpu_s": note.get("build_cpu_s", math.nan),
        }
        bounds_deg = None if boxes_deg is None else reduce(box_around, boxes_deg)
        return cls(spec, path, holds, bounds_deg, digest, figures)

    @property
    def places(self) -> float:
        """How many places it has; four renderings count as one."""
        return float(self.figures["places"])

    @property
    def is_plan(self) -> bool:
        """Whether this run built the store from a plan."""
        return self.spec.path is None and self.spec.planner != UNIFORM

    def is_held_to(self, other: "BuiltStore") -> bool:
        """Return whether another store is a uniform grid of as many places."""
        is_grid = other.figures["planner"] == UNIFORM and other.holds == self.holds
        return is_grid and are_as_many(self.places, other.places)

    def claimed_loss(self) -> float:
        """Return the share of views expected to be lost; NaN for renderings."""
        if self.holds != PLACES:
            return math.nan
        with open_store(self.path) as store:
            places = Places.concatenate(list(store.places().blocks()))
        return 1.0 - sum(share * found for _, share, found in expected_finds(places))


def are_as_many(places: float, others: float) -> bool:
    """Return whether two numbers of places differ by a tenth at most."""
    return abs(math.log(places / others)) < _AS_MANY


def equal_grid(plan: BuiltStore, terrain: HeightField, bounds_deg: Bounds | None) -> StoreSpec:
    """Return the uniform grid with as many places as a planned store."""
    area_m = map_bounds(terrain, bounds_deg)
    spacing_m = 1e3 * math.sqrt(square_km(area_m) / plan.places)
    # Voids have no places, and the edges of a small area may have a row too many.
    found = len(uniform_grid(terrain, spacing_m, area_m))
    return StoreSpec(plan.holds, round(spacing_m * math.sqrt(found / plan.places), 1))


def middle_deg(terrain: HeightField, size_m: tuple[float, float] = (5_000.0, 10_000.0)) -> Bounds:
    """Return the middle part of a DEM, up to a size: across, along."""
    west, south, east, north = terrain.bounds_m
    left, low, right, high = middle_of(terrain.bounds_m, size_m)
    easting, northing = (west + east) / 2.0, (south + north) / 2.0
    lon, _ = terrain.frame.to_lonlat([left, right], [northing, northing])
    _, lat = terrain.frame.to_lonlat([easting, easting], [low, high])
    return float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1])


def _noted(path: Path) -> dict[str, Any]:
    """Return the note beside a store; empty if there is none."""
    note = path.with_suffix(_NOTE)
    return dict(json.loads(note.read_text(encoding="utf-8"))) if note.exists() else {}
