"""Building stores of places, and what all builds say to a person."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from skyline.geodesy.bounds import Bounds
from skyline.progress import Progress
from skyline.store.read import open_store, parts_folder
from skyline.store.write import check_store_path
from skyline.survey.build import BuildResult, build_store, finished_store
from skyline.survey.cluster import runner_of
from skyline.survey.expected_losses import expected_finds
from skyline.survey.plans import PlacePlan, Plan
from skyline.tasks.listener import Listener
from skyline.tasks.terrain import curvature_of, read_terrain
from skyline.terrain.heightfield import HeightField


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildTask:
    """A store of places to build."""

    dem: Sequence[str]
    """Elevation files, or folders of them."""
    crs: str | None = None
    """CRS of elevation files that name none."""
    output: Path
    """The store."""
    spacing_m: float | None = None
    """Distance between the places of a uniform grid."""
    places: int | None = None
    """About this many planned places; neither this nor a spacing means the default number."""
    bounds_deg: Bounds | None = None
    """By default all of the DEM."""
    workers: str | None = None
    """As for `runner_of`."""
    refraction_k: float | None = None
    """By default the usual value of the terrain's world."""


def build_area(
    task: BuildTask, listener: Listener
) -> tuple[BuildResult, Sequence[tuple[float, float, float]]]:
    """Build the store of an area.

    Returns also which photos it is expected to find, as `expected_finds`. After a stop, the same
    call continues. Raises as `PlacePlan` and `build_store`.
    """
    advise_to_continue(task.output, listener)
    terrain = read_terrain(listener, task.dem, task.crs)
    curvature = curvature_of(terrain, task.refraction_k)
    plan = PlacePlan(task.spacing_m, task.bounds_deg, task.places, curvature)
    note_added_area(task.output, plan, terrain, listener)
    with runner_of(task.workers) as runner, build_bar(task.output, "places", listener) as bar:
        result = build_store(terrain, task.output, plan, runner, bar)
    with open_store(task.output) as opened:
        return result, expected_finds(opened.places())


def advise_to_continue(store: Path, listener: Listener) -> None:
    """Check a store's path, and set the advice for Ctrl-C.

    After Ctrl-C, a build that has parts says that the same command continues.
    """
    check_store_path(store.resolve())
    listener.keeps(
        "what was built is kept, and the same command continues from there",
        lambda: any(parts_folder(store.resolve()).glob("*/*.h5")),
    )


def note_added_area(store: Path, plan: Plan, terrain: HeightField, listener: Listener) -> None:
    """Say which area a build adds to a store of another area.

    Raises `StoreMismatchError` for a store of other settings.
    """
    header = plan.header(terrain)
    if not store.exists() or finished_store(store, header) is not None:
        return
    with open_store(store) as opened:
        held = _area_in_words(opened.header.boxes_deg)
    listener.note(
        f"{store} covers {held}; {_area_in_words(header.boxes_deg)} is added to it (for a store of "
        "that area alone, name another file)"
    )


def _area_in_words(boxes_deg: Sequence[Bounds] | None) -> str:
    if boxes_deg is None:
        return "all of the DEM"
    return " and ".join(",".join(f"{side:g}" for side in box) for box in boxes_deg)


@contextmanager
def build_bar(output: Path, rows: str, listener: Listener) -> Iterator[Progress]:
    """Show a build's progress, after a note on an earlier build."""
    with listener.progress("rendering") as bar:
        is_first = True

        def show(done: int, total: int) -> None:
            nonlocal is_first
            if is_first and done:
                listener.note(f"{output}: {done} of about {total} {rows} are there already")
            is_first = False
            bar(done, total)

        yield show
