"""The house stays as CONTRIBUTING draws it, within its budget, and editors see inside."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import jedi
import numpy as np
import pytest

import house
import statebook as sb

ROOT = Path(__file__).parents[1]
PACKAGES = [ROOT / "lib/statebook", ROOT / "lib/nbregress/src/nbregress"]
BUDGET = {"statebook": 11_540, "nbregress": 2_800}  # statebook: down to 7,500, never up
VALUES = ("METHODS", "controllers", "pi", "plotting")


def drawn_floors() -> list[set[str]]:
    """Return the rooms on each floor of the drawing, from the ground up."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(r"^floor +\d+ \| ([\w/ ]+?) *(?:\||$)", text, re.MULTILINE)
    return [{room.rstrip("/") for room in row.split()} for row in reversed(rows)]


def test_every_room_is_drawn_and_imports_go_down():
    uses = house.rooms(PACKAGES[0])
    floor = {room: level for level, rooms in enumerate(drawn_floors()) for room in rooms}
    assert set(floor) == set(uses)
    upward = [(a, b) for a, others in uses.items() for b in others if floor[b] >= floor[a]]
    assert not upward


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_no_circles_and_no_private_names_across_files(package):
    assert house.circles(package) == []
    assert house.private_names_across(package) == []


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_code_stays_within_its_budget(package):
    assert 0 < sum(map(house.code_lines, package.rglob("*.py"))) <= BUDGET[package.name]


def test_packages_do_not_know_each_other():
    for package, other in (PACKAGES, PACKAGES[::-1]):
        for file in package.rglob("*.py"):
            source = file.read_text(encoding="utf-8")
            assert not re.search(rf"^\s*(import|from) {other.name}\b", source, re.MULTILINE), file


@pytest.mark.parametrize("name", sorted(set(sb.__all__) - set(VALUES)))
def test_an_editor_shows_the_signature(name):
    code = f"import statebook as sb\nsb.{name}("
    signatures = jedi.Script(code).get_signatures(2, len(code.splitlines()[1]))
    assert [signature.name for signature in signatures] == [name]
    assert signatures[0].docstring(raw=True)


def test_a_misspelt_name_is_an_error_to_a_type_checker(tmp_path):
    client = tmp_path / "client.py"
    client.write_text("import statebook as sb\nsb.simulat\nreveal_type(sb.stability)\n")
    command = [sys.executable, "-m", "mypy", "--no-incremental", str(client)]
    result = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert 'has no attribute "simulat"' in result.stdout
    assert "StabilityReport" in result.stdout


@pytest.mark.skipif(
    np.lib.NumpyVersion(np.__version__) < "2.4.0",
    reason="before NumPy 2.4 an array's annotation needs types that later ones know by themselves",
)
def test_both_packages_are_strictly_typed():
    command = [sys.executable, "-m", "mypy"]
    result = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert result.returncode == 0, result.stdout
