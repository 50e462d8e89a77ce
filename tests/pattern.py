"""The form of a notebook that is read: what a reader meets, without running it.

    python tests/pattern.py workbook/07_pendulum.ipynb ...

prints each notebook's measures and what departs from the pattern.
"""

from __future__ import annotations

import re
import statistics
import sys
from dataclasses import dataclass, field
from pathlib import Path

from ledger import read_notebook

HEADINGS = ("Where this breaks", "Summary", "Next", "Your turn")
OPENING = ("**Before you start", "**You will be able to", "*About ")


@dataclass(frozen=True)
class Budget:
    """The least and the most that a kind of notebook may hold."""

    cells: int = 20
    lines: int = 150
    median: float = 8
    words: tuple[int, int] = (900, 1500)
    figures: int = 6
    headings: tuple[str, ...] = field(default=HEADINGS)
    opening: tuple[str, ...] = field(default=OPENING)


BUDGETS = {
    "chapter": Budget(),
    "primer": Budget(cells=12, words=(600, 1300), figures=4),
    "case": Budget(cells=30, lines=120, median=12, words=(400, 1800), headings=(), opening=()),
}


def kind_of(path: Path) -> str:
    """Return which budget a notebook has; an empty text for one without."""
    folder, number = path.parent.name, path.stem[:2]
    if folder == "cases":
        return "case"
    if folder in ("deeper", "exercises") or number == "90":
        return ""
    return "primer" if number.startswith("8") else "chapter"


def is_figure(cell: dict) -> bool:
    """Tell whether a code cell shows a figure, a film or a player."""
    data = [output.get("data", {}) for output in cell.get("outputs", ())]
    return any("image/png" in d or "sb-player" in "".join(d.get("text/html", "")) for d in data)


def is_player(cell: dict) -> bool:
    """Tell whether a code cell shows something that moves."""
    data = [output.get("data", {}) for output in cell.get("outputs", ())]
    return any("sb-player" in "".join(d.get("text/html", "")) for d in data)


def in_view(cell: dict) -> bool:
    """Tell whether a code cell stands open in front of a reader."""
    return not {"hide-input", "solution"} & set(cell["metadata"].get("tags", ()))


def measures(notebook: dict) -> dict[str, float]:
    """Return the counts by which a notebook is budgeted."""
    code = [c for c in notebook["cells"] if c["cell_type"] == "code" and c["source"].strip()]
    lines = [len(cell["source"].splitlines()) for cell in code if in_view(cell)]
    prose = [c["source"] for c in notebook["cells"] if c["cell_type"] == "markdown"]
    return {
        "cells": len(code),
        "lines": sum(lines),
        "median": statistics.median(lines or [0]),
        "words": sum(len(re.findall(r"\w+", text)) for text in prose),
        "figures": sum(map(is_figure, code)),
        "players": sum(map(is_player, code)),
    }


def pictures(notebook: dict) -> list[str]:
    """Return the figures without an alt text, and those whose caption has not its number."""
    problems, number, cells = [], 0, notebook["cells"]
    for cell, after in zip(cells, [*cells[1:], {"source": ""}], strict=True):
        if cell["cell_type"] != "code" or not is_figure(cell):
            continue
        number += 1
        moves = is_player(cell)
        image = cell["metadata"].get("mystnb", {}).get("image", {})
        if not (re.search(r"\balt=", cell["source"]) if moves else image.get("alt")):
            problems.append(f"figure {number} has no alt text")
        html = "".join(
            "".join(o.get("data", {}).get("text/html", "")) for o in cell["outputs"] if moves
        )
        caption = html if moves else after["source"].lstrip()[:14]
        if f"Figure {number}." not in caption:
            problems.append(f"figure {number} has no caption that begins 'Figure {number}.'")
    return problems


def departures(notebook: dict, kind: str) -> list[str]:
    """Return where a notebook departs from the pattern of its kind."""
    problems = pictures(notebook)
    if not kind:
        return problems
    budget, found = BUDGETS[kind], measures(notebook)
    for name in ("cells", "lines", "median", "figures"):
        if found[name] > getattr(budget, name):
            problems.append(f"{name}: {found[name]:g}, at most {getattr(budget, name)}")
    if not budget.words[0] <= found["words"] <= budget.words[1]:
        problems.append(f"words: {found['words']}, between {budget.words[0]} and {budget.words[1]}")
    prose = [c["source"] for c in notebook["cells"] if c["cell_type"] == "markdown"]
    problems += [
        f"{text!r} is missing from the top"
        for text in budget.opening
        if not any(line.startswith(text) for line in prose[0].splitlines())
    ]
    text = "\n\n".join(prose)
    problems += [f"the section {h!r} is missing" for h in budget.headings if f"## {h}" not in text]
    if kind == "case":
        return problems
    for paragraph in re.findall(r"^Predict:.*?(?:\n\n|\Z)", text, re.MULTILINE | re.DOTALL):
        if "?" not in paragraph:
            problems.append(f"no question: {paragraph.strip()[:60]!r}")
    asked = len(re.findall(r"^Predict:", text, re.MULTILINE))
    if asked > text.count("<summary>What you see"):
        problems.append(f"{asked} times Predict, fewer answers folded under 'What you see'")
    if not asked:
        problems.append("nothing to predict")
    return problems


if __name__ == "__main__":
    for name in sys.argv[1:]:
        notebook = read_notebook(Path(name))
        print(name, " ".join(f"{key} {value:g}" for key, value in measures(notebook).items()))
        for problem in departures(notebook, kind_of(Path(name))):
            print("   ", problem)
