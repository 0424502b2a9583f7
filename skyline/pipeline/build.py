"""Building stores: of places, planned or on a grid, each with its skyline all round.

A store of renderings, for the paper's matcher, is built on a grid too, or as `planned.py` says.
"""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyline.camera import HEADINGS
from skyline.errors import InputError
from skyline.pipeline.config import (
    BuildConfig,
    PlaceConfig,
    RenderConfig,
)
from skyline.pipeline.jobs import Progress
from skyline.pipeline.layout import DEFAULT_LOSS, Layout
from skyline.pipeline.row_renderers import RowRenderer, Work, rows_of, view_rows
from skyline.planning.adaptive import Blocks
from skyline.planning.uniform import map_bounds
from skyline.store import (
    Built,
    StoreHeader,
    StoreWriter,
    create_store,
    open_for_append,
    open_store,
)
from skyline.store.header import PLACES
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints


@dataclass(frozen=True, slots=True)
class BuildResult:
    """What a build did.

    Attributes
    ----------
    rows : int
        Renderings or places in the store.
    rendered : int
        Of these, the ones added now; the others were there already.
    """

    rows: int
    rendered: int
    seconds: float


def build_places(
    terrain: HeightField,
    path: str | Path,
    spacing_m: float | None = None,
    bounds_deg: tuple[float, float, float, float] | None = None,
    config: PlaceConfig | None = None,
    progress: Progress | None = None,
    *,
    loss: float = DEFAULT_LOSS,
) -> BuildResult:
    """Render places into a store; an interrupted build goes on.

    Parameters
    ----------
    path : str or Path
        The store.
    spacing_m : float, optional
        Metres between the places of a uniform grid. By default places lie densely where skylines
        are near, and sparsely where they are far; see `skyline.planning.adaptive`.
    bounds_deg : tuple, optional
        W, S, E, N in degrees; by default all of the terrain.
    progress : callable, optional
        Called with how much of the area is done, and with how much there is.
    loss : float
        Without a spacing: the share of the views, 60 degrees wide, that may be lost because
        places lie apart. The smaller the share, the more places.

    Raises
    ------
    InputError
        A spacing that suits no grid on the terrain, a loss that no places come down to, or an
        area so small that no place falls in it.
    StoreMismatchError
        The store at ``path`` holds renderings, or was built from another DEM or with another
        configuration.
    """
    layout = Layout(spacing_m, bounds_deg=bounds_deg, loss=loss)
    return build_store(terrain, path, layout, config or PlaceConfig(), progress)


def build_uniform(
    terrain: HeightField,
    path: str | Path,
    spacing_m: float,
    bounds_deg: tuple[float, float, float, float] | None = None,
    config: RenderConfig | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Render a uniform grid into a store; an interrupted build goes on where it stopped.

    Raises
    ------
    StoreMismatchError
        The store at ``path`` was built from another DEM or with another configuration.
    """
    layout = Layout(spacing_m, bounds_deg=bounds_deg)
    return build_store(terrain, path, layout, config or RenderConfig(), progress)


def render_to_store(
    terrain: HeightField,
    viewpoints: Viewpoints,
    path: str | Path,
    config: RenderConfig | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Render given viewpoints into a new store; where that fails or is stopped, there is none.

    Raises
    ------
    StoreError
        Something is at ``path`` already.
    """
    config = config or RenderConfig()
    total = len(viewpoints)
    with view_rows(terrain, config, {"planner": "viewpoints"}) as rows:
        writer = create_store(path, rows.header, Built(0, total))
        try:
            with writer:
                return _render_into(writer, rows, viewpoints, viewpoints, total, progress)
        except BaseException:
            Path(path).unlink(missing_ok=True)
            raise


def build_store(
    terrain: HeightField,
    path: str | Path,
    layout: Layout,
    config: BuildConfig,
    progress: Progress | None = None,
) -> BuildResult:
    """Render what a store lacks of a layout, in this process; raises as `build_places`."""
    area = map_bounds(terrain, layout.bounds_deg)
    work = layout.work(terrain, area, config.eye_height_m)
    with rows_of(terrain, area, config, layout) as rows:
        built = render_missing(path, rows, work, progress)
    return refuse_empty(built, path, layout)


def refuse_empty(built: BuildResult, path: str | Path, layout: Layout) -> BuildResult:
    """Return what a build came to; a store without rows is removed, and `InputError` raised."""
    if built.rows:
        return built
    Path(path).unlink()
    area = "all of the DEM"
    if layout.bounds_deg is not None:
        area = ",".join(f"{side:g}" for side in layout.bounds_deg)
    raise InputError(
        f"the area is {area}, and no place planned for a loss of {layout.loss:g} falls on the "
        "surface in it; choose a larger area, a smaller loss, or the spacing of a uniform grid"
    )


def render_missing(
    path: str | Path,
    rows: RowRenderer[Work],
    work: Work,
    progress: Progress | None = None,
    total: int | None = None,
) -> BuildResult:
    """Render what a store lacks of some work; the store is made where there is none.

    ``total`` is how much work the whole build is, where ``work`` is one tile's.

    Raises `StoreMismatchError` where the store at ``path`` was built from another DEM or with
    another configuration.
    """
    total = total or len(work)
    if not Path(path).exists():
        with create_store(path, rows.header, Built(0, total)) as writer:
            return _render_into(writer, rows, work, work, total, progress)
    with open_for_append(path, rows.header) as writer:
        left = missing(path, work)
        # A repaired store may lack places of any block, and does not know of which.
        is_known = writer.built.total > 0 or not isinstance(work, Blocks)
        return _render_into(writer, rows, work, left, total if is_known else 0, progress)


def _render_into(
    writer: StoreWriter,
    rows: RowRenderer[Work],
    work: Work,
    left: Work,
    total: int,
    progress: Progress | None,
) -> BuildResult:
    """Render what is left of some work into a store, a few at a time.

    The store notes how much of ``total`` is done; it does not where that is 0.
    """
    started = time.perf_counter()
    held = len(writer)
    done = len(work) - len(left)
    while True:
        if total:
            writer.note_built(Built(done, total))
        if progress:
            progress(done, len(work))
        if done == len(work):
            break
        part = left[done - len(work) :][: rows.at_a_time]
        rows.render_into(writer, part)
        done += len(part)
    writer.flush()
    return BuildResult(len(writer), len(writer) - held, time.perf_counter() - started)


def missing(path: str | Path, work: Work) -> Work:
    """Return the work of which a store lacks rows."""
    with open_store(path) as store:
        there, wanted, done = store.eyes(), rows_each(store.header), store.built.done
    if isinstance(work, Blocks):
        # A block is stored whole, after those before it; some have no places to store.
        held = np.flatnonzero(work.holding(there.easting_m, there.northing_m))
        return work[max(done, held.max(initial=-1) + 1) :]
    stored, count = np.unique(there.easting_m + 1j * there.northing_m, return_counts=True)
    whole = stored[count >= wanted]
    return work[~np.isin(work.easting_m + 1j * work.northing_m, whole)]


def rows_each(header: StoreHeader) -> int:
    """Return how many rows a viewpoint has in a store: a place, or a rendering a heading."""
    return 1 if header.holds == PLACES else len(HEADINGS)
