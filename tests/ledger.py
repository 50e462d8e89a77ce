"""What the chapters claim to cover, read from their cells without running them."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import dataclass
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pytest depends on it there

WORKBOOK = Path(__file__).parents[1] / "workbook"
CHAPTERS = sorted(WORKBOOK.glob("[0-9][0-9]_*.ipynb"))
NOTEBOOKS = sorted(p for p in WORKBOOK.rglob("*.ipynb") if ".ipynb_checkpoints" not in p.parts)
LONGEST_CELL = 25


@dataclass(frozen=True)
class Row:
    """One item or erratum of the source."""

    id: str
    chapters: tuple[str, ...]
    kind: str
    text: str


def read_ledger(path: Path = WORKBOOK / "inventory.toml") -> dict[str, Row]:
    """Return the rows by their ids."""
    rows = tomllib.loads(path.read_text(encoding="utf-8"))["row"]
    ledger = {r["id"]: Row(r["id"], tuple(r["chapters"]), r["kind"], r["text"]) for r in rows}
    if len(ledger) != len(rows):
        raise ValueError(f"{path.name}: an id occurs twice")
    return ledger


def parts_of(chapter: Path) -> list[Path]:
    """Return a chapter's core notebook and, where there is one, its deeper part."""
    deeper = chapter.parent / "deeper" / chapter.name
    return [chapter, *([deeper] if deeper.exists() else [])]


def read_notebook(path: Path) -> dict:
    """Return a notebook's JSON with each source as one string."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    for cell in notebook["cells"]:
        cell["source"] = "".join(cell["source"])
    return notebook


def prose_of(notebook: dict) -> set[str]:
    """Return the rows that passages of prose name in their metadata."""
    cells = (c for c in notebook["cells"] if c["cell_type"] == "markdown")
    return {row for cell in cells for row in cell["metadata"].get("covers", ())}


def checks_of(notebook: dict) -> dict[str, list[str]]:
    """Return, of each row that code cells name in their metadata, the names of its checks."""
    found: dict[str, list[str]] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            for row, names in cell["metadata"].get("covers", {}).items():
                found.setdefault(row, []).extend(names)
    return found


def printed_checks(cell: dict) -> list[str]:
    """Return the lines that a cell's checks have printed, without the word ok."""
    texts = ("".join(o["text"]) for o in cell.get("outputs", ()) if o.get("name") == "stdout")
    return [line[4:] for text in texts for line in text.splitlines() if line.startswith("ok  ")]


def gaps(chapter: str, notebooks: list[dict], ledger: dict[str, Row]) -> list[str]:
    """Return what is wrong with a chapter's coverage.

    chapter is its two digits, notebooks are its core and, where there is one, its deeper part.
    """
    prose: set[str] = set().union(*(prose_of(notebook) for notebook in notebooks))
    checks: dict[str, list[str]] = {}
    problems = []
    for notebook in notebooks:
        for row, names in checks_of(notebook).items():
            checks.setdefault(row, []).extend(names)
        problems += unprinted(notebook)
    problems += [
        f"no row {row} in the ledger" for row in sorted((prose | set(checks)) - set(ledger))
    ]
    for row in ledger.values():
        if chapter not in row.chapters or row.kind == "exercise":
            continue
        covered = row.id in checks or (row.kind == "editorial" and row.id in prose)
        if not covered:
            problems.append(f"row {row.id} ({row.kind}) is not covered: {row.text}")
        elif row.id.startswith("E") and row.kind == "computed" and len(checks[row.id]) != 2:
            problems.append(
                f"row {row.id} must name two checks: one of the printed form, one of"
                f" the right one; got {checks[row.id]}"
            )
    return problems


def unprinted(notebook: dict) -> list[str]:
    """Return the checks that cells name for rows and have not printed."""
    return [
        f"the check {name!r} named for row {row} is not in its cell's output"
        for cell in notebook["cells"]
        if cell["cell_type"] == "code"
        for row, names in cell["metadata"].get("covers", {}).items()
        for name in names
        if not any(line.startswith(f"{name}: ") for line in printed_checks(cell))
    ]


def faults(notebook: dict) -> list[str]:
    """Return what is wrong with a notebook's stored state."""
    problems = []
    code = [c for c in notebook["cells"] if c["cell_type"] == "code" and c["source"].strip()]
    counts = [cell["execution_count"] for cell in code]
    if None in counts:
        problems.append(f"code cell {counts.index(None) + 1} was not executed")
    elif counts != list(range(1, len(code) + 1)):
        problems.append(f"execution counts are not 1 to {len(code)}: {counts}")
    if not code or code[-1]["source"].strip() != "sb.summary()":
        problems.append("the last code cell must be sb.summary()")
    names = [{line.rpartition(": ")[0] for line in printed_checks(cell)} for cell in code]
    for name in sorted(set().union(*names)):
        if sum(name in found for found in names) > 1:
            problems.append(f"two cells check {name!r}: names must tell checks apart")
    for number, cell in enumerate(code, start=1):
        if re.search(r"\bcovers\s*=", cell["source"]):
            problems.append(f"code cell {number} names rows of the ledger in its code")
        lines = len(cell["source"].splitlines())
        if lines > LONGEST_CELL:
            problems.append(f"code cell {number} has {lines} lines; at most {LONGEST_CELL}")
        expected = "raises-exception" in cell["metadata"].get("tags", [])
        for output in cell["outputs"]:
            if output["output_type"] == "error" and not expected:
                problems.append(f"code cell {number} holds an error: {output['ename']}")
            failed = output.get("name") == "stdout" and "FAILED  " in "".join(output["text"])
            if failed and "shows-failure" not in cell["metadata"].get("tags", []):
                problems.append(f"code cell {number} holds a check that failed")
            if output.get("name") == "stderr":
                problems.append(f"code cell {number} holds a warning: {''.join(output['text'])}")
    return problems
