"""Write the site's page "How fast, how exact" from the numbers of one run of test_peers.py.

python benchmarks/page.py             run it first, which takes some minutes
python benchmarks/page.py FILE.json   of a run that was kept
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from typing import Any

PAGE = Path(__file__).resolve().parents[1] / "book" / "speed.md"
ALIKE = 10.0  # errors within this factor of one another, or below
NOTHING = 1e-9  # this, are the same accuracy
# The peers that need not be there, by the module that each one is.
PEERS = {name: name for name in ("heyoka", "nbmake", "nbval", "numba", "toppra")}
PEERS["Drake"] = "pydrake"
SHOWN = ("numpy", "scipy", "control", "toppra", "heyoka", "numba", "drake", "nbval", "nbmake")

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
- A verdict costs what its proof costs: about a third of a millisecond of it is Python, which is all
  of it for four states; for hundreds it is some multiple of `numpy.linalg.eig`.
- `heyoka` and Numba compile the model's own arithmetic; they are what a loop could cost at best.
- TOPP-RA on its own grid is quick and exceeds the limits by the error of its row. Read piece by
  piece of constant acceleration, not through a spline of the times, and on 300 points a waypoint it
  is about as exact as the library: that row's ratio compares like with like.

## Do it again

`pip install ".[benchmark,timescale]"`, then `python benchmarks/page.py`. A peer that is not
installed leaves its rows out and is named above; `numba`, `heyoka` and `drake` are not part of the
extra.
"""

GROWTH = """## How the cost grows

One size after the other, in the same run.
"""

KNEES = """
### Verdicts on other kinds of matrices

```{image} _static/verdicts.png
:alt: Processor time of a verdict (solid) and of numpy.linalg.eig (dashed) against the number of \
states, on logarithmic axes, for seven kinds of matrices. Up to ten states a verdict is flat, at \
half a millisecond or three; from a hundred on it runs beside numpy's lines, two to thirteen \
times above, thirty at a thousand.
```

Drawn by `python benchmarks/verdicts.py cost --figure FILE`: random matrices, a chain of masses, and
five kinds with eigenvectors that are all but parallel, rotated.

- A batch costs what one run does up to about a hundred columns: a step is then the price of calling
  NumPy. From a thousand on the numbers themselves are the cost, and it grows with their count.
- Simulating a chain costs the same from 2 states to 200, for the same reason; from 600 on its own
  product of matrices is the cost. Linearizing one is an array of n columns and n derivatives, flat
  up to some sixty states and beyond as steep as the model: a dense one costs n cubed.
- A verdict is Python's share alone up to some ten states. Beyond, it is products and solutions of
  matrices, whose cost grows with the cube of their size.
- A spline is timed in proportion to its waypoints until the grid is as fine as it gets, at about
  eighty: from there to a thousand the gap grows instead of the time, and the result says so. With
  thousands of waypoints each has a few points of the grid, and time grows with their number again.
- A notebook's first cost is its kernel, some seconds; a cell costs milliseconds.

"""


def alike(one: float, other: float) -> bool:
    """Tell whether two errors are the same accuracy: one that is not known is like no other."""
    if not (math.isfinite(one) and math.isfinite(other)):
        return False
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


def accuracy(row: dict[str, Any]) -> float:
    """Return the error that a benchmark noted, NaN if it noted none."""
    return row["extra_info"].get("accuracy", math.nan)


def error(row: dict[str, Any]) -> str:
    """Return a row's error in words."""
    words = {0.0: "none seen", math.inf: "finds nothing"}
    found = accuracy(row)
    return "not stated" if math.isnan(found) else words.get(found, f"{found:.1e}")


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table of one job, ours first."""
    rows = sorted(rows, key=lambda row: (whose(row) != "ours", row["stats"]["min"]))
    ours = rows[0] if whose(rows[0]) == "ours" else None
    lines = ["| | time | error | ours takes |", "| --- | ---: | ---: | ---: |"]
    for row in rows:
        ratio = ""
        if ours and row is not ours:
            ratio = "not comparable"
            if alike(accuracy(row), accuracy(ours)):
                ratio = f"{ours['stats']['min'] / row['stats']['min']:.2g} times"
        time = duration(row["stats"]["min"])
        lines.append(f"| {whose(row)} | {time} | {error(row)} | {ratio} |")
    return "\n".join(lines)


def growth(rows: list[dict[str, Any]]) -> str:
    """Return the table of one job in growing sizes."""
    lines = ["| size | time | for each | error | growth |", "| ---: | ---: | ---: | ---: | --- |"]
    rows = sorted(rows, key=lambda row: row["extra_info"]["size"])
    for k, row in enumerate(rows):
        size = row["extra_info"]["size"]
        cells = [f"{size:,}", duration(row["stats"]["min"]), duration(row["stats"]["min"] / size)]
        cells.append(error(row))
        before = rows[max(k - 1, 0)]
        larger = size / before["extra_info"]["size"]
        slower = row["stats"]["min"] / before["stats"]["min"]
        cells.append(f"{slower:.2g} times the time, {larger:.2g} times the size" if k else "")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def here(name: str) -> str:
    """Return the version of a package, "" if it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def measured() -> Path:
    """Run the benchmarks, one thread each; return the file of their numbers."""
    if not find_spec("pytest_benchmark"):
        sys.exit('page.py needs pytest-benchmark: pip install ".[benchmark,timescale]"')
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
    absent = sorted(name for name, module in PEERS.items() if not find_spec(module))
    run.update(load=load, absent=absent, versions={name: here(name) for name in SHOWN})
    file.write_text(json.dumps(run), encoding="utf-8")
    return file


def main(path: str | None = None) -> None:
    run = json.loads(Path(path or measured()).read_text(encoding="utf-8"))
    machine = run["machine_info"]
    about = (
        f"Python {machine['python_version']} on {machine['system']}, {machine['machine']},"
        f" {machine['cpu'].get('brand_raw', 'a processor without a name')}, {os.cpu_count()} cores,"
        f" one thread; {', '.join(f'{n} {v}' for n, v in run['versions'].items() if v)};"
        f" {run['datetime'][:10]}."
    )
    if run["absent"]:
        about += f"\n\nNot installed, so without rows here: {', '.join(run['absent'])}."
    if run["load"] > os.cpu_count() / 4:
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
            group = " ".join(group.split())  # sizes are padded, so that they sort as numbers
            text += f"## {group[:1].upper()}{group[1:]}\n\n{table(list(rows))}\n\n"
    PAGE.write_text(text + grown + KNEES + END, encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
