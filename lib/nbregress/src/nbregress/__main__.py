"""Command line: ``python -m nbregress execute|refresh``."""

import argparse
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


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m nbregress",
        description="Execute notebooks and store their outputs reproducibly.",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("files", nargs="+", type=Path, metavar="FILE", help="an .ipynb file")
    common.add_argument(
        "--jobs",
        type=_jobs,
        default=os.cpu_count() or 1,
        metavar="N",
        help="notebooks to run at a time (default: the number of processors)",
    )
    common.add_argument(
        "--timeout",
        type=_positive,
        default=300.0,
        metavar="SECONDS",
        help="longest time for one cell (default: 300)",
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
        0 if every notebook ran, 1 otherwise.
    """
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.command == "execute":
        repeated = [name for name, n in Counter(p.name for p in options.files).items() if n > 1]
        if repeated:
            parser.error(f"two files are named {repeated[0]}; use one --output-dir for each")
        options.output_dir.mkdir(parents=True, exist_ok=True)

    # Only now: Jupyter's packages take a second to load, too long for --help.
    try:
        from nbregress.execute import keep_agreeing, read, run_all, write
    except ModuleNotFoundError as error:
        missing = (error.name or "nbregress").partition(".")[0]
        if missing == "nbregress":
            raise
        parser.exit(
            1,
            f"{parser.prog} needs the package {missing}, which this Python does not have; "
            f"install it: {sys.executable} -m pip install {missing}\n",
        )

    def copy(path: Path, nb: Any) -> str:
        write(nb, options.output_dir / path.name)
        return "executed"

    def replace(path: Path, nb: Any) -> str:
        changed, kept = (["all"], []) if options.all else keep_agreeing(read(path), nb)
        outcome = "rewritten" if write(nb, path) else "unchanged"
        if changed and outcome == "rewritten":
            outcome += f", new outputs: {', '.join(changed)}"
        if kept:
            outcome += (
                f" (kept {', '.join(kept)}: within the tolerance, or another style of the same "
                "figure; --all replaces them)"
            )
        return outcome

    failed = run_all(
        options.files,
        copy if options.command == "execute" else replace,
        jobs=options.jobs,
        timeout=options.timeout,
    )
    if failed:
        names = ", ".join(map(str, failed))
        print(f"{len(failed)} of {len(options.files)} notebooks failed: {names}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
