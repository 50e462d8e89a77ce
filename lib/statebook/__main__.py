"""Command line: ``python -m statebook new NAME``."""

import sys
from collections.abc import Sequence
from pathlib import Path

from statebook.analysis.new import new_notebook

_USAGE = "usage: python -m statebook new NAME    write analyses/NAME.ipynb, to analyse a model in"


def main(arguments: Sequence[str]) -> int:
    """Run the command line and return the exit code."""
    if len(arguments) != 2 or arguments[0] != "new":
        print(_USAGE, file=sys.stderr)
        return 2
    try:
        path = new_notebook(arguments[1], Path("analyses"))
    except (OSError, ValueError) as error:
        print(f"statebook: {error}", file=sys.stderr)
        return 1
    print(f"wrote {path.as_posix()}; open it in JupyterLab, replace the cell of the model, run all")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
