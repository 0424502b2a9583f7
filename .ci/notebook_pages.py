"""Notebooks in docs/notebooks/ become pages of the documentation.

They are run first where `run_notebooks` in mkdocs.yml says so, and their pages then show what they
printed and drew. An error in a notebook, a claim that is not so among them, stops the build.
"""

import re
import tempfile
from pathlib import Path, PurePosixPath

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbconvert import MarkdownExporter

_LINK = re.compile(r"(\]\((?!https?://)[^)]+)\.ipynb\)")
_PANDAS_TABLE = '<table border="1" class="dataframe">'
_PATIENCE_S = 300


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for each notebook; the notebook itself stays a file to download."""
    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        text, pictures = page_of(Path(file.abs_src_path), config.extra["run_notebooks"])
        page = PurePosixPath(file.src_uri).with_suffix(".md")
        files.append(File.generated(config, str(page), content=text))
        for name, data in pictures.items():
            files.append(File.generated(config, str(page.parent / name), content=data))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links at the pages of notebooks."""
    return _LINK.sub(r"\1.md)", markdown)


def page_of(path: Path, run: bool) -> tuple[str, dict[str, bytes]]:
    """Return a notebook as Markdown, and its pictures by name; `PluginError` where it fails."""
    notebook = nbformat.read(path, as_version=4)
    if run:
        with tempfile.TemporaryDirectory() as folder:
            client = NotebookClient(
                notebook,
                timeout=_PATIENCE_S,
                resources={"metadata": {"path": folder}},
                extra_arguments=["--log-level=ERROR"],
            )
            try:
                client.execute()
            except CellExecutionError as error:
                raise PluginError(f"{path.name}: {error}") from error
    names = {"unique_key": path.stem, "output_files_dir": f"{path.stem}_files"}
    text, resources = MarkdownExporter().from_notebook_node(notebook, names)
    text = text.replace(_PANDAS_TABLE, "<table>")  # drawn as the site's other tables are
    link = f'<a href="{path.name}" download>Download this page as a notebook</a>'
    return f"{text}\n{link}\n", resources.get("outputs", {})
