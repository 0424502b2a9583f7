"""What the site of the documentation needs beyond the pages in docs/.

The README, CONTRIBUTING and CHANGELOG lie in the root of the repository and become pages. Records
and figures in bench/results/ become files of the site where a page links to them. Equations become
MathML, which browsers draw themselves. A page that asks another server for a script, a style or a
picture stops the build.
"""

import html
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
ROOT_PAGES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Files in the root of the repository, and the pages they become."""

_RECORD = re.compile(r"\]\((?:\.\./)*(bench/results/[\w./-]+)\)")
_EQUATION = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
_FETCHED = re.compile(
    r"<(?:script|img|iframe|source)\b[^>]*\bsrc=[\"']?(?:https?:)?//[^>]*>"
    r"|<link\b[^>]*\brel=[\"']?(?:stylesheet|preconnect|preload|icon)\b[^>]*\bhref=[\"']?"
    r"(?:https?:)?//[^>]*>"
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of the root, and the records that pages link to."""
    for name, page in ROOT_PAGES.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / name)))
    linked = {
        record
        for file in files.documentation_pages()
        for record in _RECORD.findall(Path(file.abs_src_path or "").read_text(encoding="utf-8"))
    }
    for record in sorted(linked):
        files.append(File.generated(config, record, abs_src_path=str(ROOT / record)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links at the site's pages instead of the repository's files."""
    up = "../" * page.file.src_uri.count("/")
    markdown = _RECORD.sub(rf"]({up}\1)", markdown)
    if page.file.src_uri in ROOT_PAGES.values():
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
