"""Builds: the store equals the renderings, on any workers and however often the build broke.

Jobs are small here, and what was rendered is written at once (`AT_ONCE`) where a build is to be
stopped.
"""

import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scenes import field_of, fractal, write_dem

from skyline import RenderConfig, read_dem, render_to_store, stand_on
from skyline.errors import BuildError, InputError, StoreError, StoreMismatchError
from skyline.geodesy.earth import Curvature
from skyline.render.horizon import HorizonRenderer, PanoramaRenderer
from skyline.store.check import check_store
from skyline.store.merge import merge_stores
from skyline.store.places import BINS, Places
from skyline.store.read import open_store, parts_folder
from skyline.store.write import write_store
from skyline.survey import adaptive_places, plans
from skyline.survey.build import build_places, build_store
from skyline.survey.cluster import runner_of
from skyline.survey.part_files import PartSize
from skyline.survey.plans import JobSize, RenderingPlan, uniform_grid

SPACING_M = 120.0
PLACES = 1500
BESIDE = adaptive_places.NODES_AROUND * 6
"""Viewpoints round the six blocks of the terrain, which are rendered and belong to other blocks."""
CONFIG = RenderConfig(width=64)


AT_ONCE = PartSize(seconds=0.0)
AT_THE_END = PartSize(seconds=1e9)

PlacePlan = partial(plans.PlacePlan, job_size=JobSize(400, 100))


def rendering_plan(*given):
    return replace(RenderingPlan.uniform(*given), job_size=JobSize(30, 8))


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    return read_dem([write_dem(path, fractal(240, 350, 700.0, seed=12))])


def plan_of(terrain, kind):
    """Return a plan of several jobs."""
    if kind == "planned":
        return PlacePlan(places=PLACES)
    if kind == "uniform":
        return PlacePlan(150.0)
    return rendering_plan(terrain, 700.0, None, CONFIG)


@pytest.fixture(scope="module", params=["planned", "renderings"])
def whole(request, terrain, tmp_path_factory):
    """A plan, and the bytes of an unbroken build of it."""
    path = tmp_path_factory.mktemp("whole") / "s.h5"
    plan = plan_of(terrain, request.param)
    done = build_store(terrain, path, plan)
    assert done.rows == done.rendered
    assert [file.name for file in path.parent.iterdir()] == ["s.h5"]
    return plan, path.read_bytes()


@pytest.fixture(scope="module")
def runner(dask_cluster):
    with runner_of(dask_cluster.scheduler_address) as runner:
        yield runner


def parts_of(path):
    return sorted(parts_folder(path).glob("*/*"))


def begin(terrain, path, plan):
    """Build a store until two of its jobs have parts and the third has begun; return the parts."""

    def stop(*_):
        if len(finished_parts(path)) == 2 and len(parts_of(path)) > 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_store(terrain, path, plan, progress=stop, part_size=AT_ONCE)
    assert not path.exists()
    return parts_of(path)


def finished_parts(path):
    return [part for part in parts_of(path) if "-from-" not in part.name]


def rows_in(parts):
    """Return the number of rows in parts."""
    total = 0
    for part in parts:
        with open_store(part) as store:
            total += len(store)
    return total


@pytest.fixture
def no_large_files():
    """Let this process write no file of more than 4096 bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_first_part_that_cannot_be_written_leaves_nothing(terrain, tmp_path, no_large_files):
    with pytest.raises(StoreError, match="cannot be written"):
        build_places(terrain, tmp_path / "s.h5", SPACING_M)
    assert not list(tmp_path.iterdir())


def test_places_of_a_grid_are_what_was_rendered(terrain, tmp_path):
    path, grid = tmp_path / "s.h5", uniform_grid(terrain, SPACING_M)
    done = build_places(terrain, path, SPACING_M)
    assert done.rows == done.rendered == len(grid) > 1024
    order = np.lexsort((grid.northing_m, grid.easting_m))
    with PanoramaRenderer(terrain, BINS) as renderer:
        wanted = Places.of(renderer.render(grid[order]), SPACING_M / 2.0)
    with open_store(path) as store:
        mapped = store.places()
        assert store.header.config["spacing_m"] == SPACING_M
    stored = Places.concatenate(list(mapped.blocks()))
    for field in fields(Places):
        np.testing.assert_array_equal(getattr(stored, field.name), getattr(wanted, field.name))
    assert check_store(path).whole


def test_renderings_of_given_viewpoints_are_kept_once_each(terrain, tmp_path):
    path, west = tmp_path / "s.h5", terrain.bounds_m[0]
    easting_m = [west + 900.0, west + 300.0, west + 900.0]
    eyes = stand_on(terrain, easting_m=easting_m, northing_m=[5_178_000.0] * 3)
    assert render_to_store(terrain, eyes, path, CONFIG).rows == 8
    with open_store(path) as store:
        views = store.views()
        assert store.header.width == 64
        assert (store.keypoint_columns() < 64).any(axis=1).all()
    with HorizonRenderer(terrain, CONFIG) as renderer:
        wanted = renderer.render(eyes[np.array([1, 0])])
    np.testing.assert_array_equal(views.v, wanted.v)
    assert render_to_store(terrain, eyes, path, CONFIG).rendered == 0
    with pytest.raises(StoreMismatchError, match="viewpoints_digest"):
        render_to_store(terrain, eyes[:1], path, CONFIG)


def halves_of(terrain):
    """Return boxes that hold the west and the east of the terrain, and overlap by 760 m."""
    data = terrain.bounds_m
    west, south, east, north = terrain.frame.box_deg(easting_m=data[::2], northing_m=data[1::2])
    middle = 0.5 * (west + east)
    return (
        (west - 0.1, south - 0.1, middle + 0.01, north + 0.1),
        (middle, south - 0.1, east + 0.1, north + 0.1),
    )


class TestAreas:
    @pytest.mark.parametrize("kind", ["planned", "uniform", "renderings"])
    def test_a_box_is_added_to_a_store(self, terrain, tmp_path, kind):
        """As if the boxes were built each on its own and merged, whichever comes first."""
        west, east = halves_of(terrain)
        plan = plan_of(terrain, kind)

        def of(box):
            if kind == "renderings":
                return rendering_plan(terrain, 700.0, box, CONFIG)
            return replace(plan, bounds_deg=box)

        for name in ("a", "b", "ab", "ba"):
            for box in name:
                plan_there = of({"a": west, "b": east}[box])
                done = build_store(terrain, tmp_path / f"{name}.h5", plan_there)
        report = merge_stores([tmp_path / "a.h5", tmp_path / "b.h5"], tmp_path / "m.h5")
        assert report.rows == done.rows > done.rendered > 0
        assert report.duplicates > 0
        whole = (tmp_path / "m.h5").read_bytes()
        assert (tmp_path / "ab.h5").read_bytes() == (tmp_path / "ba.h5").read_bytes() == whole
        assert build_store(terrain, tmp_path / "ab.h5", of(west)).rendered == 0
        assert (tmp_path / "ab.h5").read_bytes() == whole

    def test_areas_of_one_grid_are_the_store_built_at_once(self, terrain, tmp_path, caplog):
        places = {}
        for name, boxes in (("once", [None]), ("grown", halves_of(terrain))):
            for box in boxes:
                build_places(terrain, tmp_path / f"{name}.h5", SPACING_M, box)
            with open_store(tmp_path / f"{name}.h5") as store:
                places[name] = store.stored()
        for name, values in places["once"].items():
            np.testing.assert_array_equal(places["grown"][name], values)
        assert "% of the bounds" in caplog.text  # The boxes reach 0.1 degrees past the DEM.

    def test_a_box_that_fails_leaves_the_store_as_it_was(self, terrain, tmp_path):
        west, east = halves_of(terrain)
        path = tmp_path / "s.h5"
        build_places(terrain, path, 150.0, west)
        before = path.read_bytes()
        with pytest.raises(StoreMismatchError, match=r"spacing_m is 150\.0 there, 100\.0 here"):
            build_places(terrain, path, 100.0, east)
        with pytest.raises(ZeroDivisionError):
            build_places(terrain, path, 150.0, east, lambda done, _: 1 / (done < 1))
        assert path.read_bytes() == before

    def test_boxes_that_are_built_at_once_are_both_kept(self, terrain, tmp_path):
        west, east = (PlacePlan(400.0, box) for box in halves_of(terrain))
        path = tmp_path / "s.h5"
        build_store(
            terrain, path, west, progress=lambda done, _: done or build_store(terrain, path, east)
        )
        with open_store(path) as store:
            assert store.header.boxes_deg == list(halves_of(terrain))
        assert not parts_folder(path).exists()

    def test_a_build_keeps_its_parts_when_another_ends(self, terrain, tmp_path, monkeypatch):
        west, east = (PlacePlan(150.0, box) for box in halves_of(terrain))
        path = tmp_path / "s.h5"
        begun = begin(terrain, path, west)
        with monkeypatch.context() as patch:

            def write_late(part, *given):
                if part.suffix == ".partial":  # The rows are merged, and not yet the store.
                    patch.undo()
                    build_store(terrain, path, east)
                return write_store(part, *given)

            patch.setattr("skyline.survey.build.write_store", write_late)
            with pytest.raises(StoreError, match=r"another build wrote .* run the same command"):
                build_store(terrain, path, west)
        assert all(part.exists() for part in begun[:2])
        done = build_store(terrain, path, west)
        assert done.rendered == 0 < done.rows
        with open_store(path) as store:
            assert store.header.boxes_deg == list(halves_of(terrain))
        assert [file.name for file in tmp_path.iterdir()] == ["s.h5"]


BUILD = """
import signal
import time
from pathlib import Path
from skyline import read_dem
from skyline.survey.build import build_store
from skyline.survey.part_files import PartSize
from skyline.survey.plans import JobSize, PlacePlan

# A shell lets the jobs in its background ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)

def progress(done, total):
    print(done, flush=True)
    if done > {waits_at}:
        time.sleep(600.0)

plan = PlacePlan({spacing_m}, places={places}, job_size=JobSize(400, 60))
part_size = PartSize(seconds=0.0)
build_store(read_dem({files}), Path("s.h5"), plan, progress=progress, part_size=part_size)
"""


def start_build(folder, terrain, plan, waits_at):
    """Start a build in a process, which waits at some number of rows to be killed."""
    files = list(terrain.provenance.files)
    code = BUILD.format(
        files=files, spacing_m=plan.spacing_m, places=plan.places, waits_at=waits_at
    )
    command = [sys.executable, "-c", code]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)


class TestBroken:
    def test_a_build_continues_to_the_same_bytes(self, terrain, whole, tmp_path):
        plan, unbroken = whole
        path, steps = tmp_path / "s.h5", []
        begun = begin(terrain, path, plan)
        held, finished = rows_in(begun), rows_in(begun[:2])
        done = build_store(terrain, path, plan, progress=lambda *step: steps.append(step))
        assert held >= done.rows - done.rendered > finished > 0
        assert steps[0][0] == held, "what was there already"
        assert steps[-1][0] == steps[-1][1]
        assert path.read_bytes() == unbroken
        assert [file.name for file in tmp_path.iterdir()] == ["s.h5"]
        begun[0].parent.mkdir(parents=True)
        shutil.copy(path, begun[0].with_name("places-00001-00001-of-00002.h5"))
        begun[0].with_name(".s.h5.0123456789ab.partial").touch()
        assert build_store(terrain, path, plan).rendered == 0
        assert path.read_bytes() == unbroken
        assert [file.name for file in tmp_path.iterdir()] == ["s.h5"]

    def test_a_job_that_takes_long_is_kept_as_it_goes(self, terrain, tmp_path):
        """All that was rendered of a block is kept, and nothing of it is rendered again."""
        in_one_block = {
            "easting_m": (600_600.0, 603_900.0),
            "northing_m": (5_176_900.0, 5_179_800.0),
        }
        plan = PlacePlan(None, terrain.frame.box_deg(**in_one_block), PLACES)
        path, steps = tmp_path / "s.h5", []

        def stop(done, total):
            steps.append((done, total))
            if done > 500:
                raise KeyboardInterrupt

        for _ in range(2):
            with pytest.raises(KeyboardInterrupt):
                build_store(terrain, path, plan, progress=stop, part_size=AT_ONCE)
            assert steps[-1][0] == rows_in(parts_of(path)) < 600
        assert steps[-1] == steps[-2], "the second one stopped before it had rendered anything"
        build_store(terrain, path, plan, progress=lambda *step: steps.append(step))
        done = build_store(terrain, tmp_path / "whole.h5", plan)
        assert path.read_bytes() == (tmp_path / "whole.h5").read_bytes()
        rendered = np.diff([done for done, _ in steps])
        assert 0 <= rendered.min() < rendered.max() <= 100, "progress after each rendering"
        assert done.rows == pytest.approx(steps[0][1], rel=0.1), "about as many as expected"

    def test_jobs_that_take_little_have_one_part(self, terrain, tmp_path):
        path, found = tmp_path / "s.h5", []

        def look(done, total):
            if done == total:
                found[:] = [part.name for part in parts_of(path)]

        plan = PlacePlan(700.0, job_size=JobSize(5, 5))
        number = -(-len(uniform_grid(terrain, 700.0)) // 5)
        build_store(terrain, path, plan, progress=look, part_size=AT_THE_END)
        assert found == [f"places-00001-{number:05d}-of-{number:05d}.h5"]

    def test_rows_that_take_much_memory_are_written_at_once(self, terrain, tmp_path):
        """However fast they were rendered: all but the last rendering of a job of 400."""
        path, found = tmp_path / "s.h5", set()
        build_store(
            terrain,
            path,
            PlacePlan(200.0),
            progress=lambda *_: found.update(part.name for part in parts_of(path)),
            part_size=PartSize(seconds=1e9, most_bytes=1),
        )
        assert {f"places-00001-from-{row}-of-00005.h5" for row in (0, 100, 200, 300)} < found

    def test_damaged_parts_are_rendered_again(self, terrain, whole, tmp_path):
        plan, unbroken = whole
        path = tmp_path / "s.h5"
        parts = begin(terrain, path, plan)
        cut, *_, flipped = parts
        cut.write_bytes(cut.read_bytes()[:-100])
        data = bytearray(flipped.read_bytes())
        data[-data[::-1].index(0) // 2] ^= 1
        flipped.write_bytes(data)
        build_store(terrain, path, plan)
        assert path.read_bytes() == unbroken

    def test_parts_of_another_build_are_refused_and_kept(self, terrain, tmp_path):
        path = tmp_path / "s.h5"
        begun = begin(terrain, path, PlacePlan(150.0))
        before = [part.read_bytes() for part in begun]
        for plan, expected in (
            (PlacePlan(100.0), r"config spacing_m is 150\.0 there, 100\.0 here"),
            (PlacePlan(150.0, curvature=Curvature(refraction_k=0.2)), "curvature"),
            (plan_of(terrain, "renderings"), "'places' there, 'renderings' here"),
        ):
            with pytest.raises(StoreMismatchError, match=expected) as caught:
                build_store(terrain, path, plan)
            assert "\n" not in str(caught.value)
            assert str(parts_folder(path)) in str(caught.value)
        assert [part.read_bytes() for part in begun] == before

    @pytest.mark.parametrize("plan", [PlacePlan(200.0), PlacePlan(places=PLACES)], ids=str)
    def test_killed_at_random_instants(self, terrain, tmp_path, plan):
        """Each time at most the rendering in hand is lost."""
        folder = tmp_path / "killed"
        folder.mkdir()
        start = partial(start_build, folder, terrain, plan)
        generator = np.random.default_rng(4)
        before = 0
        build_store(terrain, tmp_path / "unbroken.h5", plan)
        for wait_for, how in ((0, signal.SIGTERM), (300, signal.SIGKILL), (800, signal.SIGINT)):
            child = start(wait_for + 300)
            done = int(child.stdout.readline())
            # All that was kept before is there, but for viewpoints that belong to other blocks.
            assert done >= before - BESIDE
            while done < wait_for:
                done = int(child.stdout.readline())
            threading.Event().wait(generator.uniform(0.0, 0.02))
            # Python drops a SIGINT that arrives while it clears away a dead weak reference.
            while child.poll() is None:
                os.kill(child.pid, how)
                with suppress(subprocess.TimeoutExpired):
                    child.communicate(timeout=10)
            before = done
            assert not (folder / "s.h5").exists()
        last = start(10_000)
        assert last.wait() == 0
        assert int(last.communicate()[0].split()[0]) >= before - BESIDE
        assert (folder / "s.h5").read_bytes() == (tmp_path / "unbroken.h5").read_bytes()
        assert [file.name for file in folder.iterdir()] == ["s.h5"]

    def test_by_another_process_that_finished_it(self, terrain, tmp_path):
        """Which removes the parts under the hands of this one."""
        plan, other = PlacePlan(150.0), tmp_path / "other"
        other.mkdir()
        build_store(terrain, other / "s.h5", plan)
        path = tmp_path / "s.h5"

        def finish(done, _):
            if done > 800 and not path.exists():
                shutil.copy(other / "s.h5", path)
                shutil.rmtree(parts_folder(path))

        done = build_store(terrain, path, plan, progress=finish, part_size=AT_ONCE)
        with open_store(path) as store:
            assert done.rows == len(store)
        assert path.read_bytes() == (other / "s.h5").read_bytes()
        assert not parts_folder(path).exists()


class TestWorkers:
    def test_make_the_same_bytes(self, terrain, whole, runner, tmp_path):
        plan, unbroken = whole
        path, steps, threads = tmp_path / "s.h5", [], set()

        def progress(*step):
            steps.append(step)
            threads.add(threading.get_ident())

        held = rows_in(begin(terrain, path, plan))
        build_store(terrain, path, plan, runner, progress)
        assert path.read_bytes() == unbroken
        assert steps[0][0] == held
        assert steps[-1][0] == steps[-1][1]
        assert held < steps[len(steps) // 2][0] < steps[-1][0]
        assert threads == {threading.get_ident()}

    def test_that_die_lose_no_part(self, terrain, runner, tmp_path):
        path, mark = tmp_path / "s.h5", tmp_path / "died"
        build_store(terrain, tmp_path / "here.h5", PlacePlan(300.0))
        plan = DyingPlan(300.0, job_size=JobSize(400, 100), mark=mark)
        build_store(terrain, path, plan, runner, part_size=AT_ONCE)
        assert mark.exists()
        assert path.read_bytes() == (tmp_path / "here.h5").read_bytes()

    def test_failures_are_named_and_the_others_kept(self, terrain, runner, tmp_path):
        plan, path = PlacePlan(150.0), tmp_path / "s.h5"
        second = plan.jobs(terrain)[1][0]
        failing = FailingPlan(150.0, job_size=plan.job_size, at_m=second.easting_m)
        message = r"1 of \d+ jobs failed: job 2 \(no room"
        with pytest.raises(BuildError, match=message) as failed:
            build_store(terrain, path, failing, replace(runner, retries=0))
        assert "\n" not in str(failed.value)
        done = build_store(terrain, path, plan)
        assert 0 < done.rendered <= 400

    def test_with_another_dem_are_refused(self, terrain, runner, tmp_path):
        other = read_dem([write_dem(tmp_path / "dem.tif", fractal(60, 60, 200.0, seed=1))])
        write_dem(tmp_path / "dem.tif", fractal(60, 60, 200.0, seed=2))
        with pytest.raises(StoreMismatchError, match="workers need the same files"):
            build_store(other, tmp_path / "s.h5", PlacePlan(80.0), replace(runner, retries=0))

    def test_need_a_dem_in_files(self, runner, tmp_path):
        field = field_of(fractal(40, 40, 200.0, seed=1), 30.0)
        with pytest.raises(InputError, match="cannot be sent to workers"):
            build_store(field, tmp_path / "s.h5", PlacePlan(80.0), runner)
        assert list(tmp_path.iterdir()) == []


@dataclass(frozen=True)
class DyingPlan(plans.PlacePlan):
    """Its first worker dies after it has rendered 300 places."""

    mark: Path = Path()

    def opened(self, terrain):
        renderer, rendered = super().opened(terrain), []

        def look(eyes):
            rendered.append(len(eyes))
            if sum(rendered) > 300 and not self.mark.exists():
                self.mark.touch()
                os.kill(os.getpid(), signal.SIGKILL)
            return renderer.look(eyes)

        return replace(renderer, look=look)


@dataclass(frozen=True)
class FailingPlan(plans.PlacePlan):
    """The job that begins at an easting cannot be rendered."""

    at_m: float = 0.0

    def opened(self, terrain):
        renderer = super().opened(terrain)

        def rows(eyes, look):
            if eyes.easting_m[0] == self.at_m:
                raise StoreError("no room")
            return renderer.rows(eyes, look)

        return replace(renderer, rows=rows)
