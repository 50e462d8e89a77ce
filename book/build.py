"""Execute what changed and build the site from it: what `run.py book` does after it installed.

python book/build.py [--all] [--pdf] [--skip NOTEBOOK ...] [-- SPHINX OPTIONS]

The old site stays until the new one is whole. Copies of the notebooks are executed below
_build/executed; executed.json keeps, of each, the hash of all that its outputs depend on.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import re
import shutil
import subprocess
import sys
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

from nbregress.batch import run_all
from nbregress.store import write

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "_build"
EXECUTED, RECORD = BUILD / "executed", BUILD / "executed.json"
CODE = (".py", ".pyi", ".js", ".css")


def put(source: Path, target: Path) -> bool:
    """Copy a file where it is missing or another, and say so; the same keeps its time."""
    if target.is_file() and target.read_bytes() == source.read_bytes():
        return False
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(source, target)
    return True


def used_packages() -> dict[str, str]:
    """Return the versions of what requirements.txt names and needs, and of nothing else here."""
    lines = (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines()
    found: dict[str, str] = {}
    todo = [line for line in lines if line[:1].isalpha()]
    while todo:
        requirement = todo.pop()
        name = re.split(r"[^\w.-]", requirement)[0].lower().replace("_", "-")
        if name in found or re.search(r"\bextra *==", requirement):
            continue
        with suppress(PackageNotFoundError):  # another system's, or toppra
            found[name] = distribution(name).version
            todo += distribution(name).requires or []
    return found


def content_keys(notebooks: list[Path]) -> dict[str, str]:
    """Return, by name, a hash of a notebook, the library, the packages and Python."""
    versions = sorted(f"{name} {number}" for name, number in used_packages().items())
    common = hashlib.sha256("\n".join([platform.python_version(), *versions]).encode())
    for path in sorted(p for p in (ROOT / "lib").rglob("*") if p.suffix in CODE):
        common.update(path.read_bytes())
    keys = {}
    for path in notebooks:
        own = common.copy()
        own.update(path.read_bytes())
        keys[path.relative_to(ROOT).as_posix()] = own.hexdigest()
    return keys


def write_record(known: dict[str, str]) -> None:
    """Replace the record in one step."""
    beside = RECORD.with_suffix(".new")
    beside.write_text(json.dumps(known, indent=1), encoding="utf-8")
    os.replace(beside, RECORD)


def execute(notebooks: list[Path], everything: bool, jobs: int) -> list[Path]:
    """Execute copies of the notebooks that changed; return those that failed."""
    keys = content_keys(notebooks)
    known = {}
    if RECORD.is_file() and not everything:
        known = json.loads(RECORD.read_text(encoding="utf-8"))
    known = {n: k for n, k in known.items() if keys.get(n) == k and (EXECUTED / n).is_file()}
    changed = [name for name in keys if name not in known]
    print(f"{len(changed)} of {len(keys)} notebooks to execute", flush=True)
    EXECUTED.mkdir(exist_ok=True)
    for name in changed:
        put(ROOT / name, EXECUTED / name)

    def finish(path: Path, run: Any) -> str:
        write(run.executed, path)
        name = path.as_posix()
        known[name] = keys[name]
        write_record(known)  # now, as an interruption may follow
        return "executed"

    os.chdir(EXECUTED)  # for short names in what it prints
    return run_all([Path(name) for name in changed], finish, jobs=jobs, given={})


def gather(pages: dict[Path, Path], folder: Path, doctrees: Path) -> None:
    """Make a folder hold these files, and of other notebooks none.

    Sphinx reads again what is younger than its doctree, by a clock that may have been set back;
    so of what changed there is none.
    """
    for path in folder.rglob("*.ipynb"):
        if path not in pages:
            path.unlink()
    for target, source in pages.items():
        if put(source, target):
            tree = doctrees / target.relative_to(folder).with_suffix(".doctree")
            tree.unlink(missing_ok=True)


def restore() -> None:
    """Put the old site back where an interruption came between the two renamings."""
    if (BUILD / "html.old").exists() and not (BUILD / "html").exists():
        (BUILD / "html.old").rename(BUILD / "html")


def build(skipped: list[Path], notebooks: list[Path], options: list[str]) -> None:
    """Build the site beside the old one, then put it in its place."""
    source, site, html = BUILD / "source", BUILD / "site", BUILD / "html"
    own = [p for p in (ROOT / "book").rglob("*.*") if p.is_file()]
    pages = {source / p.relative_to(ROOT / "book"): p for p in own if "__pycache__" not in p.parts}
    pages[source / "inventory.toml"] = ROOT / "workbook" / "inventory.toml"
    for path in [*notebooks, *skipped]:
        name = path.relative_to(ROOT)
        target = source / "chapters" / path.relative_to(ROOT / "workbook")
        pages[target] = path if path in skipped else EXECUTED / name
    doctrees = BUILD / "doctrees"
    gather(pages, source, doctrees)
    os.chdir(BUILD)
    command = ["-m", "sphinx", "-j", str(os.cpu_count() or 1), "-d", str(doctrees)]
    subprocess.run([sys.executable, *command, *options, str(source), str(site)], check=True)
    fresh, old = BUILD / "html.new", BUILD / "html.old"
    for folder in (fresh, old):
        shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(site, fresh, ignore=shutil.ignore_patterns(".buildinfo*"))
    if html.exists():
        html.rename(old)
    fresh.rename(html)
    shutil.rmtree(old, ignore_errors=True)


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--all", action="store_true", help="execute every notebook")
    parser.add_argument("--pdf", action="store_true", help="print the core path into one file")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--skip", nargs="*", default=[], help="shown as they were committed")
    options, sphinx = parser.parse_known_args(arguments)
    BUILD.mkdir(exist_ok=True)
    restore()
    paths = sorted((ROOT / "workbook").rglob("[0-9][0-9]_*.ipynb"))
    paths = [path for path in paths if not path.parent.name.startswith(".")]
    skipped = [ROOT / name for name in options.skip]
    notebooks = [path for path in paths if path not in skipped]
    if execute(notebooks, options.all, options.jobs):
        print("a notebook failed, so no site was built")
        return 1
    try:
        build(skipped, notebooks, sphinx)
    except subprocess.CalledProcessError:
        return 1
    if options.pdf:
        from paper import print_core

        print(print_core(BUILD / "html", BUILD / "statebook.pdf"))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
