"""Test the chapters on every Python here, with old and new packages and two BLAS kernels.

    python3 run.py test --matrix                    every run
    python3 run.py test --matrix "3.12-*"           the runs whose name fits
    python3 run.py test --matrix -- tests workbook  other arguments for pytest

Each run is `run.py test` by another interpreter, in an environment of its own below
_build/matrix, with its output beside it: each Python with the newest packages and with the
oldest, every lower bound of requirements.txt; the last Python with each OpenBLAS core type.
Delete _build/matrix to have newer packages. Standard library only.
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
PACKAGES = ("numpy", "scipy", "matplotlib", "control", "toppra")
CORES = ("Haswell", "Nehalem")
TESTS = ("workbook", "lib", "README.md")
ROW = "{:<20} {:<8} {:<8} {:<8} {:<11} {:<8} {:<8} {:<9} {:>6} {:>6} {:>8}".format
HEAD = ROW("run", "Python", *PACKAGES, "core", "passed", "failed", "seconds")

# What an interpreter executes: it tells where it is, if it can make environments; it does
# run.py's job in another environment than .venv; it tells its versions.
WHERE = "import ensurepip, sys, venv; print('%d.%d' % sys.version_info[:2], sys.executable)"
JOB = "import pathlib, run, sys; run.VENV = pathlib.Path(sys.argv[1]); "
JOB += "sys.exit(run.main(['test', *sys.argv[2:]]))"
VERSIONS = "import importlib.metadata as m, json, numpy.linalg, platform, scipy.linalg, sys; "
VERSIONS += "has = {d.metadata['Name']: d.version for d in m.distributions()}; "
VERSIONS += "found = [has.get(name, '-') for name in sys.argv[1:]]; "
VERSIONS += "print(json.dumps([platform.python_version(), *found]))"


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
            done = subprocess.run([command, "-c", WHERE], capture_output=True, text=True)
            name, _, path = done.stdout.strip().partition(" ")
            if name == version:
                found[version] = path
    return found


def plan(versions: list[str], machine: str) -> list[Run]:
    """Return the runs, in the order in which they happen."""
    runs = [Run(version, which) for which in ("newest", "oldest") for version in versions]
    if machine.lower() in ("x86_64", "amd64"):
        runs += [Run(version, "newest", core) for version in versions[-1:] for core in CORES]
    return runs


def oldest(requirements: str) -> str:
    """Return pip's constraints to every lower bound; "77" alone means the first 77 there is."""
    bounds = re.findall(r"^([\w.-]+)>=(\S+)$", requirements, re.MULTILINE)
    return "".join(f"{name}=={low}{'' if '.' in low else '.*'}\n" for name, low in bounds)


def execute(run: Run, python: str, tests: list[str]) -> tuple[int, str]:
    """Run the tests with a log, showing what is installed and what is left out."""
    command = [python, "-c", JOB, str(run.venv), "-q", *tests]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    lines = []
    with (
        (MATRIX / f"{run.name}.log").open("w", buffering=1, encoding="utf-8") as log,
        subprocess.Popen(command, cwd=ROOT, env=run.environment(), **streams) as process,
    ):
        for line in process.stdout:
            lines.append(line.decode("utf-8", "replace"))
            log.write(lines[-1])
            if lines[-1].startswith(("  installing", "not executed")):
                print(lines[-1], end="", flush=True)
    return process.returncode, "".join(lines)


def versions(run: Run) -> list[str]:
    """Return the versions of Python and packages, and the BLAS kernel that is really in use."""
    python = run.venv / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if not python.exists():
        return ["-"] * (2 + len(PACKAGES))
    env = {**run.environment(), "OPENBLAS_VERBOSE": "2"}  # which names the kernel on stderr
    command = [python, "-c", VERSIONS, *PACKAGES]
    done = subprocess.run(command, capture_output=True, text=True, env=env)
    cores = sorted(set(re.findall(r"^Core: (\w+)", done.stderr, re.MULTILINE)))
    found = json.loads(done.stdout or "0") or ["-"] * (1 + len(PACKAGES))
    return [*found, "/".join(cores) or "-"]


def verdict(run: Run, code: int, output: str, core: str) -> tuple[list[str], list[str]]:
    """Return the counts passed and failed and the seconds, and a line for all that is wrong."""
    ends = re.findall(r"^.*\d+ \w+.* in [\d.]+s\b.*$", output, re.MULTILINE)
    counts = {"passed": 0, "failed": 0, "error": 0}
    for number, kind in re.findall(r"(\d+) (passed|failed|error)", "".join(ends[-1:])):
        counts[kind] = int(number)
    seconds = re.findall(r" in (\d+)", "".join(ends[-1:])) or ["-"]
    wrong = re.findall(r"^(?:FAILED|ERROR) .*$", output, re.MULTILINE)
    if code and not wrong:
        wrong = [f"exit code {code}", *re.findall(r"^.*\S.*$", output, re.MULTILINE)[-3:]]
    elif run.core not in ("", core):
        wrong.append(f"OpenBLAS uses {core} and not {run.core}, which this processor cannot run")
    return [str(counts["passed"]), str(counts["failed"] + counts["error"]), *seconds], wrong


def main(arguments: list[str]) -> int:
    """Do the chosen runs one after the other; return 1 if any failed."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    names, tests = arguments[:end] or ["*"], arguments[end + 1 :] or list(TESTS)
    pythons = interpreters()
    runs = plan(list(pythons), platform.machine())
    chosen = [run for run in runs if any(fnmatch(run.name, name) for name in names)]
    absent = ["python" + version for version in PYTHONS if version not in pythons]
    if absent:
        print("not here, or not able to make environments: " + ", ".join(absent))
    if not chosen:
        print("no such run; there are " + ", ".join(run.name for run in runs))
        return 2
    MATRIX.mkdir(parents=True, exist_ok=True)
    text = (ROOT / "requirements.txt").read_text(encoding="utf-8")
    (MATRIX / "oldest.txt").write_text(oldest(text), encoding="utf-8")
    rows, failures = [HEAD], 0
    for run in chosen:
        print(f"{run.name}: running, output in {MATRIX / run.name}.log", flush=True)
        code, output = execute(run, pythons[run.version], tests)
        found = versions(run)
        cells, wrong = verdict(run, code, output, found[-1])
        failures += bool(wrong)
        rows.append(ROW(run.name, *found, *cells))
        print("\n  ".join([rows[-1], *wrong]), flush=True)
    print("\n".join(["", *rows]))
    print(f"{len(chosen) - failures} of {len(chosen)} runs passed")
    return 1 if failures else 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(1)  # run.py was interrupted too, and says so
