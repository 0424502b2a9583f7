"""The README and docs/ as tests read them: blocks of commands, code, references, links."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")))

_NOT_RUN = re.compile(r"<!-- not run: (.+) -->")
_REFERENCE = re.compile(
    r"`((?:skyline|shaders|bench|tests|examples)/[\w./-]+)`(?:: ((?:`[\w.]+`(?:, )?)+))?"
)
_LINK = re.compile(r"\]\((?!https?://|#)([^)#]+)(?:#[^)]*)?\)")


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block; ``not_run`` is the reason given where it is not to be run."""

    document: str
    line: int
    language: str
    text: str
    not_run: str | None

    def commands(self) -> list[str]:
        """Return its lines that are not empty."""
        return [line for line in self.text.splitlines() if line.strip()]


def blocks_of(document: Path) -> Iterator[Block]:
    """Yield the fenced blocks of a document."""
    opened, comment, lines = None, None, []
    for number, line in enumerate(document.read_text(encoding="utf-8").splitlines(), start=1):
        if opened is None and line.startswith("```"):
            opened, lines = (number, line[3:].strip()), []
        elif opened is not None and line == "```":
            reason = comment[1] if comment else None
            yield Block(document.name, *opened, "\n".join(lines), reason)
            opened, comment = None, None
        elif opened is not None:
            lines.append(line)
        elif line.strip():
            comment = _NOT_RUN.fullmatch(line.strip())


def references(document: Path) -> list[tuple[str, list[str]]]:
    """Return the files of the repository a document names, with the names in each."""
    text = document.read_text(encoding="utf-8")
    return [(path, re.findall(r"`([\w.]+)`", names)) for path, names in _REFERENCE.findall(text)]


def links(document: Path) -> list[Path]:
    """Return where a document's relative links lead."""
    found = _LINK.findall(document.read_text(encoding="utf-8"))
    return [document.parent / target for target in found]


def defined_in(path: Path) -> set[str]:
    """Return the names that a source file defines; methods as Class.method."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return set(re.findall(r"^\w+ (\w+)\(.*\{", text, re.MULTILINE))
    names = set()
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            inner = [each for each in node.body if isinstance(each, ast.FunctionDef)]
            names |= {f"{node.name}.{method.name}" for method in inner}
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return names


def table_under(document: Path, heading: str) -> list[dict[str, str]]:
    """Return the rows of the table whose first column has this heading, code marks taken off."""
    rows: list[dict[str, str]] = []
    columns: list[str] | None = None
    for line in document.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip().strip("`") for cell in line.strip("|").split("|")]
        if columns is None:
            columns = cells if line.startswith("|") and cells[0] == heading else None
        elif not line.startswith("|"):
            return rows
        elif not set(line) <= set("| -"):
            rows.append(dict(zip(columns, cells, strict=True)))
    return rows
