"""Break the library on purpose, one place at a time, and see who notices.

    python benchmarks/mutation.py --count 200 --jobs 2 --work DIR

A seeded sample of mutants (a sign, an operator, a comparison, a constant) over the modules
below. Each one is run against the unit tests and doctests that reach its line, and against
the chapters that reach it, as coverage knows them; the two are counted apart. Everything
happens in copies in DIR, one for each job. A run that was interrupted goes on where it
stopped; results are in DIR/results.jsonl, one line for each mutant.
"""

from __future__ import annotations

import argparse
import ast
import importlib.metadata
import json
import os
import queue
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
MODULES = (
    "models/*.py",
    "integrate.py",
    "runge_kutta.py",
    "amplification.py",
    "linearize/*.py",
    "derivatives.py",
    "discretize/*.py",
    "stability/*.py",
    "timescale/*.py",
)
# Tests of the project rather than of the library.
NOT_UNIT = tuple(f"test_{name}" for name in ("book", "matrix", "package", "regression", "run",
                                             "workbook"))  # fmt: skip
COPIED = ("lib", "tests", "workbook", "book", "pyproject.toml", "README.md", "requirements.txt")

BINARY = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.Pow: ("**", "*"),
}
COMPARE = {
    ast.Lt: ("<", ">="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", "<="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
}


def mutants(path: Path, root: Path) -> Iterator[dict[str, Any]]:
    """Every mutant of a file: the place, and the text to put there."""
    source = path.read_text("utf-8")
    lines = source.splitlines(keepends=True)
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line))

    def offset(line: int, column: int) -> int:
        # ast counts columns in UTF-8 bytes.
        return starts[line - 1] + len(lines[line - 1].encode()[:column].decode())

    def mutant(node: ast.expr, start: int, end: int, new: str) -> dict[str, Any]:
        file = path.relative_to(root).as_posix()
        old = source[start:end]
        return {
            "file": file,
            "line": node.lineno,
            "start": start,
            "end": end,
            "old": old,
            "new": new,
        }

    def between(node: ast.expr, left: ast.expr, right: ast.expr, old: str, new: str) -> Any:
        start = offset(left.end_lineno or 0, left.end_col_offset or 0)
        place = source.find(old, start, offset(right.lineno, right.col_offset))
        return mutant(node, place, place + len(old), new)

    for node in _mutable(ast.parse(source)):
        here = offset(node.lineno, node.col_offset)
        there = offset(node.end_lineno or 0, node.end_col_offset or 0)
        if isinstance(node, ast.BinOp) and type(node.op) in BINARY:
            yield between(node, node.left, node.right, *BINARY[type(node.op)])
        elif isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARE:
            yield between(node, node.left, node.comparators[0], *COMPARE[type(node.ops[0])])
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            yield mutant(node, here, here + 1, "")
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            yield mutant(node, here, here + 3, "")
        elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
            yield mutant(node, here, there, str(not node.value))
        elif isinstance(node, ast.Constant) and isinstance(node.value, int):
            yield mutant(node, here, there, str(node.value + 1))
        elif isinstance(node, ast.Constant) and isinstance(node.value, float):
            yield mutant(node, here, there, repr(2.0 * node.value if node.value else 1.0))


def _mutable(tree: ast.AST) -> Iterator[ast.expr]:
    """Expressions whose value matters: no annotations, messages, docstrings or imports."""
    for name, field in ast.iter_fields(tree):
        if name in ("annotation", "returns", "type_params", "decorator_list"):
            continue
        for node in field if isinstance(field, list) else [field]:
            if not isinstance(node, ast.AST) or isinstance(node, (ast.Raise, ast.JoinedStr)):
                continue
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
                continue
            if isinstance(node, ast.expr):
                yield node
            yield from _mutable(node)


class Bench:
    """A copy of the project in which mutants are tried, one at a time."""

    def __init__(self, work: Path, job: int, timeout: float) -> None:
        self.whole = work / "whole"
        self.work = work / f"job{job}"
        self.copy = self.work / "copy"
        self.timeout = timeout
        if not self.whole.exists():
            ignored = shutil.ignore_patterns("__pycache__", ".*")
            for source in (ROOT / name for name in COPIED):
                if source.is_dir():
                    shutil.copytree(source, self.whole / source.name, ignore=ignored)
                else:
                    shutil.copy(source, self.whole)
        # A run that was interrupted may have left its mutant behind.
        shutil.copytree(self.whole, self.copy, dirs_exist_ok=True)
        points = importlib.metadata.entry_points(group="pytest11")
        loaded = any(point.value == "statebook.regression.plugin" for point in points)
        self.plugin = [] if loaded else ["-p", "statebook.regression.plugin"]

    def pytest(self, *arguments: str, timeout: float | None = None) -> str:
        """Outcome of a pytest run in the copy: "passed", "failed" or "timeout"."""
        # The plugin loads the package before coverage starts; its warning would be an error.
        quiet = "-Wignore::coverage.exceptions.CoverageWarning"
        command = [sys.executable, "-B", "-m", "pytest", "-q", "-p", "no:cacheprovider", quiet]
        # What Hypothesis remembers of one mutant must not convict the next.
        shutil.rmtree(self.copy / ".hypothesis", ignore_errors=True)
        process = subprocess.Popen(
            [*command, "--hypothesis-seed=0", *arguments],
            cwd=self.copy,
            env=self._environment(),
            stdout=(self.work / "last.log").open("w"),
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            code = process.wait(timeout)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return "timeout"
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise
        return "passed" if code == 0 else "failed"

    def _environment(self) -> dict[str, str]:
        return {
            **os.environ,
            "PYTHONPATH": str(self.copy / "lib"),
            "PYTHONDONTWRITEBYTECODE": "1",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }

    def reach(self) -> dict[str, dict[str, Any]]:
        """For each file, its lines with the tests and the chapters that execute them."""
        stored = self.whole.parent / "reach.json"
        if stored.exists():
            result: dict[str, dict[str, Any]] = json.loads(stored.read_text())
            return result
        reach: dict[str, dict[str, Any]] = {}

        failing: list[str] = []

        def add(kind: str, data: dict[str, Any], name: str | None) -> None:
            for file, found in data["files"].items():
                lines = found["contexts"].items() if name is None else found["executed_lines"]
                table = reach.setdefault(file, {"tests": {}, "chapters": {}})[kind]
                for entry in lines:
                    line, names = entry if name is None else (entry, [name])
                    known = table.setdefault(str(line), [])
                    known += [n for n in map(_plain, names) if n and n not in {*known, *failing}]

        units = [
            str(path.relative_to(self.copy))
            for path in sorted((self.copy / "tests").glob("test_*.py"))
            if not path.stem.startswith(NOT_UNIT)
        ]
        report = self.work / "coverage.json"
        cover = ["--cov=statebook", "--cov-report="]
        outcome = self.pytest(*cover, "--cov-context=test", "lib/statebook", *units)
        print(f"unit tests without a mutant: {outcome}", flush=True)
        log = (self.work / "last.log").read_text("utf-8")
        # What fails as it is would convict every mutant.
        failing = re.findall(r"^(?:FAILED|ERROR) (\S+\.py::.+?)(?: - .*)?$", log, re.MULTILINE)
        print("".join(f"left out, as it fails already: {name}\n" for name in failing), end="")
        self._coverage(report)
        add("tests", json.loads(report.read_text()), None)
        for path in sorted((self.copy / "workbook").glob("[0-9]*.ipynb")):
            chapter = str(path.relative_to(self.copy))
            # Outputs of the library as it is now, which are what a mutant must change.
            refresh = [sys.executable, "-m", "statebook.regression", "refresh", chapter]
            subprocess.run(refresh, cwd=self.copy, env=self._environment(), capture_output=True)
            shutil.copy(path, self.whole / "workbook")
            outcome = self.pytest(*cover, *self._nbval(), chapter)
            print(f"{chapter} without a mutant: {outcome}", flush=True)
            if outcome == "passed":
                self._coverage(report)
                add("chapters", json.loads(report.read_text()), chapter)
        stored.write_text(json.dumps(reach))
        return reach

    def _coverage(self, report: Path) -> None:
        command = [sys.executable, "-m", "coverage", "json", "--show-contexts", "-q", "-o"]
        subprocess.run([*command, str(report)], cwd=self.copy, check=True)

    def _nbval(self) -> list[str]:
        return [*self.plugin, "--nbval", "--nbval-current-env"]

    def judge(self, mutant: dict[str, Any], reach: dict[str, dict[str, Any]]) -> dict[str, Any]:
        """Try a mutant on the tests and on the chapters that reach its line."""
        file, line = mutant["file"], str(mutant["line"])
        path = self.copy / file
        source = path.read_text("utf-8")
        table = reach.get(file, {"tests": {}, "chapters": {}})
        tests = table["tests"].get(line, [])
        if not tests:
            # Executed on import (a default, a table): all that use the file may see it.
            tests = sorted({name for names in table["tests"].values() for name in names})
        chapters = table["chapters"].get(line, [])
        start = time.monotonic()
        result = {**mutant, "tests": "unreached", "chapters": "unreached"}
        broken = source[: mutant["start"]] + mutant["new"] + source[mutant["end"] :]
        path.write_text(broken, "utf-8")
        try:
            if tests:
                (self.work / "ids.txt").write_text("\n".join(tests) + "\n")
                ids = f"@{self.work / 'ids.txt'}"
                result["tests"] = self.pytest("-x", ids, timeout=self.timeout)
            if chapters:
                result["chapters"] = self.pytest(
                    "-x",
                    *self._nbval(),
                    f"--nbval-cell-timeout={self.timeout}",
                    *chapters,
                    timeout=self.timeout * len(chapters),
                )
        finally:
            path.write_text(source, "utf-8")
        result["seconds"] = round(time.monotonic() - start, 1)
        return result


def _plain(context: str) -> str:
    """The test's name in a coverage context; pytest-cov adds the phase."""
    return context.rpartition("|")[0] or context


def caught(outcome: str) -> bool:
    """Whether a run noticed the mutant."""
    return outcome in ("failed", "timeout")


def report(results: list[dict[str, Any]]) -> None:
    """Print the counts and the survivors."""
    total = len(results)
    for name, seen in (
        ("caught by the unit tests", [caught(r["tests"]) for r in results]),
        ("caught by the chapters", [caught(r["chapters"]) for r in results]),
        ("caught by either", [caught(r["tests"]) or caught(r["chapters"]) for r in results]),
    ):
        print(f"{name}: {sum(seen)} of {total} ({sum(seen) / total:.0%})")
    for r in results:
        if not (caught(r["tests"]) or caught(r["chapters"])):
            what = f"{r['old']!r} -> {r['new']!r}"
            print(f"survives: {r['file']}:{r['line']}: {what} (tests {r['tests']}, "
                  f"chapters {r['chapters']})")  # fmt: skip


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--count", type=int, default=200, help="mutants in the sample")
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample")
    parser.add_argument("--timeout", type=float, default=120.0, help="seconds for one test run")
    parser.add_argument("--jobs", type=int, default=1, help="mutants tried at the same time")
    parser.add_argument("--work", type=Path, required=True, help="folder for copies and results")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended"))
    options.work.mkdir(parents=True, exist_ok=True)
    first = Bench(options.work.resolve(), 0, options.timeout)
    reach = first.reach()
    benches: queue.Queue[Bench] = queue.Queue()
    benches.put(first)
    for job in range(1, options.jobs):
        benches.put(Bench(options.work.resolve(), job, options.timeout))
    library = first.whole / "lib" / "statebook"
    files = sorted(path for pattern in MODULES for path in library.glob(pattern))
    population = [mutant for path in files for mutant in mutants(path, first.whole)]
    sample = random.Random(options.seed).sample(population, min(options.count, len(population)))
    stored = options.work / "results.jsonl"
    results = (
        [json.loads(line) for line in stored.read_text().splitlines()] if stored.exists() else []
    )
    done = {(r["file"], r["start"], r["new"]) for r in results}
    todo = [m for m in sample if (m["file"], m["start"], m["new"]) not in done]

    def judge(mutant: dict[str, Any]) -> dict[str, Any]:
        bench = benches.get()
        try:
            return bench.judge(mutant, reach)
        finally:
            benches.put(bench)

    with ThreadPoolExecutor(options.jobs) as pool, stored.open("a", buffering=1) as file:
        for index, result in enumerate(pool.map(judge, todo), start=1 + len(sample) - len(todo)):
            results.append(result)
            file.write(json.dumps(result) + "\n")
            print(f"[{index}/{len(sample)}] {result['file']}:{result['line']} {result['old']!r} -> "
                  f"{result['new']!r}: tests {result['tests']}, chapters {result['chapters']}, "
                  f"{result['seconds']} s", flush=True)  # fmt: skip
    print(f"{len(sample)} of {len(population)} mutants, seed {options.seed}")
    report(results)


if __name__ == "__main__":
    main()
