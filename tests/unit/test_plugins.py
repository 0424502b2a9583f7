"""Plugins of installed packages are found by name."""

import pytest
from packages import install

from skyline.errors import InputError
from skyline.plugins import load, names_of

GROUP = "skyline.tests"


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder from which packages are imported."""
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_plugins_of_all_packages_are_found(site):
    install(site, "plugins_a", "def first(): return 1", GROUP, one="plugins_a:first")
    install(site, "plugins_b", "def second(): return 2", GROUP, another="plugins_b:second")
    assert names_of(GROUP) == ["another", "one"]
    assert load(GROUP, "one")() == 1
    assert load(GROUP, "another")() == 2


def test_names_that_are_unknown_or_offered_twice_are_refused(site):
    for name in ("plugins_c", "plugins_d"):
        install(site, name, "def one(): return 1", GROUP, one=f"{name}:one")
    for name in ("one", "two"):
        with pytest.raises(InputError):
            load(GROUP, name)
