"""Build a site whose notebooks run in the browser, by JupyterLite: what `run.py lite` does.

python book/lite.py [--skip NOTEBOOK ...] [OPTIONS OF jupyter lite build]

The hand-out's notebooks get a first cell that installs statebook there. The reader's browser
loads Pyodide, Python for browsers, from its own host; of `--pyodide FILE`, a release of it, the
site has a copy and asks nobody. The old site stays until the new one is whole.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

from statebook.grading.students import hand_out

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "_build"
# What Pyodide does not hold: pure Python, so the wheels of any machine will do.
PACKAGES = ("control", "ipywidgets", "cloudpickle", "comm", "jupyterlab_widgets")
INSTALL = "%pip install -q statebook " + "ipywidgets cloudpickle"


def for_browsers(notebook: dict[str, Any]) -> dict[str, Any]:
    """Return a notebook that begins with the installation, for the browser's Python."""
    cell = {
        "cell_type": "code",
        "execution_count": None,
        "id": "install",
        "metadata": {},
        "outputs": [],
        "source": INSTALL,
    }
    kernel = {"name": "python", "display_name": "Python (Pyodide)", "language": "python"}
    metadata = {**notebook["metadata"], "kernelspec": kernel}
    return {**notebook, "metadata": metadata, "cells": [cell, *notebook["cells"]]}


def contents(folder: Path, skipped: list[str]) -> None:
    """Write the notebooks into a new folder, but those that are skipped."""
    for path in hand_out(ROOT / "workbook", folder):
        if f"workbook/{path.relative_to(folder).as_posix()}" in skipped:
            path.unlink()
        else:
            notebook = for_browsers(json.loads(path.read_text(encoding="utf-8")))
            path.write_text(json.dumps(notebook, ensure_ascii=False), encoding="utf-8")


def wheels(folder: Path) -> list[Path]:
    """Make or fetch the wheels that the site brings along."""
    source = folder / "source"  # a copy, as pip leaves folders behind where it builds
    shutil.copytree(ROOT / "lib", source / "lib", ignore=shutil.ignore_patterns("nbregress"))
    for name in ("pyproject.toml", "README.md", "LICENSE", "LICENSE-CC-BY-4.0.md"):
        shutil.copy(ROOT / name, source)
    needed = [f"{name}=={version(name)}" for name in PACKAGES]
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--wheel-dir", str(folder)]
    subprocess.run([*command, str(source), *needed], check=True)
    return sorted(folder.glob("*.whl"))


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--skip", nargs="*", default=[], help="left out of the site")
    options, others = parser.parse_known_args(arguments)
    with tempfile.TemporaryDirectory(dir=BUILD) as beside:
        place = Path(beside)
        contents(place / "files", options.skip)
        site, lite = place / "site", BUILD / "lite"
        command = [sys.executable, "-m", "jupyterlite_core", "build", "--lite-dir", str(place)]
        command += ["--contents", str(place / "files"), "--output-dir", str(site), *others]
        command += [f"--piplite-wheels={wheel}" for wheel in wheels(place / "wheels")]
        try:
            subprocess.run(command, check=True, cwd=place)
        except subprocess.CalledProcessError:
            return 1
        shutil.rmtree(lite, ignore_errors=True)
        site.rename(lite)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
