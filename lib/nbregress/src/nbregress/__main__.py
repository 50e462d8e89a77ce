"""Command line: ``nbregress execute|refresh|diff``, or ``python -m nbregress``."""

import argparse
import ast
import os
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def _positive(text: str) -> float:
    value = float(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"must be positive, got {text}")
    return value


def _jobs(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {text}")
    return value


def _assignment(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not equals or not name.isidentifier():
        raise argparse.ArgumentTypeError(f"must be NAME=VALUE, got {text}")
    try:
        return name, ast.literal_eval(value)
    except (ValueError, SyntaxError):
        return name, value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="nbregress", description="Execute notebooks and store their outputs reproducibly."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    settings = argparse.ArgumentParser(add_help=False)
    settings.add_argument("--rtol", type=float, metavar="X", help="relative tolerance")
    settings.add_argument("--atol", type=float, metavar="X", help="absolute tolerance")
    settings.add_argument(
        "--sanitize-with", metavar="FILE", help="nbval's sanitizing patterns for texts"
    )
    common = argparse.ArgumentParser(add_help=False, parents=[settings])
    common.add_argument(
        "files", nargs="+", metavar="FILE", help="an .ipynb file, a folder, or a pattern"
    )
    common.add_argument(
        "--jobs",
        type=_jobs,
        default=os.cpu_count() or 1,
        metavar="N",
        help="notebooks to run at a time (default: the number of processors)",
    )
    common.add_argument(
        "--timeout", type=_positive, metavar="S", help="longest time for one cell (default: 300 s)"
    )
    common.add_argument("--kernel", metavar="NAME", help="kernel to use (default: this Python)")
    common.add_argument(
        "--parameter",
        "-p",
        dest="parameters",
        type=_assignment,
        action="append",
        metavar="NAME=VALUE",
        help="assign this after the cell tagged 'parameters'",
    )
    execute = commands.add_parser(
        "execute", parents=[common], help="write executed copies, leave the originals alone"
    )
    execute.add_argument("--output-dir", type=Path, required=True, metavar="DIR")
    refresh = commands.add_parser(
        "refresh", parents=[common], help="execute in place; outputs that agree stay as they are"
    )
    refresh.add_argument(
        "--all",
        action="store_true",
        help="replace every output, as after a change of style that leaves the data alone",
    )
    refresh.add_argument(
        "--check", action="store_true", help="write nothing; fail where something would change"
    )
    diff = commands.add_parser(
        "diff", parents=[settings], help="compare the stored outputs of two notebooks"
    )
    diff.add_argument("old", type=Path, metavar="A")
    diff.add_argument("new", type=Path, metavar="B")
    diff.add_argument("--report", type=Path, metavar="FILE", help="an HTML page with both")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Default: those of the process.

    Returns
    -------
    status : int
        0 if every notebook ran (and none differs), 1 otherwise.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    # Only now: Jupyter's packages take a second to load, too long for --help.
    try:
        from nbregress.batch import find_notebooks, run_all
        from nbregress.store import keep_agreeing, write
        from nbregress.stored import diff
    except ModuleNotFoundError as error:
        missing = (error.name or "nbregress").partition(".")[0]
        if missing == "nbregress":
            raise
        parser.exit(
            1,
            f"{parser.prog} needs the package {missing}, which this Python does not have; "
            f"install it: {sys.executable} -m pip install {missing}\n",
        )
    given = {
        name: getattr(options, name, None)
        for name in ("rtol", "atol", "sanitize_with", "timeout", "kernel")
    }
    if options.command == "diff":
        return diff(options.old, options.new, given, options.report)
    given["parameters"] = dict(options.parameters) if options.parameters else None
    paths, unknown = find_notebooks(options.files)
    for name in unknown:
        print(f"no notebook is named {name}", file=sys.stderr)
    if options.command == "execute":
        repeated = [name for name, n in Counter(p.name for p in paths).items() if n > 1]
        if repeated:
            parser.error(f"two files are named {repeated[0]}; use one --output-dir for each")
        options.output_dir.mkdir(parents=True, exist_ok=True)
    stale: list[Path] = []

    def copy(path: Path, stored: Any, nb: Any, settings: Any) -> str:
        write(nb, options.output_dir / path.name)
        return "executed"

    def replace(path: Path, stored: Any, nb: Any, settings: Any) -> str:
        changed, kept = (["all"], []) if options.all else keep_agreeing(stored, nb, settings)
        names = ", ".join(changed)
        if options.check:
            stale.extend([path] if changed else [])
            return f"differs in {names}" if changed else "agrees"
        outcome = "rewritten" if write(nb, path) else "unchanged"
        if changed and outcome == "rewritten":
            outcome += f", new outputs: {names}"
        if kept:
            outcome += (
                f" (kept {', '.join(kept)}: within the tolerance, or another style of the same "
                "figure; --all replaces them)"
            )
        return outcome

    finish = copy if options.command == "execute" else replace
    failed = run_all(paths, finish, jobs=options.jobs, given=given)
    for which, what in ((failed, "failed"), (stale, "would change")):
        if which:
            names = ", ".join(map(str, which))
            print(f"{len(which)} of {len(paths)} notebooks {what}: {names}", file=sys.stderr)
    return 1 if failed or stale or unknown else 0


if __name__ == "__main__":
    sys.exit(main())
