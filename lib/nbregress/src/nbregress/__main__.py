"""Execute notebooks and store their outputs reproducibly."""

import sys

try:
    import argparse
    import ast
    import os
    from collections.abc import Sequence
    from pathlib import Path
    from typing import Any
except KeyboardInterrupt:
    sys.exit("interrupted: nothing was begun")


def _assignment(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not equals or not name.isidentifier():
        raise argparse.ArgumentTypeError(f"must be NAME=VALUE, got {text}")
    try:
        return name, ast.literal_eval(value)
    except (ValueError, SyntaxError):
        return name, value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="nbregress", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    settings = argparse.ArgumentParser(add_help=False)
    for name, metavar, text in (
        ("rtol", "X", "relative tolerance (default: 1e-5)"),
        ("atol", "X", "absolute tolerance (default: 0)"),
        ("sanitize-with", "FILE", "nbval's sanitizing patterns for texts"),
    ):
        settings.add_argument(f"--{name}", metavar=metavar, help=text)
    common = argparse.ArgumentParser(add_help=False, parents=[settings])
    common.add_argument("files", nargs="+", metavar="FILE", help="a notebook, folder or pattern")
    jobs = "notebooks to run at a time (default: the number of processors)"
    common.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help=jobs)
    common.add_argument("--timeout", metavar="S", help="longest time for one cell (default: 300 s)")
    common.add_argument("--kernel", metavar="NAME", help="kernel to use (default: this Python)")
    parameter: dict[str, Any] = {"type": _assignment, "action": "append", "dest": "parameters"}
    text = "assign this after the cell tagged 'parameters'"
    common.add_argument("--parameter", "-p", metavar="NAME=VALUE", help=text, **parameter)
    text = "write executed copies, leave the originals alone"
    execute = commands.add_parser("execute", parents=[common], help=text)
    execute.add_argument("--output-dir", type=Path, required=True, metavar="DIR")
    text = "execute in place; outputs that agree stay as they are"
    refresh = commands.add_parser("refresh", parents=[common], help=text)
    text = "replace every output, as after a change of style that leaves the data alone"
    refresh.add_argument("--all", action="store_true", help=text)
    text = "write nothing; fail where something would change"
    refresh.add_argument("--check", action="store_true", help=text)
    text = "compare the stored outputs of two notebooks"
    diff = commands.add_parser("diff", parents=[settings], help=text)
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
    try:
        return _run(parser, arguments)
    except KeyboardInterrupt:
        parser.exit(130, "interrupted: what was written is whole, the rest is as it was\n")


def _run(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> int:
    options = parser.parse_args(arguments)
    # Only now: Jupyter's packages take a second to load, too long for --help.
    try:
        from nbregress.batch import find_notebooks, run_all
        from nbregress.store import keep_agreeing, write
        from nbregress.stored import diff
        from nbregress.textdiff import cut
    except ModuleNotFoundError as error:
        missing = (error.name or "nbregress").partition(".")[0]
        if missing == "nbregress":
            raise
        parser.exit(
            1,
            f"{parser.prog} needs the package {missing}, which this Python does not have; "
            f"install it: {sys.executable} -m pip install {missing}\n",
        )
    given = {k: getattr(options, k, None) for k in "rtol atol sanitize_with timeout kernel".split()}
    if options.command == "diff":
        return diff(options.old, options.new, given, options.report)
    if options.jobs < 1:
        parser.error(f"--jobs must be at least 1, got {options.jobs}")
    given["parameters"] = dict(options.parameters) if options.parameters else None
    paths, unknown = find_notebooks(options.files)
    for name in unknown:
        print(f"no notebook is named {name}", file=sys.stderr)
    if options.command == "execute":
        repeated = [p.name for p in paths if [q.name for q in paths].count(p.name) > 1]
        if repeated:
            parser.error(f"two files are named {repeated[0]}; use one --output-dir for each")
        options.output_dir.mkdir(parents=True, exist_ok=True)
    stale: list[Path] = []

    def copy(path: Path, run: Any) -> str:
        write(run.executed, options.output_dir / path.name)
        return "executed"

    def replace(path: Path, run: Any) -> str:
        nb = run.executed
        changed, kept = ["all"], list[str]()
        if not options.all:
            changed, kept = keep_agreeing(run.stored, nb, run.settings)
        names, same = (cut(", ".join(cells)) for cells in (changed, kept))
        if options.check:
            stale.extend([path] if changed else [])
            return f"differs in {names}" if changed else "agrees"
        outcome = "rewritten" if write(nb, path, run.stored) else "unchanged"
        if changed and outcome == "rewritten":
            outcome += f", new outputs: {names}"
        if kept:
            outcome += (
                f" (kept {same}: within the tolerance, or another style of the same figure; --all "
                "replaces them)"
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
