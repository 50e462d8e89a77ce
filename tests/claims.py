"""Run a notebook's cells here, keep its checks, and swap the two forms of an erratum.

python tests/claims.py NOTEBOOK    print what is wrong, as a JSON list
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
from pathlib import Path

from ledger import Row, checks_of, read_ledger, read_notebook
from statebook.checking import Claim, recorded, verdict_on


def run(notebook: dict, folder: Path) -> list[Claim]:
    """Run code cells in this process up to the last erratum; return the claims of the checks."""
    import matplotlib

    matplotlib.use("agg")
    from IPython.core.interactiveshell import InteractiveShell

    shell = InteractiveShell.instance(colors="NoColor")
    sys.path.insert(0, str(folder))
    wanted = {name for _, names in _errata(notebook) for name in names}
    for number, cell in enumerate(notebook["cells"]):
        if cell["cell_type"] != "code" or cell["source"].strip() == "sb.summary()":
            continue
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            result = shell.run_cell(cell["source"], store_history=True)
        expected = "raises-exception" in cell["metadata"].get("tags", [])
        if not result.success and not expected:
            raise RuntimeError(f"cell {number} failed: {printed.getvalue()[-2000:]}")
        if wanted <= {claim.name for claim in recorded()}:
            break
    return list(recorded())


def _errata(notebook: dict) -> list[tuple[str, list[str]]]:
    return [(row, names) for row, names in checks_of(notebook).items() if row.startswith("E")]


def swaps(notebook: dict, claims: list[Claim], ledger: dict[str, Row]) -> list[str]:
    """Return what is wrong with the pairs of checks that stand for errata.

    Of the two checks that a row names, one shows that the printed form fails, the other that the
    right one holds. With the two forms exchanged both must fail.
    """
    problems = []
    by_name = {claim.name: claim for claim in claims}
    for row, names in _errata(notebook):
        if ledger[row].kind == "editorial":
            continue
        pair = [by_name[name] for name in names if name in by_name]
        printed = [claim for claim in pair if claim.relation != "=="]
        right = [claim for claim in pair if claim.relation == "=="]
        if len(names) != 2 or len(printed) != 1 or len(right) != 1:
            problems.append(f"{row}: needs one check of the printed form and one of the right one")
            continue
        for claim, other in ((printed[0], right[0]), (right[0], printed[0])):
            try:
                failure = verdict_on(claim, other.value)
            except (TypeError, ValueError) as error:
                problems.append(f"{row}: '{claim.name}' and '{other.name}' do not compare: {error}")
            else:
                if not failure:
                    problems.append(f"{row}: '{claim.name}' holds for the other form as well")
    return problems


if __name__ == "__main__":
    path = Path(sys.argv[1])
    content = read_notebook(path)
    print(json.dumps(swaps(content, run(content, path.parent), read_ledger())))
