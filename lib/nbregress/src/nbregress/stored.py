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
        for kind, start, end, first, last in matcher.get_opcodes():
            pairs = list(zip(before[start:end], after[first:last], strict=False))
            for k, (a, b) in enumerate(pairs):
                comparison = Comparison(settings.with_tags(b))
                messages = outputs_differences(a.outputs, b.outputs, comparison)
                found.append(
                    {
                        "notebook": str(new),
                        "cell": f"Cell {first + k}",
                        "source": b.source,
                        "messages": messages,
                        "outputs": [a.outputs, b.outputs],
                    }
                )
            for what, count in (
                ("only in the old", end - start - len(pairs)),
                ("only in the new", last - first - len(pairs)),
            ):
                if kind != "equal" and count > 0:
                    message = f"{count} cells from here on are {what} notebook"
                    found.append(
                        {
                            "notebook": str(new),
                            "cell": f"Cell {first + len(pairs)}",
                            "source": "",
                            "messages": [message],
                            "outputs": [[], []],
                        }
                    )
    except (NotebookError, SettingsError) as error:
        print(f"{old}, {new}: {error}", file=sys.stderr)
        return 2
    for cell in found:
        for message in cell["messages"]:
            print(f"{cell['cell']}: {message}")
    if report is not None:
        write_report(report, found, {})
    return int(any(cell["messages"] for cell in found))
