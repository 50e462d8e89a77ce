"""What the chapters claim to cover, read from their cells without running them."""

from __future__ import annotations

import ast
import json
import sys
from dataclasses import dataclass
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # pytest depends on it there

WORKBOOK = Path(__file__).parents[1] / "workbook"
CHAPTERS = sorted(WORKBOOK.glob("[0-9][0-9]_*.ipynb"))
LONGEST_CELL = 25


@dataclass(frozen=True)
class Row:
    """One item or erratum of the source."""

    id: str
    chapters: tuple[str, ...]
    kind: str
    text: str


@dataclass(frozen=True)
class Claim:
    """A check, or a passage of prose, that names rows."""

    rows: tuple[str, ...]
    relation: str | None  # None for prose


def read_ledger(path: Path = WORKBOOK / "inventory.toml") -> dict[str, Row]:
    """Return the rows by their ids."""
    rows = tomllib.loads(path.read_text(encoding="utf-8"))["row"]
    ledger = {r["id"]: Row(r["id"], tuple(r["chapters"]), r["kind"], r["text"]) for r in rows}
    if len(ledger) != len(rows):
        raise ValueError(f"{path.name}: an id occurs twice")
    return ledger


def read_notebook(path: Path) -> dict:
    """Return a notebook's JSON with each source as one string."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    for cell in notebook["cells"]:
        cell["source"] = "".join(cell["source"])
    return notebook


def claims(notebook: dict) -> list[Claim]:
    """Return every claim of a chapter; covers must be written as literals."""
    found = []
    for cell in notebook["cells"]:
        if cell["cell_type"] == "markdown":
            rows = tuple(cell["metadata"].get("covers", ()))
            found += [Claim(rows, None)] if rows else []
        elif cell["cell_type"] == "code":
            found += [_claim(call) for call in _checks(cell["source"])]
    return found


def _checks(source: str) -> list[ast.Call]:
    code = "\n".join("" if line.startswith(("%", "!")) else line for line in source.splitlines())
    calls = (node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Call))
    return [c for c in calls if ast.unparse(c.func) in ("check", "sb.check")]


def _claim(call: ast.Call) -> Claim:
    arguments = {k.arg: k.value for k in call.keywords}
    rows = ast.literal_eval(arguments["covers"]) if "covers" in arguments else ()
    if not all(isinstance(row, str) for row in rows) or isinstance(rows, str):
        raise ValueError(f"covers must be a tuple of strings: {ast.unparse(call)}")
    relation = ast.literal_eval(arguments["relation"]) if "relation" in arguments else "=="
    return Claim(tuple(rows), relation)


def gaps(chapter: str, notebook: dict, ledger: dict[str, Row]) -> list[str]:
    """Return what is wrong with a chapter's coverage; chapter is its two digits."""
    found = claims(notebook)
    named = {row for claim in found for row in claim.rows}
    problems = [f"no row {row} in the ledger" for row in sorted(named - set(ledger))]
    for row in ledger.values():
        if chapter not in row.chapters or row.kind == "exercise":
            continue
        relations = {claim.relation for claim in found if row.id in claim.rows}
        if row.kind == "editorial":
            covered = bool(relations)
        elif row.id.startswith("E"):  # the printed form fails, the right one holds
            covered = bool(relations & {"differs", ">"}) and bool(relations & {"==", "<"})
        else:
            covered = bool(relations - {None})
        if not covered:
            problems.append(f"row {row.id} ({row.kind}) is not covered: {row.text}")
    return problems


def faults(notebook: dict) -> list[str]:
    """Return what is wrong with a notebook's stored state."""
    problems = []
    code = [c for c in notebook["cells"] if c["cell_type"] == "code" and c["source"].strip()]
    counts = [cell["execution_count"] for cell in code]
    if None in counts:
        problems.append(f"code cell {counts.index(None) + 1} was not executed")
    elif counts != list(range(1, len(code) + 1)):
        problems.append(f"execution counts are not 1 to {len(code)}: {counts}")
    for number, cell in enumerate(code, start=1):
        lines = len(cell["source"].splitlines())
        if lines > LONGEST_CELL:
            problems.append(f"code cell {number} has {lines} lines; at most {LONGEST_CELL}")
        expected = "raises-exception" in cell["metadata"].get("tags", [])
        for output in cell["outputs"]:
            if output["output_type"] == "error" and not expected:
                problems.append(f"code cell {number} holds an error: {output['ename']}")
            if output.get("name") == "stderr":
                problems.append(f"code cell {number} holds a warning: {''.join(output['text'])}")
    return problems
