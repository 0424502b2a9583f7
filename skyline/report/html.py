"""Pages of text, tables and pictures in one HTML file that asks nothing of any network."""

import base64
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import groupby
from numbers import Real
from pathlib import Path

from skyline.errors import InputError, printable
from skyline.files import write_with_folders

_MIME_OF_HEAD = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}
_NUMBER = re.compile(r"[-+−]?\d+(\.\d+)?")
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_STYLE = """
:root { color-scheme: light dark; --page: #fbfbf9; --ink: #1b1e22; --faint: #62686f;
  --line: #d9dcdf; --card: #ffffff; --mark: #b3123a; --good: #1f7a3a; }
@media (prefers-color-scheme: dark) {
  :root { --page: #15181b; --ink: #e6e8ea; --faint: #9aa1a8; --line: #343a40; --card: #1d2125;
    --mark: #ff6d92; --good: #6fd08c; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 76rem; padding: 1.5rem 1.25rem 4rem; background: var(--page);
  color: var(--ink); font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0.2rem 0 0.3rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 0.5rem; padding-top: 1rem;
  border-top: 1px solid var(--line); overflow-wrap: anywhere; }
p { margin: 0.5rem 0; max-width: 60rem; }
.lead, figcaption, caption, footer { color: var(--faint); }
.result { font-size: 1.05rem; font-weight: 600; border-left: 4px solid var(--mark);
  padding-left: 0.7rem; }
.answer { --mark: var(--good); } .pose { --mark: var(--faint); } a { color: inherit; }
.figures { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 1rem;
  align-items: start; margin: 1rem 0; }
figure { margin: 0; padding: 0.5rem; background: var(--card); border: 1px solid var(--line);
  border-radius: 6px; }
figure.wide { grid-column: 1 / -1; }
figure img { display: block; width: 100%; height: auto; background: #ffffff; }
figcaption { font-size: 0.88rem; padding-top: 0.4rem; }
.scroll { overflow-x: auto; margin: 0.8rem 0; }
table { border-collapse: collapse; font-size: 0.92rem; }
caption { text-align: left; padding-bottom: 0.3rem; }
th, td { padding: 0.3rem 0.75rem; border-bottom: 1px solid var(--line); text-align: left;
  vertical-align: top; overflow-wrap: anywhere; }
thead th { white-space: nowrap; border-bottom: 2px solid var(--line); }
.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
footer { margin-top: 3rem; font-size: 0.85rem; }
@media (max-width: 52rem) { .figures { grid-template-columns: minmax(0, 1fr); } }
@media print { body { max-width: none; } figure { break-inside: avoid; } }
"""


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph, and after it a link where there is one.

    ``kind`` sets a result off: ``answer``, ``refusal`` or ``pose``.
    """

    text: str
    kind: str = ""
    link: tuple[str, str] | None = None
    """The address, and the words that lead there."""

    def html(self) -> str:
        """Return the paragraph's HTML."""
        shown = _escaped(self.text)
        if self.link is not None:
            address, words = map(_escaped, self.link)
            shown += f' <a href="{address}" rel="noreferrer">{words}</a>'
        return f'<p class="result {self.kind}">{shown}</p>' if self.kind else f"<p>{shown}</p>"


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of plain values under named columns; numbers are set to the right."""

    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    """One value a column; None is a dash, floats have six digits unless they are text already."""
    caption: str = ""

    def html(self) -> str:
        """Return the table's HTML."""
        aligned = [_is_numeric([row[at] for row in self.rows]) for at in range(len(self.columns))]
        body = "".join(_row("td", map(_shown, row), aligned) + "\n" for row in self.rows)
        caption = f"<caption>{_escaped(self.caption)}</caption>" if self.caption else ""
        head = _row("th", self.columns, aligned)
        thead = f"<thead>{head}</thead>" if any(self.columns) else ""
        return f"<div class=scroll><table>{caption}{thead}<tbody>\n{body}</tbody></table></div>"


@dataclass(frozen=True, slots=True)
class Picture:
    """A PNG or JPEG; ``wide`` gives it the whole width of the page."""

    data: bytes = field(repr=False)
    caption: str
    wide: bool = True

    def __post_init__(self) -> None:
        if self._mime is None:
            raise InputError(f"picture {self.caption!r} is neither PNG nor JPEG; save it as PNG")

    @property
    def _mime(self) -> str | None:
        known = (mime for head, mime in _MIME_OF_HEAD.items() if self.data.startswith(head))
        return next(known, None)

    def html(self) -> str:
        """Return the figure's HTML, the picture in it."""
        data = base64.b64encode(self.data).decode()
        return (
            f"<figure{' class=wide' if self.wide else ''}>"
            f'<img src="data:{self._mime};base64,{data}" alt="{_escaped(self.caption)}">'
            f"<figcaption>{_escaped(self.caption)}</figcaption></figure>"
        )


Part = Text | Table | Picture


@dataclass(frozen=True, slots=True)
class Section:
    """A headed part of a page; pictures that follow one another share a grid."""

    title: str
    parts: Sequence[Part]

    def html(self) -> str:
        """Return the section's HTML."""
        lines = [f"<section><h2>{_escaped(self.title)}</h2>"]
        for are_pictures, parts in groupby(self.parts, lambda part: isinstance(part, Picture)):
            shown = "\n".join(part.html() for part in parts)
            lines.append(f"<div class=figures>\n{shown}\n</div>" if are_pictures else shown)
        return "\n".join([*lines, "</section>"])


@dataclass(frozen=True, slots=True)
class Page:
    """A report: any text in it, file names among them, is shown as it is and never as HTML."""

    title: str
    lead: str
    """What the report is about, in a sentence or two."""
    sections: Sequence[Section]
    foot: str = ""
    """What made it, and when."""

    def html(self) -> str:
        """Return the whole page."""
        sections = "\n".join(section.html() for section in self.sections)
        return (
            '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{_escaped(self.title)}</title>\n<style>{_STYLE}</style></head>\n<body>\n"
            f"<h1>{_escaped(self.title)}</h1>\n<p class=lead>{_escaped(self.lead)}</p>\n"
            f"{sections}\n"
            f"<footer>{_escaped(self.foot)}</footer>\n</body></html>\n"
        )

    def write(self, path: Path) -> None:
        """Write the page to a file; raises `InputError` where it cannot be written."""
        write_with_folders(path, self.html())


def _escaped(text: str) -> str:
    return escape(printable(text))


def _is_numeric(values: Sequence[object]) -> bool:
    """Whether a column holds some numbers, written out or not, and nothing but them and dashes."""
    given = [value for value in values if value is not None]
    return bool(given) and all(
        (isinstance(value, Real) and not isinstance(value, bool))
        or (isinstance(value, str) and _NUMBER.fullmatch(value))
        for value in given
    )


def _shown(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _row(tag: str, texts: Iterable[str], aligned: Sequence[bool]) -> str:
    """Return a row of cells; to the right where ``aligned``."""
    cells = (
        f"<{tag}{' class=n' if right else ''}>{_escaped(text)}</{tag}>"
        for text, right in zip(texts, aligned, strict=True)
    )
    return f"<tr>{''.join(cells)}</tr>"
