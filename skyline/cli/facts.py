"""Facts in a table, as ``skyline info`` and ``explain`` print them."""

from collections.abc import Iterator, Mapping


def table_of(facts: Mapping[str, object], meanings: Mapping[str, str] | None = None) -> str:
    """Return facts as a table, with numbers as options take them.

    ``meanings`` explains numbers whose names do not.
    """
    rows = list(_rows(facts))
    width = max(len(name) for name, _ in rows)
    said = {name: f"  ({words})" for name, words in (meanings or {}).items()}
    return "\n".join(f"{name:<{width}}  {text}{said.get(name, '')}" for name, text in rows)


def _rows(facts: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the name and the text of each line.

    Each text in a list gets a line.
    """
    for name, value in facts.items():
        if isinstance(value, Mapping):
            yield from _rows(value, f"{prefix}{name}.")
            continue
        values = value if isinstance(value, list) else [value]
        shown = ["-" if one is None else _shown(one) for one in values]
        if not any(isinstance(one, str) for one in values):
            shown = [",".join(shown)]
        for line, text in enumerate(shown):
            yield "" if line else f"{prefix}{name}", text


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.9g}" if isinstance(value, float) else str(value)
