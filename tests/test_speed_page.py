"""The page "How fast, how exact": what it prints, and the ratios that it refuses to print."""

from __future__ import annotations

import importlib.util
import json
import math
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def page(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("page", ROOT / "benchmarks" / "page.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "PAGE", tmp_path / "book" / "speed.md")
    (tmp_path / "book").mkdir()
    return module


def row(name, seconds, error=None, group="a job", **extra):
    info = extra if error is None else {"accuracy": error, **extra}
    return {
        "name": f"test[{name}]", "group": group, "params": {"whose": name},
        "stats": {"min": seconds}, "extra_info": info,
    }  # fmt: skip


def run(rows, **more):
    machine = {"python_version": "3.12", "system": "Linux", "machine": "x86_64", "cpu": {}}
    known = {"machine_info": machine, "datetime": "2026-01-31T00:00", "load": 0.0}
    return {**known, "versions": {"numpy": "2.2", "toppra": ""}, "absent": [], **more} | {
        "benchmarks": rows
    }


def ratio(page, ours, theirs):
    """Return the last cell of the peer's row."""
    text = page.table([row("peer", 1.0, theirs), row("ours", 2.0, ours)])
    return re.search(r"^\| peer \|.*\| (.*) \|$", text, re.MULTILINE)[1]


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [(1e-4, 1e-4), (1e-4, 9e-4), (9e-4, 1e-4), (0.0, 0.0), (0.0, 9e-10), (1e-15, 3e-10)],
)
def test_a_ratio_of_like_accuracies(page, ours, theirs):
    assert ratio(page, ours, theirs) == "2 times"


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (1e-4, 1.1e-3),
        (1.1e-3, 1e-4),
        (0.0, 1.1e-8),
        (0.0, 1.0),
        (1e-3, math.inf),
        (math.inf, math.inf),
        (math.nan, math.nan),
        (1e-3, math.nan),
        (None, None),
        (1e-3, None),
        (None, 1e-3),
    ],
)
def test_no_ratio_of_unlike_or_unknown_accuracies(page, ours, theirs):
    assert ratio(page, ours, theirs) == "not comparable"


def test_what_a_row_says_of_its_error(page):
    found = [page.error(row("ours", 1.0, e)) for e in (0.0, 2e-7, math.inf, math.nan, None)]
    assert found == ["none seen", "2.0e-07", "finds nothing", "not stated", "not stated"]


def test_writes_the_page_with_what_is_absent(page, tmp_path):
    sizes = [row("ours", 1.0, 0.0, "growth: b, by c", size=1)]
    sizes += [row("ours", 3.0, 1e-6, "growth: b, by c", size=1000)]
    rows = [*sizes, row("ours", 2e-3, 1e-3), row("peer", 1e-3, 1e-3)]
    path = tmp_path / "run.json"
    path.write_text(json.dumps(run(rows, absent=["heyoka", "numba"], load=99.0)), encoding="utf-8")
    page.main(str(path))
    text = page.PAGE.read_text(encoding="utf-8")
    assert "Not installed, so without rows here: heyoka, numba." in text
    assert "numpy 2.2; 2026-01-31." in text and "busy with other work** (load 99" in text
    assert "## A job" in text and "| peer | 1 ms | 1.0e-03 | 2 times |" in text
    assert "| 1,000 | 3 s | 3 ms | 1.0e-06 | 3 times the time, 1e+03 times the size |" in text


def test_a_run_names_the_peers_that_are_not_there(page, monkeypatch):
    there = {"pytest_benchmark", "nbval"}
    monkeypatch.setattr(page, "find_spec", lambda name: name in there or None)

    def benchmarks(command, **options):
        file = next(c for c in command if c.startswith("--benchmark-json=")).partition("=")[2]
        Path(file).write_text(json.dumps({"benchmarks": []}), encoding="utf-8")

    monkeypatch.setattr(page.subprocess, "run", benchmarks)
    kept = json.loads(page.measured().read_text(encoding="utf-8"))
    assert kept["absent"] == ["Drake", "heyoka", "nbmake", "numba", "toppra"]
    assert kept["versions"]["numpy"] and "load" in kept
    there.remove("pytest_benchmark")
    with pytest.raises(SystemExit, match=r'needs pytest-benchmark: pip install "\.\[benchmark'):
        page.measured()


def test_the_page_of_the_site_is_of_this_shape(page):
    """Each ratio stands between accuracies that are alike."""
    text = (ROOT / "book" / "speed.md").read_text(encoding="utf-8")
    tables = re.findall(r"^\| ours \|.*\n(?:\|.*\n)*", text, re.MULTILINE)
    found = 0
    for rows in tables:
        cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in rows.splitlines()]
        assert all(len(line) == 4 for line in cells)
        values = [float(c[2]) if re.match(r"\d", c[2]) else 0.0 for c in cells]
        for line, value in zip(cells[1:], values[1:], strict=True):
            if line[3].endswith("times"):
                assert page.alike(values[0], value), line
                found += 1
    assert len(tables) >= 15 and found >= 10
