"""Print the core path of the built site into one PDF, with a Chromium that is here."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from pypdf import PdfWriter

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
PLACES = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    r"C:\Program Files\Google\Chrome\Application\chrome.exe",
    r"C:\Program Files (x86)\Microsoft\Edge\Application\msedge.exe",
)


def find_chromium() -> str | None:
    """Return the path of a browser of the Chromium family, or None."""
    found = [path for path in map(shutil.which, NAMES) if path]
    return next(iter([*found, *(place for place in PLACES if Path(place).is_file())]), None)


def print_page(browser: str, page: Path, target: Path) -> None:
    """Print one page; mathematics has ten seconds of the browser's own time."""
    options = ["--headless", "--disable-gpu", "--no-pdf-header-footer"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        options.append("--no-sandbox")  # as in a container, where root is the only user
    options += ["--virtual-time-budget=10000", f"--print-to-pdf={target}", page.as_uri()]
    with tempfile.TemporaryDirectory() as profile:
        command = [browser, f"--user-data-dir={profile}", *options]
        subprocess.run(command, check=True, capture_output=True, timeout=120)


def print_core(html: Path, target: Path) -> str:
    """Print the front page and the core chapters into one file; say where it is, or why not."""
    browser = find_chromium()
    if browser is None:
        return "no PDF: there is no Chromium, Chrome or Edge here to print with"
    pages = [html / "index.html", *sorted((html / "chapters").glob("[0-9]*.html"))]
    writer = PdfWriter()
    with tempfile.TemporaryDirectory() as folder:
        for number, page in enumerate(pages, start=1):
            part = Path(folder) / f"{page.stem}.pdf"
            print_page(browser, page, part)
            writer.append(part, outline_item=page.stem.replace("_", " "))
            print(f"[{number}/{len(pages)}] {page.stem} printed", flush=True)
    beside = target.with_suffix(".new")
    writer.write(beside)
    beside.replace(target)
    return f"open {target.as_uri()}"
