"""Printed forms of objects in notebooks."""

from collections.abc import Mapping
from html import escape

from skyline.errors import printable


def facts_html(facts: Mapping[str, str]) -> str:
    """Return named facts as an HTML table."""
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(printable(fact))}</td></tr>"
        for name, fact in facts.items()
    )
    return f"<table>{rows}</table>"
