"""Building stores of renderings at given, gridded or planned viewpoints."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from skyline.errors import InputError, suffix_of
from skyline.files.folders import check_folder, lies_in_any
from skyline.geodesy.bounds import Bounds
from skyline.paper.build import build_planned
from skyline.paper.plan import CoveragePlan, PlanConfig
from skyline.paper.plan_check import Verification
from skyline.render.horizon import RenderConfig
from skyline.store.write import check_store_path
from skyline.survey.build import BuildResult, build_store
from skyline.survey.cluster import runner_of
from skyline.survey.plans import RenderingPlan
from skyline.tasks.build import advise_to_continue, build_bar, note_added_area
from skyline.tasks.listener import Listener
from skyline.tasks.terrain import curvature_of, read_terrain
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import read_viewpoints


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderTask:
    """A store of renderings to build.

    Its viewpoints are given, on a grid, or planned.
    """

    dem: tuple[str, ...]
    """Elevation files, or folders of them."""
    crs: str | None = None
    """CRS of elevation files that name none."""
    output: Path
    """The store."""
    viewpoints: Path | None = None
    """CSV of viewpoints."""
    spacing_m: float | None = None
    """Distance between the viewpoints of a uniform grid."""
    planner: str | None = None
    """Name of a planner in `skyline.paper.planners.PLANNERS`."""
    coarse_m: float | None = None
    """Distance between the viewpoints that a planner renders first."""
    site_m: float | None = None
    """Distance between the sites from which a planner chooses."""
    threshold_px: float | None = None
    """Greatest error of a skyline at a site that is covered."""
    coverage: float | None = None
    """Share of the sites to cover."""
    map: Path | None = None
    """PNG with the viewpoints that a planner has chosen."""
    bounds_deg: Bounds | None = None
    """By default all of the DEM."""
    depth_images: Path | None = None
    """Folder for depth images and pictures of them."""
    workers: str | None = None
    """As for `runner_of`."""
    width: int = RenderConfig().width
    """Columns of a view."""
    refraction_k: float | None = None
    """By default the usual value of the terrain's world."""

    def check(self) -> None:
        """Check the options and the outputs.

        Raises `InputError` for options that contradict each other, and for wrong outputs.
        """
        if [self.viewpoints, self.spacing_m, self.planner].count(None) != 2:
            raise InputError("give one of --viewpoints FILE.csv, --spacing M and --planner NAME")
        check_store_path(self.output.resolve())
        if self.map is not None:
            suffix_of(self.map, [".png"])
        if self.depth_images is not None:
            check_folder(self.depth_images)
        if self.planner is not None:
            others = {"--workers": self.workers, "--depth-images": self.depth_images}
            _refuse(others, "leave it out: a planner plans one area as a whole, in this process")
        else:
            _refuse(self._of_planner, "give --planner too")
        if self.depth_images is not None and lies_in_any(self.depth_images, self.dem):
            _refuse({"--depth-images": self.depth_images}, "name a folder that holds no DEM")
        if self.viewpoints is not None:
            _refuse({"--bounds": self.bounds_deg}, "leave it out: all viewpoints are rendered")

    @property
    def _of_planner(self) -> dict[str, object]:
        return {
            "--coarse-spacing": self.coarse_m,
            "--site-spacing": self.site_m,
            "--threshold-px": self.threshold_px,
            "--coverage": self.coverage,
            "--map": self.map,
        }

    def plan_config(self) -> PlanConfig:
        """Return the settings of the planner; raises as `PlanConfig`."""
        given = {
            "coarse_m": self.coarse_m,
            "site_spacing_m": self.site_m,
            "threshold_px": self.threshold_px,
            "coverage": self.coverage,
        }
        chosen = {name: value for name, value in given.items() if value is not None}
        return PlanConfig(str(self.planner), **chosen)  # type: ignore[arg-type]

    def config(self, terrain: HeightField) -> RenderConfig:
        """Return the settings of views of a terrain; raises `InputError` as `Curvature`."""
        return RenderConfig(self.width, curvature_of(terrain, self.refraction_k))


def _refuse(options: Mapping[str, object], advice: str) -> None:
    for name, value in options.items():
        if value is not None:
            raise InputError(f"{name} {value} does not suit the other options; {advice}")


def render_store(task: RenderTask, listener: Listener) -> BuildResult:
    """Render views from viewpoints into a store.

    The viewpoints are given or on a grid. After a stop, the same call continues. Raises as
    `RenderTask.check`, `read_viewpoints` and `build_store`.
    """
    task.check()
    advise_to_continue(task.output, listener)
    terrain = read_terrain(listener, task.dem, task.crs)
    config = task.config(terrain)
    labels: tuple[str, ...] = ()
    if task.viewpoints is not None:
        eyes, labels = read_viewpoints(task.viewpoints, terrain)
        plan = RenderingPlan.given(eyes, config)
    else:
        plan = RenderingPlan.uniform(terrain, task.spacing_m or 0.0, task.bounds_deg, config)
    note_added_area(task.output, plan, terrain, listener)
    if task.depth_images is not None:
        from skyline.report import paper_pictures  # noqa: PLC0415  (slow to load)

        paper_pictures.check_depth_folder(task.depth_images, len(plan.viewpoints), labels)
    with runner_of(task.workers) as runner, build_bar(task.output, "renderings", listener) as bar:
        result = build_store(terrain, task.output, plan, runner, bar)
    if task.depth_images is not None:
        with listener.progress("drawing depth images") as drawn:
            paper_pictures.save_depth_pictures(
                terrain, plan.viewpoints, task.depth_images, config, labels, drawn
            )
    return result


def render_planned(
    task: RenderTask, listener: Listener
) -> tuple[BuildResult, CoveragePlan, Verification] | None:
    """Let a planner choose a store's viewpoints, and render them.

    Returns None if the store is complete already. Raises as `RenderTask.check`, `PlanConfig` and
    `build_planned`, and `InputError` for a map of a store that is complete.
    """
    task.check()
    planned = task.plan_config()
    terrain = read_terrain(listener, task.dem, task.crs)
    with listener.progress("covering, %") as bar:
        config = task.config(terrain)
        result = build_planned(terrain, task.output, planned, task.bounds_deg, config, bar)
    if task.map is not None:
        if result is None:
            raise InputError(
                f"{task.output} is complete, and only a new plan can be drawn as a map; remove the "
                "store to plan it again"
            )
        from skyline.report.paper_pictures import save_coverage_map  # noqa: PLC0415  (slow to load)

        save_coverage_map(result[1], task.map)
    return result
