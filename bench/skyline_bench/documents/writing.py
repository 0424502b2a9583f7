"""Writing into pages: tables between markers, figures by their sentences, constants, equations."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from skyline.errors import InputError
from skyline_bench.documents.constants import with_constants
from skyline_bench.documents.equations import with_equations
from skyline_bench.documents.results import Results
from skyline_bench.documents.tables import TABLES, markdown

_TABLE = re.compile(
    r"(<!-- figures: (?P<name>[\w-]+) -->\n\n).*?(\n<!-- end of figures -->)", re.DOTALL
)
_FIGURE = r"([\d,.]*\d)"


@dataclass(frozen=True, slots=True)
class Sentence:
    """A part of a page with figures, which braces stand for."""

    words: str
    figures: Callable[[Results], Sequence[str]]

    def written(self, text: str, results: Results, page: str) -> str:
        """Return a page's text with the records' figures in this sentence.

        Raises `InputError` unless the page has the sentence once, whatever its figures are.
        """
        parts = [self._pattern(part) for part in self.words.split("{}")]
        found = list(re.finditer(_FIGURE.join(parts), text))
        if len(found) != 1:
            raise InputError(
                f"{page} has the sentence `{self.words}` {len(found)} times; expected once: change "
                "it there and in skyline_bench/documents/sentences.py alike"
            )
        (match,) = found
        figures = self.figures(results)
        for number, figure in reversed(list(enumerate(figures, start=1))):
            start, end = match.span(number)
            text = text[:start] + figure + text[end:]
        return text

    @staticmethod
    def _pattern(part: str) -> str:
        """Return a pattern for words, whose lines may break anywhere."""
        return r"\s+".join(re.escape(word) for word in part.split(" "))


def written(
    text: str, page: str, results: Results, sentences: Mapping[str, Sequence[Sentence]]
) -> str:
    """Return a page's text with its figures and equations written anew.

    Figures come from the records, and constants and equations from the code. ``page`` is its path
    from the root of the repository. Raises `InputError` for an unknown table, a sentence that is
    not there, and a constant or an equation that the code does not have, and `MissingFileError` for
    a record that is not there.
    """
    up = "../" * page.count("/")

    def table(match: re.Match[str]) -> str:
        if match["name"] not in TABLES:
            raise InputError(
                f"{page} has the table `{match['name']}`; expected one of {', '.join(TABLES)}"
            )
        made = markdown(TABLES[match["name"]](results))
        return f"{match[1]}{made.replace('](bench/', f']({up}bench/')}{match[3]}"

    text = _TABLE.sub(table, text)
    for sentence in sentences.get(page, ()):
        text = sentence.written(text, results, page)
    return with_equations(with_constants(text, page), page)


def pages_in(root: Path) -> list[Path]:
    """Return README and the pages of docs/."""
    return [
        page
        for page in (root / "README.md", *sorted((root / "docs").rglob("*.md")))
        if page.is_file()
    ]
