"""``skyline cache`` while other processes use the cache."""

import multiprocessing
import shutil

import pytest

from skyline.cache import areas_folder


def come_and_go(stop):
    """Make and remove areas until ``stop`` is set."""
    while not stop.is_set():
        for number in range(3):
            tiles = areas_folder() / "origin" / f"{number}.00_1.00_9.00_2.00" / "tiles"
            tiles.mkdir(parents=True)
            for one in range(60):
                (tiles / f"{one}.tif").touch()
        shutil.rmtree(areas_folder())


@pytest.mark.usefixtures("cache")
def test_areas_are_listed_while_others_are_removed(run):
    processes = multiprocessing.get_context("fork")
    stop = processes.Event()
    other = processes.Process(target=come_and_go, args=(stop,))
    other.start()
    try:
        for _ in range(150):
            run("cache").ok()
    finally:
        stop.set()
        other.join()
