"""Test the chapters on every Python here, with old and new packages and two BLAS kernels.

    python3 run.py test --matrix                    every run
    python3 run.py test --matrix "3.12-*"           the runs whose name fits
    python3 run.py test --matrix -- tests workbook  other arguments for pytest

Each run is `run.py test` by another interpreter, in an environment of its own below
_build/matrix, with its output beside it. Not the full product: each Python with the newest
packages; the first and the last with the oldest that requirements.txt admits; the last with
each OpenBLAS core type. Delete _build/matrix to have newer packages. Standard library only.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MATRIX = ROOT / "_build" / "matrix"
PYTHONS = ("3.10", "3.11", "3.12", "3.13")
GENERATION = ("numpy", "scipy", "matplotlib")
CORES = ("Haswell", "Nehalem")
COLUMNS = "{:<20} {:<8} {:<7} {:<7} {:<11} {:<9} {:>6} {:>6} {:>8}"
HEAD = ("run", "Python", *GENERATION, "core", "passed", "failed", "seconds")

# What an interpreter executes: run.py's job in another environment than .venv; its own path,
# if it can make environments; the versions it finds, while OpenBLAS names its kernel on stderr.
JOB = (
    "import pathlib, run, sys\nrun.VENV = pathlib.Path(sys.argv[1])\n"
    "sys.exit(run.main(['test', *sys.argv[2:]]))"
)
PATH = "import ensurepip, sys, venv; print('%d.%d' % sys.version_info[:2], sys.executable)"
VERSIONS = (
    "import importlib.metadata, json, platform, sys, numpy.linalg, scipy.linalg\n"
    "versions = [importlib.metadata.version(name) for name in sys.argv[1:]]\n"
    "print(json.dumps([platform.python_version(), *versions]))"
)


@dataclass(frozen=True)
class Run:
    """One interpreter with one generation of packages and perhaps one BLAS kernel."""

    version: str
    generation: str
    core: str = ""

    @property
    def name(self) -> str:
        return "-".join(filter(None, (self.version, self.generation, self.core.lower())))

    @property
    def venv(self) -> Path:
        return MATRIX / f"{self.version}-{self.generation}"

    def environment(self) -> dict[str, str]:
        """Return the variables that choose the packages and the kernel."""
        env = {name: value for name, value in os.environ.items() if name != "OPENBLAS_CORETYPE"}
        if self.core:
            env["OPENBLAS_CORETYPE"] = self.core
        if self.generation == "oldest":
            env["PIP_CONSTRAINT"] = str(MATRIX / "oldest.txt")
        return env


def interpreters() -> dict[str, str]:
    """Return the path of each supported Python that works; a dead pyenv shim does not."""
    found = {}
    for version in PYTHONS:
        this = version == "{}.{}".format(*sys.version_info)
        command = sys.executable if this else shutil.which("python" + version)
        if command:
            done = subprocess.run([command, "-c", PATH], capture_output=True, text=True)
            name, _, path = done.stdout.strip().partition(" ")
            if done.returncode == 0 and name == version:
                found[version] = path
    return found


def plan(versions: list[str], machine: str) -> list[Run]:
    """Return the covering set of runs, in the order in which they happen."""
    runs = [Run(version, "newest") for version in versions]
    runs += [Run(version, "oldest") for version in dict.fromkeys([versions[0], versions[-1]])]
    if machine.lower() in ("x86_64", "amd64"):
        runs += [Run(versions[-1], "newest", core) for core in CORES]
    return runs


def oldest(requirements: str) -> str:
    """Return pip constraints to the lower bounds of the numerical packages."""
    pattern = rf"^({'|'.join(GENERATION)})>=(\S+)$"
    return "".join(f"{n}=={v}\n" for n, v in re.findall(pattern, requirements, re.MULTILINE))


def inspect(run: Run) -> tuple[list[str], str]:
    """Return the versions of Python and packages, and the BLAS kernel that is really in use."""
    python = run.venv / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    env = {**run.environment(), "OPENBLAS_VERBOSE": "2"}
    command = [str(python), "-c", VERSIONS, *GENERATION]
    done = subprocess.run(command, capture_output=True, text=True, env=env, check=True)
    cores = sorted(set(re.findall(r"^Core: (\w+)", done.stderr, re.MULTILINE)))
    return json.loads(done.stdout), "/".join(cores) or "-"


def execute(run: Run, python: str, arguments: list[str]) -> tuple[int, str]:
    """Run the tests, with the output in a log and pip's progress shown; return code and output."""
    lines = []
    with (MATRIX / f"{run.name}.log").open("w", encoding="utf-8") as log:
        with subprocess.Popen(
            [python, "-c", JOB, str(run.venv), *arguments],
            **{"cwd": ROOT, "env": run.environment(), "encoding": "utf-8", "errors": "replace"},
            **{"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT},
        ) as process:
            for line in process.stdout or ():
                log.write(line)
                log.flush()
                lines.append(line)
                if line.startswith("  installing"):
                    print(line, end="", flush=True)
    return process.returncode, "".join(lines)


def result(run: Run, code: int, output: str, core: str) -> tuple[list[str], list[str]]:
    """Return the cells passed, failed and seconds, and a line for each thing that is wrong."""
    summary = re.findall(r"^.*\d+ \w+.* in [\d.]+s\b.*$", output, re.MULTILINE)
    counts = dict.fromkeys(("passed", "failed", "error"), 0)
    for number, kind in re.findall(r"(\d+) (passed|failed|error)", "".join(summary[-1:])):
        counts[kind] += int(number)
    seconds = re.findall(r" in (\d+)\.\d+s", "".join(summary[-1:])) or ["-"]
    wrong = re.findall(r"^(?:FAILED|ERROR) .*$", output, re.MULTILINE)
    if run.core and core != run.core:
        wrong.append(f"OpenBLAS took {core} and not {run.core}: this processor cannot run it")
    if code and not wrong:
        wrong = [f"exit code {code}", *output.strip().splitlines()[-3:]]
    failed = counts["failed"] + counts["error"]
    return [str(counts["passed"]), str(failed), *seconds], wrong


def main(arguments: list[str]) -> int:
    """Do the chosen runs one after the other; return 1 if any failed."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    patterns, tests = arguments[:end] or ["*"], arguments[end + 1 :] or ["workbook", "lib"]
    pythons = interpreters()
    print("Python " + ", ".join(pythons), end="")
    print("".join(f"; no python{v} works here" for v in PYTHONS if v not in pythons), flush=True)
    runs = plan(list(pythons), platform.machine()) if pythons else []
    chosen = [run for run in runs if any(fnmatch(run.name, pattern) for pattern in patterns)]
    if not chosen:
        print("no such run; there are " + ", ".join(run.name for run in runs))
        return 2
    MATRIX.mkdir(parents=True, exist_ok=True)
    text = (ROOT / "requirements.txt").read_text(encoding="utf-8")
    (MATRIX / "oldest.txt").write_text(oldest(text), encoding="utf-8")
    rows, failures = [COLUMNS.format(*HEAD)], 0
    for run in chosen:
        print(f"{run.name}: running, output in {MATRIX / run.name}.log", flush=True)
        code, output = execute(run, pythons[run.version], ["-q", *tests])
        try:
            versions, core = inspect(run)
        except (OSError, subprocess.CalledProcessError):
            versions, core = ["-"] * 4, "-"  # the installation failed, and code says so
        cells, wrong = result(run, code, output, core)
        failures += bool(wrong)
        rows.append(COLUMNS.format(run.name, *versions, core, *cells))
        print("\n  ".join([rows[-1], *wrong]), flush=True)
    print("\n" + "\n".join(rows))
    print(f"{len(chosen) - failures} of {len(chosen)} runs passed")
    return 1 if failures else 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit("interrupted; run the same command again")
