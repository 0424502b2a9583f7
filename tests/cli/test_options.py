"""Options whose names and meanings go one to one, and their help."""

import pytest

from skyline import cli


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


def test_help_fills_its_lines(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    shown = run("horizon", "--help").ok().out
    assert "With --photo, it follows the photo's skyline where the photo shows one." in shown


def test_v_is_the_version(run):
    assert run("-v").ok().out == run("--version").out


def test_other_bounds_for_a_store_are_explained(run):
    shown = " ".join(run("build", "--help").ok().out.replace("│", " ").split())
    assert "If it exists, the places of other --bounds are added to it" in shown
