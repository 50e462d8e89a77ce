"""Break the library on purpose, one place at a time, and see who notices.

    python benchmarks/mutation.py --count 200 --jobs 2 --work DIR
    python benchmarks/mutation.py --only 'verdict/*.py' --tests test_stability.py ... --work DIR

A seeded sample of mutants (a sign, an operator, a comparison, a constant) over the modules
below. Each one is run against the unit tests and doctests that reach its line, and against
the chapters that reach it, as coverage knows them; the two are counted apart. Everything
happens in copies in DIR, one for each job. Results are in DIR/results.jsonl, one line for each
mutant, with the hash of the tree: a run that was interrupted goes on where it stopped, and of
another tree nothing is taken over; --again, after new checks were written, takes over what was
caught before. A room alone, by its own tests and doctests and without chapters, takes --only
and --tests.

The sample depends on the text of the mutated lines alone: the rest of it stays the same while
code around it changes. Left out are mutants that cannot matter: of `strict=` in zip and of -1
in reshape, where NumPy takes any negative length.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import importlib.metadata
import json
import os
import queue
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")

ROOT = Path(__file__).resolve().parents[1]
MODULES = (
    "models/*.py",
    "integration.py",
    "runge_kutta.py",
    "linearization.py",
    "equilibrium.py",
    "derivatives.py",
    "sampling.py",
    "simulation.py",
    "stepping.py",
    "policies.py",
    "trajectory.py",
    "sweeping.py",
    "controllers/*.py",
    "uncertainty/*.py",
    "plotting/*.py",
    "verdict/*.py",
    "timescale/*.py",
)
# Tests of the project rather than of the library.
NOT_UNIT = tuple(f"test_{name}" for name in ("book", "matrix", "package", "run", "workbook"))
COPIED = (
    *("lib", "tests", "workbook", "book", "conftest.py", "pyproject.toml", "README.md"),
    "requirements.txt",
)

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
    seen: Counter[str] = Counter()

    def offset(line: int, column: int) -> int:
        # ast counts columns in UTF-8 bytes.
        return starts[line - 1] + len(lines[line - 1].encode()[:column].decode())

    def mutant(node: ast.expr, start: int, end: int, new: str) -> dict[str, Any]:
        first, last = source.rfind("\n", 0, start) + 1, source.index("\n", end)
        change = f"[{source[start:end]} -> {new or 'nothing'}]"
        text = f"{source[first:start].strip()} {change} {source[end:last].strip()}"
        seen[text] += 1
        return {
            "file": path.relative_to(root).as_posix(),
            "line": node.lineno,
            "text": text,
            "number": seen[text],
            "start": start,
            "end": end,
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
            if isinstance(node, ast.keyword) and node.arg == "strict":
                continue
            if isinstance(node, ast.UnaryOp) and _calls(tree, "reshape"):
                continue
            if isinstance(node, ast.expr):
                yield node
            yield from _mutable(node)


def _calls(tree: ast.AST, method: str) -> bool:
    """Whether an expression calls a method of this name."""
    function = tree.func if isinstance(tree, ast.Call) else None
    return isinstance(function, ast.Attribute) and function.attr == method


class Bench:
    """A copy of the project in which mutants are tried, one at a time."""

    def __init__(self, work: Path, job: int, options: argparse.Namespace) -> None:
        self.whole = work / "whole"
        self.work = work / f"job{job}"
        self.copy = self.work / "copy"
        self.timeout, self.tests, self.only = options.timeout, options.tests, options.only
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
        loaded = any(point.value == "nbregress.plugin" for point in points)
        self.plugin = [] if loaded else ["-p", "nbregress.plugin"]

    def pytest(self, *arguments: str, timeout: float | None = None) -> str:
        """Outcome of a pytest run in the copy: "passed", "failed" or "timeout"."""
        # A chapter's kernel alone imports the package; coverage's warning would be an error.
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
        lib = self.copy / "lib"
        return {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(str, (lib, lib / "nbregress" / "src"))),
            "PYTHONDONTWRITEBYTECODE": "1",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }

    def cover(self, chapter: str | None) -> tuple[str, dict[str, Any]]:
        """Coverage of a chapter, or for None of the unit tests, and the outcome without a mutant.

        A chapter is executed and stored first: it is what a mutant of this library must change.
        """
        arguments = ["--cov=statebook", "--cov-report="]
        if chapter:
            refresh = [sys.executable, "-m", "nbregress", "refresh", chapter]
            subprocess.run(refresh, cwd=self.copy, env=self._environment(), capture_output=True)
            shutil.copy(self.copy / chapter, self.whole / "workbook")
            outcome = self.pytest(*arguments, *self._nbval(), chapter)
        else:
            units = [
                str(path.relative_to(self.copy))
                for path in sorted((self.copy / "tests").glob("test_*.py"))
                if (path.name in self.tests if self.tests else not path.stem.startswith(NOT_UNIT))
            ]
            library = self.copy / "lib" / "statebook"
            sources = [*map(str, chosen(library, self.only))] if self.tests else [str(library)]
            arguments += ["--cov-context=test", "--durations=0", *sources]
            outcome = self.pytest(*arguments, *units)
        report = self.work / "coverage.json"
        command = [sys.executable, "-m", "coverage", "json", "--show-contexts", "-q", "-o"]
        subprocess.run([*command, str(report)], cwd=self.copy, check=True)
        return outcome, json.loads(report.read_text())

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
                tests = sorted(tests, key=lambda name: reach["seconds"].get(name, 0.0))
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


def chosen(library: Path, patterns: Iterable[str]) -> list[Path]:
    """Files of the library that are mutated."""
    return sorted(path for pattern in patterns for path in library.glob(pattern))


def tree_hash() -> str:
    """Hash of the library and its tests."""
    found = hashlib.sha256()
    for path in sorted(path for name in ("lib", "tests") for path in (ROOT / name).rglob("*.py")):
        found.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return found.hexdigest()[:16]


def _plain(context: str) -> str:
    """The test's name in a coverage context; pytest-cov adds the phase."""
    return context.rpartition("|")[0] or context


def each(
    benches: list[Bench], function: Callable[[Bench, T], R], items: Iterable[T]
) -> Iterator[R]:
    """Yield the function's results in order; each bench does one item at a time."""
    free: queue.Queue[Bench] = queue.Queue()
    for bench in benches:
        free.put(bench)

    def call(item: T) -> R:
        bench = free.get()
        try:
            return function(bench, item)
        finally:
            free.put(bench)

    with ThreadPoolExecutor(len(benches)) as pool:
        yield from pool.map(call, items)


def reach(benches: list[Bench], work: Path) -> dict[str, dict[str, Any]]:
    """For each file, its lines with the tests and the chapters that execute them."""
    stored = work / "reach.json"
    if stored.exists():
        known: dict[str, dict[str, Any]] = json.loads(stored.read_text())
        return known
    table: dict[str, dict[str, Any]] = {}
    books = sorted((benches[0].copy / "workbook").glob("[0-9]*.ipynb"))
    books = [] if benches[0].tests else books
    tasks = [None, *(str(book.relative_to(benches[0].copy)) for book in books)]
    found = each(benches, Bench.cover, tasks)
    for chapter, (outcome, data) in zip(tasks, found, strict=True):
        print(f"{chapter or 'unit tests'} without a mutant: {outcome}", flush=True)
        # What fails as it is would convict every mutant.
        if outcome != "passed":
            raise SystemExit("nothing can be said about mutants; see last.log")
        if not chapter:
            log = (benches[0].work / "last.log").read_text()
            times = re.findall(r"^([\d.]+)s call +(\S.*)$", log, re.MULTILINE)
            table["seconds"] = {name: float(seconds) for seconds, name in times}
        for file, lines in data["files"].items():
            entry = table.setdefault(file, {"tests": {}, "chapters": {}})
            if chapter:
                for line in lines["executed_lines"]:
                    entry["chapters"].setdefault(str(line), []).append(chapter)
            else:
                for line, names in lines["contexts"].items():
                    entry["tests"][line] = sorted({_plain(name) for name in names} - {""})
    stored.write_text(json.dumps(table))
    return table


def caught(outcome: str) -> bool:
    """Whether a run noticed the mutant."""
    return outcome in ("failed", "timeout")


def survived(result: dict[str, Any]) -> bool:
    """Whether neither tests nor chapters noticed the mutant."""
    return not (caught(result["tests"]) or caught(result["chapters"]))


def report(results: list[dict[str, Any]]) -> None:
    """Print the counts and the survivors."""
    total = len(results)
    for name, seen in (
        ("caught by the unit tests", [caught(r["tests"]) for r in results]),
        ("caught by the chapters", [caught(r["chapters"]) for r in results]),
        ("caught by either", [not survived(r) for r in results]),
    ):
        print(f"{name}: {sum(seen)} of {total} ({sum(seen) / total:.0%})")
    for r in filter(survived, results):
        print(f"survives: {describe(r)}")


def describe(result: dict[str, Any]) -> str:
    """One line on a result."""
    file = result["file"].removeprefix("lib/statebook/")
    outcome = f"tests {result['tests']}, chapters {result['chapters']}"
    return f"{file}:{result['line']}: {result['text']} ({outcome}, {result['seconds']} s)"


def key(mutant: dict[str, Any]) -> tuple[str, str, int]:
    """What identifies a mutant while code around it changes."""
    return mutant["file"], mutant["text"], mutant["number"]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--count", type=int, default=200, help="mutants in the sample")
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample")
    parser.add_argument("--timeout", type=float, default=120.0, help="seconds for one test run")
    parser.add_argument("--jobs", type=int, default=1, help="mutants tried at the same time")
    parser.add_argument("--again", action="store_true", help="try once more what survived")
    parser.add_argument("--only", nargs="+", default=MODULES, help="files, below lib/statebook")
    parser.add_argument("--tests", nargs="+", help="test files, without the chapters")
    parser.add_argument("--work", type=Path, required=True, help="folder for copies and results")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended"))
    work = options.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    stored = work / "results.jsonl"
    tree, copied = tree_hash(), work / "tree.txt"
    lines = stored.read_text().splitlines() if stored.exists() else []
    found = [json.loads(line) for line in lines]
    latest = {key(result): result for result in found if options.again or result["tree"] == tree}
    results = [result for result in latest.values() if not (options.again and survived(result))]
    if not copied.exists() or copied.read_text() != tree:
        shutil.rmtree(work / "whole", ignore_errors=True)
        (work / "reach.json").unlink(missing_ok=True)
        copied.write_text(tree)
    benches = [Bench(work, job, options) for job in range(options.jobs)]
    reached = reach(benches, work)
    # Now with the outputs of all chapters as they are without a mutant.
    benches = [Bench(work, job, options) for job in range(options.jobs)]
    whole = work / "whole"
    library = whole / "lib" / "statebook"
    files = chosen(library, options.only)
    population = [mutant for path in files for mutant in mutants(path, whole)]

    def rank(mutant: dict[str, Any]) -> bytes:
        return hashlib.sha256(f"{options.seed} {key(mutant)}".encode()).digest()

    sample = sorted(population, key=rank)[: options.count]
    # Of a mutant whose line is gone, or that another seed has drawn, no more is said.
    results = [result for result in results if key(result) in map(key, sample)]
    done = set(map(key, results))
    todo = [mutant for mutant in sample if key(mutant) not in done]
    with stored.open("a", buffering=1) as file:
        judged = each(benches, lambda bench, mutant: bench.judge(mutant, reached), todo)
        for index, result in enumerate(judged, start=1 + len(done)):
            results.append(result)
            file.write(json.dumps({**result, "tree": tree}) + "\n")
            print(f"[{index}/{len(sample)}] {describe(result)}", flush=True)
    print(f"{len(sample)} of {len(population)} mutants, seed {options.seed}")
    report(results)


if __name__ == "__main__":
    main()
