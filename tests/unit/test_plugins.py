"""Plugins of installed packages: found by name, or refused in one line."""

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


def test_an_unknown_name_lists_the_known_ones(site):
    install(site, "plugins_c", "", GROUP, one="plugins_c:one", two="plugins_c:two")
    with pytest.raises(InputError, match=r"^test is 'three'; expected one of one, two$"):
        load(GROUP, "three")


def test_a_group_without_plugins_says_that_the_installation_is_old():
    with pytest.raises(InputError, match=r"no test at all.*; install skyline anew$"):
        load(GROUP, "one")


def test_a_name_that_two_packages_offer_is_refused(site):
    for name in ("plugins_d", "plugins_e"):
        install(site, name, "def one(): return 1", GROUP, one=f"{name}:one")
    with pytest.raises(InputError, match=r"^plugins_d and plugins_e each have a test 'one'"):
        load(GROUP, "one")


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("", "AttributeError: module .* has no attribute 'one'"),
    ],
)
def test_a_package_that_cannot_be_imported_is_named(site, request, code, reason):
    name = f"plugins_f{abs(hash(request.node.name))}"
    install(site, name, code, GROUP, one=f"{name}:one")
    with pytest.raises(InputError, match=rf"'one' of {name} cannot be imported \({reason}\)"):
        load(GROUP, "one")
