"""The package as a whole: what importing it costs, and what it offers."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

import statebook as sb


def run(code: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout.strip()


def test_import_loads_nothing_heavy():
    heavy = "{'numpy', 'scipy', 'control', 'toppra', 'matplotlib'}"
    assert run(f"import sys, statebook; print({heavy} & set(sys.modules))") == "set()"


@pytest.mark.parametrize("name", [n for n in sb.__all__ if n != "regression"])
def test_every_public_name_exists(name):
    if name in ("Path", "TimedPath", "time_scale"):
        pytest.importorskip("toppra")
    assert getattr(sb, name) is not None
    assert name in dir(sb)


def test_unknown_name():
    with pytest.raises(AttributeError, match="has no attribute 'no_such_name'"):
        _ = sb.no_such_name


def test_function_wins_over_the_submodule_of_its_name():
    code = "import statebook.stability, statebook as sb; print(sb.stability([[-1.0]]).verdict)"
    assert run(code) == "asymptotically stable"
    assert callable(sb.stability)
    importlib.import_module("statebook.linearize")
    assert callable(sb.linearize)
