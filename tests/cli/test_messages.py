"""Messages of mistakes, and options whose names and meanings go one to one."""

import logging

import pytest
from commands import assert_refused

from skyline import cli
from skyline.errors import start_logging


def options():
    """Yield the command and the options of every command."""
    for names in cli.COMMANDS.values():
        for name in names:
            command = cli.loaded(name)
            for sub in getattr(command, "commands", {"": command}).values():
                yield (
                    f"{name} {sub.name}",
                    [one for one in sub.params if one.param_type_name == "option"],
                )


def test_an_option_takes_the_same_in_every_command():
    """Files and folders that are written differ by their kind alone."""
    taken = {}
    for command, some in options():
        for option in some:
            if option.metavar and "--output" not in option.opts:
                taken.setdefault(option.opts[0], {}).setdefault(option.metavar, command)
    assert {name: found for name, found in taken.items() if len(found) > 1} == {}


def test_what_is_known_of_a_photo_is_said_to_locate_as_to_match():
    known = {
        command: {
            option.opts[0]
            for option in some
            if option.rich_help_panel == "The photos"
            or option.opts[0] in {"--fov-deg", "--near", "--bounds"}
        }
        for command, some in options()
    }
    assert known["locate locate"] == known["match match"]
    assert {"--heading", "--eye-height", "--use-gps"} <= known["locate locate"]


@pytest.mark.parametrize("command", [(), ("match",), ("dem", "fetch")])
def test_h_is_help(run, command):
    short = run(*command, "-h").ok()
    assert short.out == run(*command, "--help").out
    assert "Usage" in short.out


def test_v_is_the_version(run):
    assert run("-v").ok().out == run("--version").out


@pytest.mark.parametrize(
    ("arguments", "new"),
    [
        (("horizon", "dem.tif", "--points", "p.csv"), "--viewpoints"),
        (("horizon", "dem.tif", "--k", "0.2"), "No such option: --k"),
        (("peaks", "--bbox", "9,46,10,47"), "No such option: --bbox"),
    ],
)
def test_an_old_name_is_one_line(run, arguments, new):
    assert_refused(run(*arguments), new)


def test_a_photo_before_the_store_is_told(run, store, photo):
    for command in ("match", "serve"):
        done = run(command, photo, store)
        assert_refused(done, f"{store} is a store and is named after {photo}")


def test_a_missing_store_is_not_called_a_dem(run, tmp_path):
    for command in (("info",), ("store", "check")):
        done = run(*command, tmp_path / "none.h5")
        assert_refused(done, "none.h5 does not exist; check the name, or build it")
        assert "DEM" not in done.err


def test_a_store_in_place_of_a_dem_is_told(run, store):
    assert_refused(run("horizon", store, "--at", "10.33,46.74"), "is a store; name the elevation")


def test_other_bounds_for_a_store_are_explained(run):
    shown = " ".join(run("build", "--help").ok().out.replace("│", " ").split())
    assert "One that exists gets the places of other --bounds as well" in shown


def test_a_warning_looks_like_an_error(capsys):
    root = logging.getLogger()
    kept, root.handlers = root.handlers, []
    try:
        start_logging()
        logging.getLogger("skyline").warning("of\nsomething")
        assert capsys.readouterr().err == "warning: of\\nsomething\n"
    finally:
        root.handlers = kept


def test_bad_options_are_one_line(run, dem, store, renderings, photo, tmp_path):
    out = tmp_path / "out.h5"
    for arguments, message in [
        (["render", dem, "-o", out], "give one of --viewpoints FILE.csv, --spacing M"),
        (["render", dem, "-o", out, "--planner", "lpov", "--workers", "2"], "--workers 2 does not"),
        (["render", dem, "-o", out, "--spacing", "500", "--width", "0"], "width is 0"),
        (
            ["render", dem, "-o", out, "--planner", "lpov", "--coarse-spacing", 50_000],
            "larger than the area",
        ),
        (["build", dem, "-o", out, "--workers", "0"], "workers is 0; expected 1 or more"),
        (["build", dem, "-o", out, "--workers", "nonsense://x"], "no dask scheduler answers"),
        (["build", dem, "-o", out, "--places", 400, "--spacing", 80], "give one of the spacing (a"),
        (["dem", "fetch", "--bounds", "9.4,46.4", "-o", out], "expected W,S,E,N in degrees"),
        (["build", dem, "-o", out, "--spacing", "1e9"], "choose a smaller spacing"),
        (["build", dem, "-o", out, "--bounds", "46.74,10.32,46.75,10.34"], "give 10.32,46.74,10."),
        (["match", renderings, photo, "--matcher", "paper"], "--fov-deg"),
        (["match", store, photo, "--fov-deg", "60", "--matcher", "magic"], "'magic'"),
        (["match", store, "-", "--workers", "2"], "standard input is read in this process"),
        (["match", tmp_path / "none.h5", photo, "--fov-deg", "60"], "none.h5"),
        (["info"], "nothing to describe"),
        (["explain", dem, "--at", "5"], "expected LON,LAT"),
        (["explain", dem, "--at", "46.7,190.3"], "swapped: give 190.3,46.7"),
        (["build", dem, "-o", tmp_path / "no" / "folder.h5"], "folder"),
        (
            ["render", tmp_path, "-o", out, "--spacing", "9", "--depth-images", tmp_path / "depth"],
            "name a folder that holds no DEM",
        ),
    ]:
        assert_refused(run(*arguments), message)
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--near", "46.7478,10.3327,5"), "seem to be swapped: give 10.3"),
        (("--near", "10.3,46.7,0"), "a radius above 0 km"),
        (("--near", "1,2,3,4,5"), "expected LON,LAT,KM"),
        (("--near", "9.8,46.7,9.9,46.8"), "give W,S,E,N as --bounds"),
        (("--heading", "140"), "expected both or neither"),
        (("--heading", "140", "--heading-slack", "0"), "expected a slack above 0"),
    ],
)
def test_a_bad_narrowing_is_refused_in_one_line(run, store, photo, options, said):
    assert_refused(run("match", store, photo, "--fov-deg", "60", *options), said)
