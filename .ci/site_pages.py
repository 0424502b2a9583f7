"""What the site of the documentation needs beyond the pages in docs/.

The README, CONTRIBUTING and CHANGELOG lie in the root of the repository and become pages. Records
and figures in bench/results/, and the import contract, become files of the site where a page links
to them. Constants and equations of the code that a page names get their present form. Equations
become MathML, which browsers draw themselves. A page that asks another server for a script, a style
or a picture stops the build.
"""

import html
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from skyline.errors import InputError
from skyline_bench.documents.constants import with_constants
from skyline_bench.documents.equations import with_equations

ROOT = Path(__file__).resolve().parents[1]
ROOT_PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Files in the root of the repository, and the pages they become."""

_FILE = re.compile(r"\]\((?:\.\./)*(bench/results/[\w./-]+|\.importlinter)\)")
_EQUATION = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
_FETCHED = re.compile(
    r"<(?:script|img|iframe|source)\b[^>]*\bsrc=[\"']?(?:https?:)?//[^>]*>"
    r"|<link\b[^>]*\brel=[\"']?(?:stylesheet|preconnect|preload|icon)\b[^>]*\bhref=[\"']?"
    r"(?:https?:)?//[^>]*>"
)


def _published(path: str) -> str:
    """Return the path on the site of a file outside docs/; MkDocs leaves hidden files out."""
    return f"{path[1:]}.txt" if path.startswith(".") else path


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of the root, and the files outside docs/ that pages link to."""
    for name, page in ROOT_PAGES.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / name)))
    linked = {
        path
        for file in files.documentation_pages()
        for path in _FILE.findall(Path(file.abs_src_path or "").read_text(encoding="utf-8"))
    }
    for path in sorted(linked):
        files.append(File.generated(config, _published(path), abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links at the site's pages, and fill constants and equations of the code in.

    What the code does not have stops the build.
    """
    path = page.file.src_uri
    try:
        markdown = with_equations(with_constants(markdown, path, keep_comments=False), path)
    except InputError as error:
        raise PluginError(str(error)) from error
    up = "../" * path.count("/")
    markdown = _FILE.sub(lambda found: f"]({up}{_published(found[1])})", markdown)
    if path in ROOT_PAGES.values():
        markdown = markdown.replace("](docs/", "](")
    for name, target in ROOT_PAGES.items():
        markdown = re.sub(rf"\]\((?:\.\./)*{re.escape(name)}(?=[)#])", f"]({up}{target}", markdown)
    return markdown


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn equations into MathML."""

    def drawn(found: re.Match[str]) -> str:
        display = "inline" if found[1] == "span" else "block"
        return convert(html.unescape(found[2]), display=display)

    return _EQUATION.sub(drawn, content)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Refuse what would be fetched from another server."""
    fetched = _FETCHED.search(output)
    if fetched:
        raise PluginError(f"{page.file.src_uri} asks another server: {fetched[0]}")
    return output
