"""Break the packages on purpose, one place at a time, and see who notices.

    python benchmarks/mutation.py --work DIR                              150 mutants of all rooms
    python benchmarks/mutation.py --work DIR --notebooks                  the same, by the chapters
    python benchmarks/mutation.py --work DIR --only statebook/rates.py:31 all mutants of a line

A seeded sample of mutants (a sign, an operator, a comparison, a constant), spread over the rooms
in proportion to their code. Each is run against the unit tests and doctests that reach its line,
fastest first, until one fails; with --notebooks, against the chapters that reach it. Who reaches
what is recorded once, under coverage, and again for a test whose file or reach has changed; what
fails without a mutant is left out. Everything happens in a copy in DIR. Results are in DIR, one
line for each mutant, with the hash of the tree: a run that was interrupted goes on where it
stopped. Of another tree, --again takes over what was caught where the mutated file is the same,
and tries the rest.

Which mutants are drawn depends on the text of their lines alone: the sample stays while code
around it changes. Left out are mutants that cannot matter: of `strict=` in zip, of -1 in
reshape, where NumPy takes any negative length, and of the range of a random draw.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import importlib.util
import json
import multiprocessing
import os
import re
import shutil
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coverage
import psutil
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("lib/statebook", "lib/statebook_exercises", "lib/nbregress/src/nbregress")
PATHS = ("lib", "lib/nbregress/src", "benchmarks")
# Each run has a process of its own; where processes can be forked, these are imported before.
HEAVY = [
    "scipy.signal",
    "control",
    "sympy",
    "matplotlib.pyplot",
    "hypothesis",
    "nbclient",
    "toppra",
]
START = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
PROCESSES: Any = multiprocessing.get_context(START)
# Tests of the project, its site and its commands rather than of the packages.
NOT_UNIT = (
    *("book", "browser", "build", "house", "interrupted", "jupyterlab", "lite", "matrix"),
    *("package", "run", "site", "speed_page", "workbook"),
)
# Makes coverage start in every process that a test starts, and name that test.
STARTUP = "import coverage; coverage.process_startup()\n"
SETTINGS = """[run]
parallel = true
data_file = {folder}/data
include = {copy}/lib/*
context = ${{REACHED_BY-}}
disable_warnings = no-data-collected
"""
SECONDS: Counter[str] = Counter()
FAILED: set[str] = set()

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
    tree = ast.parse(source)
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
            "span": _span(tree, node.lineno),
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

    for node in _mutable(tree):
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
        if name == "args" and _calls(tree, "uniform"):
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


def _span(tree: ast.AST, line: int) -> list[int]:
    """Lines of the statement around a line; of a function's head all its lines.

    Outside of functions there are none: that is executed by whoever imports it first.
    """
    around = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or 0)
    ]
    if not any(isinstance(node, ast.FunctionDef) for node in around):
        return []
    inner = around[-1]  # the walk goes from without to within
    last = inner.end_lineno or 0
    if not isinstance(inner, ast.FunctionDef) and getattr(inner, "body", None):
        last = max(inner.lineno, inner.body[0].lineno - 1)  # type: ignore[attr-defined]
    return list(range(inner.lineno, last + 1))


def _calls(tree: ast.AST, method: str) -> bool:
    """Whether an expression calls a method of this name."""
    function = tree.func if isinstance(tree, ast.Call) else None
    return isinstance(function, ast.Attribute) and function.attr == method


# ---- a plugin of pytest: who reaches a line ----


def _who(test: str) -> str:
    """A test's name; the cells of a notebook are one."""
    notebook = re.match(r"[^:]*\.ipynb", test)
    return notebook[0] if notebook else test


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> None:
    """Tell coverage which test runs, here and in the processes that it starts."""
    running = coverage.Coverage.current()
    if running is not None:
        os.environ["REACHED_BY"] = _who(item.nodeid)
        running.switch_context(_who(item.nodeid))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Keep how long each test takes, and whether it passes."""
    SECONDS[_who(report.nodeid)] += report.duration
    if report.outcome != "passed":
        FAILED.add(_who(report.nodeid))


# ---- the runs ----


def run_here(copy: Path, log: Path, arguments: list[str], kept: Path | None, notebook: str) -> None:
    """Run pytest in this process, or a notebook; under coverage, and keep what was seen."""
    os.chdir(copy)
    with log.open("w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    paths = [str(copy / name) for name in PATHS]
    sys.path[:0] = paths
    sys.dont_write_bytecode = False  # the tests are compiled once
    os.environ.update(REACHED_BY=notebook, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    measured = None
    if kept:
        (kept / "sitecustomize.py").write_text(STARTUP)
        (kept / "settings").write_text(SETTINGS.format(folder=kept, copy=copy))
        os.environ["COVERAGE_PROCESS_START"] = str(kept / "settings")
        os.environ["PYTHONPATH"] += os.pathsep + str(kept)
        measured = coverage.Coverage(config_file=str(kept / "settings"))
        measured.start()
    start = time.perf_counter()
    if notebook:  # not by pytest: nbregress ends kernels before coverage has written
        from nbclient.cli import main as execute

        execute(["--allow-errors", notebook])
        code = 0
        SECONDS[notebook] += time.perf_counter() - start
    else:
        usual = ["-q", "--tb=line", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
        usual += ["-p", "mutation", "-Wignore::pytest.PytestAssertRewriteWarning"]
        code = int(pytest.main([*usual, *arguments]))
    if measured and kept:
        measured.stop()
        measured.save()
        import mutation  # pytest's plugin is not this module

        seen = {"seconds": mutation.SECONDS + SECONDS, "failed": sorted(mutation.FAILED)}
        (kept / "seen.json").write_text(json.dumps(seen), "utf-8")
    sys.exit(code)


class Bench:
    """A copy of the project in which mutants are tried, one at a time."""

    def __init__(self, work: Path, timeout: float) -> None:
        self.work, self.copy, self.timeout = work, work / "copy", timeout
        # A run that was interrupted may have left its mutant behind.
        shutil.rmtree(self.copy, ignore_errors=True)
        left = shutil.ignore_patterns(".git", ".venv", ".*_cache", ".hypothesis", "_build", "*.pyc")
        shutil.copytree(ROOT, self.copy, ignore=left)

    def run(self, arguments: list[str], kept: Path | None = None, notebook: str = "") -> int | None:
        """Exit code of a run of pytest, or of a notebook, in the copy; None where time is up."""
        # What Hypothesis remembers of one mutant must not convict the next.
        shutil.rmtree(self.copy / ".hypothesis", ignore_errors=True)
        given = (self.copy, self.work / "last.log", arguments, kept, notebook)
        process = PROCESSES.Process(target=run_here, args=given)
        process.start()
        try:
            process.join(None if kept else self.timeout)
            return process.exitcode
        finally:
            if process.is_alive():
                for each in psutil.Process(process.pid).children(recursive=True):
                    each.kill()
                process.kill()

    def reach(self, notebooks: bool) -> dict[str, Any]:
        """Which tests, or notebooks, execute the lines of each file, and how long they take."""
        if notebooks:
            groups = {path.as_posix(): [] for path in self._files("workbook", "[0-9]*.ipynb")}
        else:
            doctests = [path.as_posix() for path in self._files("lib", "*.py")]
            tests = [
                path.as_posix()
                for path in self._files("tests", "test_*.py")
                if path.stem.removeprefix("test_") not in NOT_UNIT
            ]
            groups = {"lib": [*doctests, "README.md"], **{test: [test] for test in tests}}
        seconds: dict[str, float] = {}
        lines: dict[str, dict[str, set[str]]] = {}
        for name, arguments in groups.items():
            found = self._recorded(name, arguments)
            if found["failed"]:
                print(
                    f"left out, as they fail or are skipped without a mutant: {found['failed']}",
                    flush=True,
                )
            seconds.update(found["seconds"])
            for file, table in found["lines"].items():
                for line, who in table.items():
                    lines.setdefault(file, {}).setdefault(line, set()).update(who)
        return {"seconds": seconds, "lines": lines}

    def _files(self, folder: str, pattern: str) -> list[Path]:
        return sorted(path.relative_to(self.copy) for path in (self.copy / folder).rglob(pattern))

    def _recorded(self, name: str, arguments: list[str]) -> dict[str, Any]:
        stored = self.work / "reach" / f"{name.replace('/', '+')}.json"
        if stored.exists():
            known: dict[str, Any] = json.loads(stored.read_text("utf-8"))
            if all(digest(self.copy / file) == value for file, value in known["files"].items()):
                return known
        folder = stored.with_suffix("")
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        self.run(arguments, folder, "" if arguments else name)
        found: dict[str, Any] = json.loads((folder / "seen.json").read_text("utf-8"))
        print(f"{name}: {sum(found['seconds'].values()):.0f} s", flush=True)
        measured = coverage.Coverage(data_file=str(folder / "data"), config_file=False)
        measured.combine([str(folder)])
        data = measured.get_data()
        passed = set(found["seconds"]) - set(found["failed"])
        found["lines"] = {}
        for file in sorted(data.measured_files()):
            table = data.contexts_by_lineno(file)
            named = {line: sorted(passed & set(names)) for line, names in table.items()}
            found["lines"][Path(file).relative_to(self.copy).as_posix()] = {
                line: names for line, names in named.items() if names
            }
        files = [name, *arguments, *(file for file, table in found["lines"].items() if table)]
        found["files"] = {f: digest(self.copy / f) for f in files if (self.copy / f).is_file()}
        stored.write_text(json.dumps(found), "utf-8")
        shutil.rmtree(folder)
        return self._recorded(name, arguments)

    def judge(
        self, mutant: dict[str, Any], found: dict[str, Any], budget: float, *options: str
    ) -> dict[str, Any]:
        """Try a mutant on what reaches it, fastest first, as far as the budget of seconds goes."""
        table, seconds = found["lines"].get(mutant["file"], {}), found["seconds"]
        reaching = {name for line in mutant["span"] for name in table.get(str(line), [])}
        if not reaching:  # executed on import: all that use the file may see it
            reaching = {name for names in table.values() for name in names}
        tests, spent = [], 0.0
        for name in sorted(reaching, key=lambda name: (seconds[name], name)):
            spent += seconds[name]
            if not tests or spent <= budget:
                tests.append(name)
        result = {**mutant, "outcome": "unreached", "who": "", "tried": [len(tests), len(reaching)]}
        if not tests:
            return result
        path = self.copy / mutant["file"]
        compiled = Path(importlib.util.cache_from_source(str(path)))
        source = path.read_text("utf-8")
        start = time.monotonic()
        try:
            path.write_text(
                source[: mutant["start"]] + mutant["new"] + source[mutant["end"] :], "utf-8"
            )
            compiled.unlink(missing_ok=True)
            code = self.run(["-x", *options, *tests])
        finally:
            path.write_text(source, "utf-8")
            compiled.unlink(missing_ok=True)
        log = (self.work / "last.log").read_text("utf-8", "replace")
        who = re.search(r"^(FAILED|ERROR) .*", log, re.MULTILINE)
        result["outcome"] = {0: "passed", None: "time-out"}.get(code, "caught")
        result["who"] = who[0][:200] if who else ""
        return {**result, "seconds": round(time.monotonic() - start, 1)}


def drawn(population: list[dict[str, Any]], count: int, seed: int) -> list[dict[str, Any]]:
    """A sample that has of every room as much as is its share of the lines of code."""
    rooms: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
    size: Counter[str] = Counter()
    for mutant in population:
        rooms[_room(mutant)].append(mutant)
    for file, room in {mutant["file"]: _room(mutant) for mutant in population}.items():
        tree = ast.parse((ROOT / file).read_text("utf-8"))
        size[room] += len({node.lineno for node in ast.walk(tree) if isinstance(node, ast.expr)})
    share = {room: count * lines / size.total() for room, lines in size.items()}
    quota = {room: int(part) for room, part in share.items()}
    short = count - sum(quota.values())
    for room in sorted(share, key=lambda room: quota[room] - share[room])[:short]:
        quota[room] += 1

    def rank(mutant: dict[str, Any]) -> bytes:
        return hashlib.sha256(f"{seed} {key(mutant)}".encode()).digest()

    return [m for room in sorted(rooms) for m in sorted(rooms[room], key=rank)[: quota[room]]]


def _room(mutant: dict[str, Any]) -> str:
    """A package, or the folder of statebook's."""
    parts = Path(mutant["file"]).parts
    return "/".join(parts[1:-1][:2])


def digest(path: Path) -> str:
    """Hash of a file; of one that is not there, nothing."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.exists() else ""


def tree_hash() -> str:
    """Hash of the packages and their tests."""
    found = hashlib.sha256()
    for path in sorted(path for name in ("lib", "tests") for path in (ROOT / name).rglob("*.py")):
        found.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return found.hexdigest()[:16]


def key(mutant: dict[str, Any]) -> tuple[str, str, int]:
    """What identifies a mutant while code around it changes."""
    return mutant["file"], mutant["text"], mutant["number"]


def describe(result: dict[str, Any]) -> str:
    """One line on a result."""
    tried = "/".join(map(str, result["tried"]))
    return (
        f"{result['file'].removeprefix('lib/')}:{result['line']}: {result['text']}"
        f" ({result['outcome']}, {tried} tried, {result.get('seconds', 0)} s) {result['who']}"
    )


def report(results: list[dict[str, Any]]) -> None:
    """Print the counts, room by room, and the survivors."""
    rooms = sorted({_room(r) for r in results})
    print(f"{'':30}{'mutants':>10}{'caught':>10}{'time-out':>10}{'survive':>10}")
    for name in (*rooms, ""):
        n = Counter(r["outcome"] for r in results if name in ("", _room(r)))
        counts = (n.total(), n["caught"], n["time-out"], n["passed"] + n["unreached"])
        print(f"{name or 'all':30}" + "".join(f"{count:10}" for count in counts))
    for r in results:
        if r["outcome"] in ("passed", "unreached"):
            print(f"survives: {describe(r)}")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--count", type=int, default=150, help="mutants in the sample")
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample")
    parser.add_argument("--timeout", type=float, default=300.0, help="seconds for one mutant")
    parser.add_argument("--budget", type=float, default=60.0, help="seconds of tests for a mutant")
    parser.add_argument("--notebooks", action="store_true", help="chapters instead of unit tests")
    parser.add_argument("--again", action="store_true", help="try once more what survived")
    parser.add_argument("--only", nargs="+", metavar="FILE:LINE", help="files or lines, below lib")
    parser.add_argument("--work", type=Path, required=True, help="folder for the copy and results")
    options = parser.parse_args()
    work = options.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    tree = tree_hash()
    PROCESSES.set_forkserver_preload([name for name in HEAVY if importlib.util.find_spec(name)])
    bench = Bench(work, options.timeout)
    found = bench.reach(options.notebooks)
    files = [path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py"))]
    population = [m for path in files for m in mutants(path, ROOT)]
    if options.only:
        sample = [m for m in population if _named(m, options.only)]
    else:
        sample = drawn(population, options.count, options.seed)
    stored = work / f"results_{'notebooks' if options.notebooks else 'units'}.jsonl"
    lines = stored.read_text("utf-8").splitlines() if stored.exists() else []
    done: dict[Any, dict[str, Any]] = {}
    for result in map(json.loads, lines):
        kept = result["outcome"] not in ("passed", "unreached")
        kept = kept and result["room"] == digest(ROOT / result["file"])
        if kept if options.again else result["tree"] == tree:
            done[key(result)] = result
    shown = ["--nb"] if options.notebooks else []
    results = []
    with stored.open("a", encoding="utf-8", buffering=1) as file:
        for index, mutant in enumerate(sample, start=1):
            if key(mutant) not in done:
                result = bench.judge(mutant, found, options.budget, *shown)
                done[key(mutant)] = {**result, "tree": tree, "room": digest(ROOT / mutant["file"])}
                file.write(json.dumps(done[key(mutant)]) + "\n")
                print(f"[{index}/{len(sample)}] {describe(result)}", flush=True)
            results.append(done[key(mutant)])
    print(f"{len(sample)} of {len(population)} mutants, seed {options.seed}")
    report(results)


def _named(mutant: dict[str, Any], names: list[str]) -> bool:
    """Whether a mutant is in one of these files or lines."""
    file = mutant["file"].removeprefix("lib/")
    return any(name in (file, f"{file}:{mutant['line']}") for name in names)


if __name__ == "__main__":
    main()
