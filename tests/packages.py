"""Installed packages, made up: a module in a folder, and the metadata that pip would write."""

from pathlib import Path


def install(folder: Path, name: str, code: str, group: str, **entries: str) -> None:
    """Install a package of one module; ``entries`` are its entry points of a group."""
    metadata = folder / f"{name}-1.0.dist-info"
    metadata.mkdir(parents=True)
    (folder / f"{name}.py").write_text(code)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = [f"{entry} = {value}\n" for entry, value in entries.items()]
    (metadata / "entry_points.txt").write_text(f"[{group}]\n{''.join(lines)}")
