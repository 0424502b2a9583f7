"""Names of fields in the glossary, and in the classes of the package."""

import dataclasses
import importlib
import pkgutil
import re
from pathlib import Path

import pytest

import skyline

GLOSSARY = Path(__file__).parents[2] / "docs" / "glossary.md"
ROWS = re.findall(r"^\| `(\w+)` \| (.+) \| (`.+`) \|$", GLOSSARY.read_text(), re.MULTILINE)


def classes_with(field):
    """Return the public dataclasses of the package that have a field of a name."""
    found = set()
    for module in pkgutil.walk_packages(skyline.__path__, "skyline."):
        if module.name.endswith("__main__"):
            continue
        for name, kind in vars(importlib.import_module(module.name)).items():
            is_its_own = getattr(kind, "__module__", "") == module.name
            is_class = isinstance(kind, type) and dataclasses.is_dataclass(kind)
            if is_its_own and is_class and not name.startswith("_"):
                found |= {name} & {name for one in dataclasses.fields(kind) if one.name == field}
    return found


def test_the_glossary_has_the_names_that_had_two_meanings():
    names = {"heading_deg", "cost", "score", "trust", "v", "within_m"}
    assert names <= {field for field, _, _ in ROWS}


@pytest.mark.parametrize("field", ["height", "angle"])
def test_a_field_says_which_height_or_angle_it_is_and_in_which_unit(field):
    assert classes_with(field) == set()


@pytest.mark.parametrize(("field", "classes"), [(field, classes) for field, _, classes in ROWS])
def test_a_class_whose_field_has_a_name_of_the_glossary_is_listed_there(field, classes):
    # Who adds such a field reads the quantity that its name has in all others.
    assert classes_with(field) == set(re.findall(r"`(\w+)`", classes))
