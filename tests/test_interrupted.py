"""Ctrl-C while a command still imports: one sentence, no traceback, nothing written."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# Interrupts where a module is imported, as a key pressed at that moment does.
PRESSED = """
import runpy, sys
class Pressed:
    def find_spec(self, name, *_):
        if name == {name!r}:
            raise KeyboardInterrupt
for name in list(sys.modules):
    if name.split(".")[0] == {name!r}:
        del sys.modules[name]
sys.meta_path.insert(0, Pressed())
del sys.argv[0]
"""
PROGRAM = {
    "nbregress": 'runpy.run_module("nbregress", run_name="__main__", alter_sys=True)',
    "run.py": 'runpy.run_path("run.py", run_name="__main__")',
}


@pytest.mark.parametrize(
    ("program", "name"),
    [
        ("nbregress", "argparse"),
        ("nbregress", "nbregress.batch"),
        ("nbregress", "nbclient"),
        ("nbregress", "zmq"),
        ("run.py", "hashlib"),
        ("run.py", "subprocess"),
        ("run.py", "ensurepip"),
    ],
)
def test_an_interruption_while_it_imports_is_one_sentence(program, name):
    code = PRESSED.format(name=name) + PROGRAM[program]
    command = [sys.executable, "-c", code, program, "refresh", "no_such.ipynb"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode != 0 and done.stdout.strip() == ""
    assert "interrupted" in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr


@pytest.mark.parametrize("module", ["pytest", "statebook.grading.students"])
def test_what_run_py_starts_ends_without_a_traceback(module):
    sys.path.insert(0, str(ROOT))
    try:
        import run
    finally:
        sys.path.remove(str(ROOT))
    code = PRESSED.format(name="argparse").replace("del sys.argv[0]\n", "") + run.MODULE
    command = [sys.executable, "-c", code, module, "anything"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 1 and done.stderr.startswith("interrupted; what"), done.stderr
    assert len(done.stderr.splitlines()) == 1
