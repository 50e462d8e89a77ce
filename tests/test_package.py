"""The package as a whole: what importing it costs, and what it offers."""

from __future__ import annotations

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


@pytest.mark.parametrize("name", sb.__all__)
def test_every_public_name_exists(name):
    if name in ("Path", "TimedPath", "time_scale"):
        pytest.importorskip("toppra")
    assert getattr(sb, name) is not None
    assert name in dir(sb)


def test_unknown_name():
    with pytest.raises(AttributeError, match="No statebook attribute no_such_name"):
        _ = sb.no_such_name


def test_offers_public_names_only():
    assert dir(sb) == sorted(sb.__all__)


def test_the_notebook_regression_has_moved_out():
    with pytest.raises(AttributeError, match=r"package nbregress: .*pip install \S*lib/nbregress"):
        _ = sb.regression
    assert "regression" not in sb.__all__ and "regression" not in dir(sb)
    assert run("import sys, statebook.plotting; print('nbregress' in sys.modules)") == "False"


def test_importing_a_room_hides_no_function():
    rooms = "checking, equilibrium, linearization, sampling, sweeping, verdict.stability"
    imports = "".join(f"import statebook.{room}; " for room in rooms.split(", "))
    code = imports + "import statebook as sb; print(sb.stability([[-1.0]]).verdict)"
    assert run(code) == "asymptotically stable"
