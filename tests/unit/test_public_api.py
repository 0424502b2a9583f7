"""`import skyline` is light, and it has the names that its functions take and give."""

import inspect
import subprocess
import sys
import typing

import pytest

import skyline
from skyline.cli import COMMANDS

HEAVY = {"cv2", "matplotlib", "moderngl", "h5py", "numpy", "rasterio", "scipy", "xarray"}
INTERNAL = {
    "Horizons",
    "PhotoForm",
    "Shard",
    "Sighting",
    "SkySession",
    "Spec",
    "Tabled",
    "WholeFile",
}
"""Skyline's own, in signatures that users have no need to call or settings of settings."""
OPTIONAL = ("Axes", "DataArray", "DataFrame", "Dataset", "GeoDataFrame", "Series")
"""Of libraries that are loaded when a method needs them, if at all."""


@pytest.mark.parametrize(
    ("subjects", "unwanted"),
    [
        ((), HEAVY),
        (("Stores", "Views from a position", "Data"), {"scipy", "skyline.photo"}),
        (COMMANDS, {"matplotlib", "pandas", "ephem"}),
    ],
    ids=["none", "of stores", "all"],
)
def test_commands_load_what_they_need_alone(subjects, unwanted):
    names = [name for subject in subjects for name in COMMANDS[subject]]
    code = (
        "import sys, skyline; from skyline.cli import loaded; "
        f"[loaded(name) for name in {names}]; print({unwanted} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "set()"


def test_every_public_name_is_there_once():
    assert len(set(skyline.__all__)) == len(skyline.__all__)
    assert set(dir(skyline)) >= set(skyline.__all__)
    for name in skyline.__all__:
        assert getattr(skyline, name).__name__ == name
        assert getattr(skyline, name).__doc__, name
    with pytest.raises(AttributeError):
        skyline.no_such_name  # noqa: B018


def classes_in(hint):
    """Yield Skyline's classes that a type hint speaks of."""
    if inspect.isclass(hint) and hint.__module__.startswith("skyline"):
        yield hint
    for part in typing.get_args(hint):
        for each in part if isinstance(part, list) else [part]:
            yield from classes_in(each)


def functions_of(thing):
    """Yield a function, or the public methods, properties and the constructor of a class."""
    if not inspect.isclass(thing):
        yield thing
        return
    for name, member in vars(thing).items():
        if name.startswith("_") and name != "__init__":
            continue
        # Of class methods and of properties it is what they wrap.
        wrapped = (getattr(member, part, None) for part in ("__func__", "fget", "func"))
        yield from filter(inspect.isfunction, [member, *wrapped])


@pytest.mark.parametrize("name", skyline.__all__)
def test_help_names_types_and_not_what_they_are_made_of(name):
    for function in functions_of(getattr(skyline, name)):
        for parameter in inspect.signature(function).parameters.values():
            assert len(str(parameter)) <= 150, f"{function.__qualname__}: {parameter}"


@pytest.mark.parametrize("name", skyline.__all__)
def test_types_of_parameters_and_results_are_public_too(name):
    names = ("DemOptions", "MatchResult", "Orientation")
    known = {each: getattr(skyline, each) for each in names} | dict.fromkeys(OPTIONAL, object)
    for function in functions_of(getattr(skyline, name)):
        for hint in typing.get_type_hints(function, localns=known).values():
            for each in classes_in(hint):
                public = getattr(skyline, each.__name__, None) is each
                assert public or each.__name__ in INTERNAL, function.__qualname__
