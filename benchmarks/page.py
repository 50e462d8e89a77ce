"""Write the site's page "How fast, how exact" from the numbers of one run of test_peers.py.

python benchmarks/page.py             run it first, which takes some minutes
python benchmarks/page.py FILE.json   of a run that was kept
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import Any

PAGE = Path(__file__).resolve().parents[1] / "book" / "speed.md"
ALIKE = 10.0  # errors within this factor of one another, or below
NOTHING = 1e-9  # this, are the same accuracy

TOP = """# How fast, how exact

Each table is one job, done by the library and by its peers in one run on one machine. The error is
that of the result against an exact one. A ratio says how much longer the library takes than its
peer; where their accuracies differ by more than a factor of ten there is none, as such times do not
compare.

{machine}

"""

END = """## What the numbers say

- One small job costs the library more than python-control or SciPy: it asks the model what it can
  do, verifies each derivative, and says what a verdict rests on. These are fixed costs of about a
  millisecond.
- Many jobs at once cost it far less: a batch is one array, and each column keeps its own error.
- `heyoka` and Numba compile the model's own arithmetic; they are what a loop could cost at best.
- TOPP-RA on its own grid is quick and exceeds the limits between its points by the error of its
  row; on 1,000 points it is nearer, and slower.

## Do it again

`pip install ".[benchmark,timescale]"`, then `python benchmarks/page.py`. A peer that is not
installed leaves its rows out; `numba`, `heyoka` and `drake` are not part of the extra.
"""

GROWTH = """## How the cost grows

One size after the other, in the same run.
"""

KNEES = """
- A batch costs what one run does up to about a hundred columns: a step is then the price of calling
  NumPy. From a thousand on the numbers themselves are the cost, and it grows with their count.
- Simulating a chain costs the same from 2 states to 200, for the same reason. Linearizing one is
  an array of n columns and n derivatives, flat up to some sixty states and steep beyond.
- A spline is timed in proportion to its waypoints until the grid is as fine as it gets: beyond, the
  gap grows instead of the time, and the result says so.
- A notebook's first cost is its kernel, some seconds; a cell costs milliseconds.

"""


def alike(one: float, other: float) -> bool:
    """Tell whether two errors are the same accuracy."""
    low, high = sorted((max(one, NOTHING), max(other, NOTHING)))
    return high <= ALIKE * low


def whose(row: dict[str, Any]) -> str:
    """Return who did the job of a row."""
    if "[" in row["name"]:
        return next(v for k, v in row["params"].items() if k == "whose")
    return (
        "ours" if row["name"].endswith("ours") else row["name"].split("_", 2)[2].replace("_", "-")
    )


def duration(seconds: float) -> str:
    """Return a time with three digits and a unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table of one job, ours first."""
    rows = sorted(rows, key=lambda row: (whose(row) != "ours", row["stats"]["min"]))
    ours = rows[0] if whose(rows[0]) == "ours" else None
    lines = ["| | time | error | ours takes |", "| --- | ---: | ---: | ---: |"]
    for row in rows:
        error = row["extra_info"]["accuracy"]
        ratio = ""
        if ours and row is not ours:
            ratio = "not comparable"
            if alike(error, ours["extra_info"]["accuracy"]):
                ratio = f"{ours['stats']['min'] / row['stats']['min']:.2g} times"
        shown = "finds nothing" if error == float("inf") else f"{error:.1e}" if error else ""
        lines.append(f"| {whose(row)} | {duration(row['stats']['min'])} | {shown} | {ratio} |")
    return "\n".join(lines)


def growth(rows: list[dict[str, Any]]) -> str:
    """Return the table of one job in growing sizes."""
    lines = ["| size | time | for each | error | growth |", "| ---: | ---: | ---: | ---: | --- |"]
    rows = sorted(rows, key=lambda row: row["extra_info"]["size"])
    for k, row in enumerate(rows):
        size, error = (row["extra_info"][name] for name in ("size", "accuracy"))
        cells = [f"{size:,}", duration(row["stats"]["min"]), duration(row["stats"]["min"] / size)]
        cells.append(f"{error:.1e}" if error else "")
        before = rows[max(k - 1, 0)]
        larger = size / before["extra_info"]["size"]
        slower = row["stats"]["min"] / before["stats"]["min"]
        cells.append(f"{slower:.2g} times the time, {larger:.2g} times the size" if k else "")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def measured() -> Path:
    """Run the benchmarks, one thread each; return the file of their numbers."""
    file = PAGE.parents[1] / "_build" / "peers.json"
    file.parent.mkdir(exist_ok=True)
    tests = str(Path(__file__).with_name("test_peers.py"))
    options = ["--benchmark-max-time=0.3", "--benchmark-min-rounds=3", f"--benchmark-json={file}"]
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    options += ["-W", "default::pytest.PytestUnraisableExceptionWarning"]  # a peer's leftovers
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", tests, *options]
    subprocess.run(command, env={**os.environ, **one}, check=True, cwd=PAGE.parents[1])
    run = json.loads(file.read_text(encoding="utf-8"))
    run["load"] = load
    file.write_text(json.dumps(run), encoding="utf-8")
    return file


def main(path: str | None = None) -> None:
    run = json.loads(Path(path or measured()).read_text(encoding="utf-8"))
    machine = run["machine_info"]
    names = ("numpy", "scipy", "control", "toppra")
    about = (
        f"Python {machine['python_version']} on {machine['system']}, {machine['machine']},"
        f" {machine['cpu'].get('brand_raw', 'a processor without a name')}, {os.cpu_count()} cores,"
        f" one thread; {', '.join(f'{n} {version(n)}' for n in names)}; {run['datetime'][:10]}."
    )
    if run.get("load", 0.0) > os.cpu_count() / 4:
        about += (
            f"\n\n**The machine was busy with other work** (load {run['load']:.0f} on"
            f" {os.cpu_count()} cores before the run began): compare times of one table only."
        )
    text, grown = TOP.format(machine=about), GROWTH
    by_group = sorted(run["benchmarks"], key=lambda row: row["group"])
    for group, rows in groupby(by_group, key=lambda row: row["group"]):
        if group.startswith("growth: "):
            title = group.removeprefix("growth: ")
            grown += f"\n### {title[:1].upper()}{title[1:]}\n\n{growth(list(rows))}\n"
        else:
            text += f"## {group[:1].upper()}{group[1:]}\n\n{table(list(rows))}\n\n"
    PAGE.write_text(text + grown + KNEES + END, encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
