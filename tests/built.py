"""The site, built from the committed notebooks as they are stored."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from ledger import NOTEBOOKS, WORKBOOK


def build_site(folder: Path, *options: str) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """Build the pages into a folder; return where they are, and how Sphinx ended."""
    source, html = folder / "source", folder / "html"
    shutil.copytree(WORKBOOK.parent / "book", source)
    shutil.copy(WORKBOOK / "inventory.toml", source)
    for notebook in NOTEBOOKS:
        place = source / "chapters" / notebook.relative_to(WORKBOOK)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(notebook, place)
    command = [sys.executable, "-m", "sphinx", "-q", *options, str(source), str(html)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    return html, done
