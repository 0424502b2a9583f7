"""Plugins: functions and classes that installed packages offer by name.

Skyline's own are among them. A package offers one with a line in its ``pyproject.toml``: an entry
point in one of Skyline's groups.
"""

from importlib.metadata import EntryPoint, entry_points
from typing import Any

from skyline.errors import InputError


def names_of(group: str) -> list[str]:
    """Return the names of a group's plugins in all installed packages, sorted."""
    return sorted(entry_points(group=group).names)


def load(group: str, name: str) -> Any:
    """Import the plugin of a name and return it.

    Parameters
    ----------
    group : str
        ``skyline.planners`` for example.
    name : str

    Raises
    ------
    InputError
        No package has such a plugin, two packages have one, or its module cannot be imported.
    """
    kind = group.removeprefix("skyline.").removesuffix("s")
    found = [*entry_points(group=group, name=name)]
    if not found:
        known = names_of(group)
        if not known:
            raise InputError(f"there is no {kind} at all, not even skyline's; install skyline anew")
        raise InputError(f"{kind} is {name!r}; expected one of {', '.join(known)}")
    if len(found) > 1:
        packages = " and ".join(sorted(map(_package_of, found)))
        raise InputError(f"{packages} each have a {kind} {name!r}; uninstall all but one of them")
    try:
        return found[0].load()
    except Exception as error:  # The module is another's, and may raise anything.
        raise InputError(
            f"{kind} {name!r} of {_package_of(found[0])} cannot be imported "
            f"({type(error).__name__}: {error}); mend that package, or name another {kind}"
        ) from error


def _package_of(entry: EntryPoint) -> str:
    return "a package without a name" if entry.dist is None else entry.dist.name
