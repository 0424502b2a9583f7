"""Fixtures of several files of tests: a server of elevation tiles, of the test's own."""

import pytest
from range_server import Behaviour, serve
from tile_scenes import NAMES, two_degrees, two_tiles


@pytest.fixture(scope="session")
def heights():
    """The samples of two tiles side by side."""
    return two_degrees()


@pytest.fixture(scope="session")
def contents(heights):
    """The files of the tiles by their addresses."""
    return two_tiles(heights)


@pytest.fixture
def server(contents):
    """The behaviour of a server that has the tiles."""
    return Behaviour(files=dict(contents))


@pytest.fixture
def template(server):
    """The template of addresses on the running server."""
    with serve(server) as host:
        yield host + NAMES
