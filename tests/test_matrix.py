"""The matrix of interpreters, packages and BLAS kernels: what it plans, chooses and reports."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import pytest

import matrix

ROOT = Path(__file__).resolve().parents[1]


def test_covers_each_python_generation_and_core():
    runs = [run.name for run in matrix.plan(["3.10", "3.11", "3.12", "3.13"], "x86_64")]
    both = [f"3.{minor}-{which}" for which in ("newest", "oldest") for minor in (10, 11, 12, 13)]
    assert runs == [*both, "3.13-newest-haswell", "3.13-newest-nehalem"]
    alone = [run.name for run in matrix.plan(["3.11"], "AMD64")]
    assert alone == ["3.11-newest", "3.11-oldest", "3.11-newest-haswell", "3.11-newest-nehalem"]
    assert [run.core for run in matrix.plan(["3.12", "3.13"], "arm64")] == [""] * 4


def test_takes_the_lower_bounds_of_the_requirements():
    text = "# all\ncontrol>=0.10.2\npytest-xdist>=3.6\nsetuptools>=77\ntoppra>=0.6.3\n"
    pinned = "control==0.10.2\npytest-xdist==3.6\nsetuptools==77.*\ntoppra==0.6.3\n"
    assert matrix.oldest(text) == pinned
    lines = (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines()
    names = [re.match(r"[\w.-]+", line)[0] for line in lines if line and line[0] != "#"]
    constrained = [line.partition("==")[0] for line in matrix.oldest("\n".join(lines)).split()]
    assert constrained == names and {"control", "toppra", "nbval", "pytest", "myst-nb"} < set(names)


def test_chooses_packages_and_kernel_by_environment(monkeypatch):
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Zen")
    monkeypatch.delenv("PIP_CONSTRAINT", raising=False)
    newest, nehalem = matrix.Run("3.12", "newest"), matrix.Run("3.12", "newest", "Nehalem")
    assert {"OPENBLAS_CORETYPE", "PIP_CONSTRAINT"}.isdisjoint(newest.environment())
    assert nehalem.environment()["OPENBLAS_CORETYPE"] == "Nehalem"
    assert nehalem.venv == newest.venv != matrix.Run("3.12", "oldest").venv
    assert matrix.Run("3.12", "oldest").environment()["PIP_CONSTRAINT"].endswith("oldest.txt")


@pytest.mark.skipif(os.name == "nt", reason="makes shell scripts")
def test_leaves_out_an_interpreter_that_does_not_work(tmp_path, monkeypatch):
    """A pyenv shim of a version that is not chosen, one under a wrong name, one that works."""
    this = "{}.{}".format(*sys.version_info)
    others = [version for version in matrix.PYTHONS if version != this]
    for version, body in zip(others, ["exit 127", f'exec "{sys.executable}" "$@"'], strict=False):
        shim = tmp_path / f"python{version}"
        shim.write_text(f"#!/bin/sh\n{body}\n")
        shim.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert matrix.interpreters() == {this: sys.executable}


@pytest.mark.parametrize(
    ("code", "output", "cells", "wrong"),
    [
        (0, ".... [100%]\n412 passed, 3 skipped in 184.20s (0:03:04)\n", "412 0 184", ""),
        (1, "FAILED a::Cell 3\n1 failed, 9 passed in 5.10s\n", "9 1 5", "FAILED a::Cell 3"),
        (1, "ERROR a.py\n1 error in 0.52s\n", "0 1 0", "ERROR a.py"),
        (1, "run.py: the disk is full\n", "0 0 -", "exit code 1 run.py: the disk is full"),
        (5, "no tests ran in 0.01s\n", "0 0 -", "exit code 5 no tests ran in 0.01s"),
    ],
)
def test_reads_the_end_of_a_run(code, output, cells, wrong):
    found = matrix.verdict(matrix.Run("3.12", "newest", "Haswell"), code, output, "Haswell")
    assert [" ".join(words) for words in found] == [cells, wrong]


def test_another_kernel_than_the_chosen_one_is_a_failure():
    found = matrix.verdict(matrix.Run("3.12", "newest", "Haswell"), 0, "3 passed in 2.50s", "Zen")
    assert found[0] == ["3", "0", "2"] and "uses Zen and not Haswell" in found[1][0]


@pytest.mark.parametrize(("code", "expected"), [(0, 0), (1, 1)])
def test_prints_a_table_and_its_exit_code(tmp_path, monkeypatch, capsys, code, expected):
    calls = []

    def execute(run, python, tests):
        calls.append((run.name, tests))
        return (code if run.generation == "oldest" else 0), "7 passed in 1.00s\n"

    monkeypatch.setattr(matrix, "MATRIX", tmp_path)
    monkeypatch.setattr(matrix, "interpreters", lambda: {"3.12": "python3.12"})
    monkeypatch.setattr(matrix, "versions", lambda run: ["-"] * 7)
    monkeypatch.setattr(matrix, "execute", execute)
    assert matrix.main(["3.12-newest", "*-oldest"]) == expected
    assert matrix.main(["3.12-oldest", "--", "tests"]) == expected
    assert [name for name, _ in calls] == ["3.12-newest", "3.12-oldest", "3.12-oldest"]
    assert [tests for _, tests in calls] == [list(matrix.TESTS)] * 2 + [["tests"]]
    printed = capsys.readouterr().out
    assert "python3.10, python3.11, python3.13" in printed
    assert printed.endswith(f"{1 - code} of 1 runs passed\n")


def test_names_its_runs_when_none_fits(monkeypatch, capsys):
    monkeypatch.setattr(matrix, "interpreters", lambda: {"3.12": "python3.12"})
    assert matrix.main(["3.9-*"]) == 2
    assert "there are 3.12-newest, 3.12-oldest" in capsys.readouterr().out
