"""Two notebooks compared as they are stored, without executing them."""

import difflib
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nbregress.comparison import Comparison
from nbregress.outputs import outputs_differences
from nbregress.report import write_report
from nbregress.session import NotebookError
from nbregress.settings import SettingsError, load_settings
from nbregress.store import read


def diff(old: Path, new: Path, given: Mapping[str, Any], report: Path | None = None) -> int:
    """Print what differs between the outputs of two notebooks.

    Parameters
    ----------
    old, new : pathlib.Path
    given : mapping
        Settings of the command line.
    report : pathlib.Path, optional
        An HTML page to write.

    Returns
    -------
    status : int
        0 if the outputs of all cells agree, 1 if some do not, 2 if there is nothing to compare.
    """
    try:
        settings = load_settings(new, given)
        before, after = ([c for c in read(p).cells if c.cell_type == "code"] for p in (old, new))
        matcher = difflib.SequenceMatcher(
            a=[c.source for c in before], b=[c.source for c in after], autojunk=False
        )
        found: list[dict[str, Any]] = []
        for _, start, end, first, last in matcher.get_opcodes():
            for k in range(max(end - start, last - first)):
                a = before[start + k] if start + k < end else None
                b = after[first + k] if first + k < last else None
                if a is None or b is None:
                    messages = [f"is only in the {'old' if b is None else 'new'} notebook"]
                else:
                    comparison = Comparison(settings.with_tags(b))
                    messages = outputs_differences(a.outputs, b.outputs, comparison)
                shown = {"messages": messages, "source": (b or a or before[0]).source}
                outputs = [cell.outputs if cell else [] for cell in (a, b)]
                place = {"notebook": str(new), "cell": f"Cell {first + k if b else start + k}"}
                found.append({**place, **shown, "outputs": outputs})
    except (NotebookError, SettingsError) as error:
        print(f"{old}, {new}: {error}", file=sys.stderr)
        return 2
    for cell in found:
        for message in cell["messages"]:
            print(f"{cell['cell']}: {message}")
    if report is not None:
        write_report(report, found, {})
    return int(any(cell["messages"] for cell in found))
