"""Copies of the workbook for students: chapters, and exercises without their solutions.

python -m statebook.grading.students DIR [--workbook FOLDER]
"""

import argparse
import copy
import json
import re
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

_BEGIN, _END = "### BEGIN SOLUTION", "### END SOLUTION"  # nbgrader's marks
_SOLUTION = "solution"  # the tag of a cell that no student's copy has


def without_solutions(notebook: dict[str, Any]) -> dict[str, Any]:
    """Return a student's copy of an exercise notebook in solved form.

    Cells tagged "solution" go, with their outputs and attachments; of the other code cells what
    stands between nbgrader's marks, and all outputs.

    Raises
    ------
    ValueError
        A mark has no partner.

    Examples
    --------
    >>> source = "x = None  # your answer\\n### BEGIN SOLUTION\\nx = 42\\n### END SOLUTION"
    >>> cell = {"cell_type": "code", "source": source, "metadata": {}, "outputs": [1]}
    >>> without_solutions({"cells": [cell]})["cells"][0]["source"]
    'x = None  # your answer\\n'
    """
    result = copy.deepcopy(notebook)
    cells = [c for c in result["cells"] if _SOLUTION not in c["metadata"].get("tags", [])]
    for number, cell in enumerate(cells):
        source = "".join(cell["source"])
        if cell["cell_type"] == "code":
            source = re.sub(rf"[ \t]*{_BEGIN}.*?{_END}[ \t]*\n?", "", source, flags=re.DOTALL)
            cell.update(outputs=[], execution_count=None)
        if _BEGIN in source or _END in source:
            raise ValueError(f"cell {number} must have pairs of '{_BEGIN}' and '{_END}'")
        cell["source"] = source
        cell["metadata"].pop("covers", None)
    return {**result, "cells": cells}


def hand_out(workbook: Path, folder: Path) -> list[Path]:
    """Write the chapters, and the exercises without solutions, into a new folder.

    Parameters
    ----------
    workbook : path
        The tracked notebooks.
    folder : path
        Must not exist yet, or be empty: students' work is never overwritten.

    Returns
    -------
    list of path
        The notebooks written.

    Raises
    ------
    ValueError
        The folder holds files, or lies in the workbook; there are no notebooks.
    """
    workbook, folder = workbook.resolve(), folder.resolve()
    if folder.is_relative_to(workbook):
        raise ValueError(f"{folder} must not lie in {workbook}: those notebooks are tracked")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"{folder} must be new or empty: what students wrote is not overwritten")
    sources = sorted(p for p in workbook.rglob("[0-9]*.ipynb") if not p.parent.name.startswith("."))
    if not sources:
        raise ValueError(f"{workbook} must hold the workbook's notebooks")
    folder.parent.mkdir(parents=True, exist_ok=True)
    # Written beside and then renamed: a folder is whole, or is not there.
    with tempfile.TemporaryDirectory(dir=folder.parent) as beside:
        whole = Path(beside) / "hand-out"
        for source in sources:
            notebook = json.loads(source.read_text(encoding="utf-8"))
            if source.parent.name == "exercises":
                notebook = without_solutions(notebook)
            target = whole / source.relative_to(workbook)
            target.parent.mkdir(parents=True, exist_ok=True)
            text = json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
            target.write_text(text, encoding="utf-8")
        if folder.exists():
            folder.rmdir()
        shutil.move(whole, folder)
    return [folder / source.relative_to(workbook) for source in sources]


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="students", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--workbook", type=Path, default=Path("workbook"))
    options = parser.parse_args(arguments)
    try:
        written = hand_out(options.workbook, options.folder)
    except (OSError, ValueError) as error:
        sys.exit(f"students: {error}")
    exercises = sum(path.parent.name == "exercises" for path in written)
    print(f"{options.folder}: {len(written)} notebooks, {exercises} of them exercises")


if __name__ == "__main__":
    main(sys.argv[1:])
