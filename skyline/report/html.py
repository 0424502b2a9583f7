"""HTML pages in one file: text, tables and pictures, without a network.

Each function returns HTML, and escapes the texts it is given, including file names.
"""

import base64
import re
from collections.abc import Iterable, Sequence
from html import escape

from skyline.errors import printable
from skyline.files.disk import PAGE_MARK

_NUMBER = re.compile(r"[-+−]?\d+(\.\d+)?|–")
"""A number or the dash of an unknown value."""
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


def page(title: str, lead: str, sections: Iterable[str], foot: str = "") -> str:
    """Return a whole page.

    ``lead`` is a sentence or two of introduction.
    """
    body = "\n".join(sections)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">{PAGE_MARK}\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{_escaped(title)}</title>\n<style>{_STYLE}</style></head>\n<body>\n"
        f"<h1>{_escaped(title)}</h1>\n<p class=lead>{_escaped(lead)}</p>\n"
        f"{body}\n"
        f"<footer>{_escaped(foot)}</footer>\n</body></html>\n"
    )


def section(title: str, parts: Iterable[str]) -> str:
    """Return a section with a heading."""
    return "\n".join([f"<section><h2>{_escaped(title)}</h2>", *parts, "</section>"])


def text(words: str, kind: str = "", links: Iterable[tuple[str, str]] = ()) -> str:
    """Return a paragraph.

    ``links``, each an address and its text, are appended to it. ``kind`` highlights a result:
    ``answer``, ``refusal`` or ``pose``.
    """
    shown = _escaped(words)
    for link in links:
        address, link_words = map(_escaped, link)
        shown += f' <a href="{address}" rel="noreferrer">{link_words}</a>'
    return f'<p class="result {kind}">{shown}</p>' if kind else f"<p>{shown}</p>"


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> str:
    """Return a table; columns of numbers are aligned to the right."""
    aligned = [all(map(_NUMBER.fullmatch, column)) for column in zip(*rows, strict=True)]
    body = "".join(_row("td", row, aligned) + "\n" for row in rows)
    above = f"<caption>{_escaped(caption)}</caption>" if caption else ""
    thead = f"<thead>{_row('th', columns, aligned)}</thead>" if any(columns) else ""
    return f"<div class=scroll><table>{above}{thead}<tbody>\n{body}</tbody></table></div>"


def figures(pictures: Iterable[str]) -> str:
    """Return `picture`s in a grid."""
    shown = "\n".join(pictures)
    return f"<div class=figures>\n{shown}\n</div>"


def picture(data: bytes, caption: str, *, wide: bool = True) -> str:
    """Return a PNG or JPEG as a figure.

    ``wide`` gives it the whole width of the page.
    """
    mime = "image/png" if data.startswith(b"\x89PNG") else "image/jpeg"
    content = base64.b64encode(data).decode()
    return (
        f"<figure{' class=wide' if wide else ''}>"
        f'<img src="data:{mime};base64,{content}" alt="{_escaped(caption)}">'
        f"<figcaption>{_escaped(caption)}</figcaption></figure>"
    )


def _escaped(text: str) -> str:
    return escape(printable(text))


def _row(tag: str, texts: Iterable[str], aligned: Sequence[bool]) -> str:
    """Return a row of a table.

    Cells of ``aligned`` columns are aligned to the right.
    """
    cells = (
        f"<{tag}{' class=n' if right else ''}>{_escaped(text)}</{tag}>"
        for text, right in zip(texts, aligned, strict=True)
    )
    return f"<tr>{''.join(cells)}</tr>"
