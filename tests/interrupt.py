"""Press Ctrl-C at random moments of a command, and look at what it leaves. POSIX alone.

    python tests/interrupt.py 10 refresh workbook/exercises/0*.ipynb
    python tests/interrupt.py 10 book
    python tests/interrupt.py 5 students DIR
    python tests/interrupt.py 5 test workbook/80_primer_eigenvalues.ipynb
    python tests/interrupt.py --kill 5 refresh workbook/exercises/0*.ipynb

The command is run.py's. SIGINT goes to all processes of its group, as from a keyboard: at moments
spread at random, by --seed, over the time that it takes undisturbed. With --kill one of its
processes, drawn at random among those it started (kernels and workers too), is killed instead.

Each time there is work: `refresh` finds notebooks without outputs, `book` two notebooks of the
record gone and three pages to be read again. Then nothing may be half written: a notebook can be
read and holds what it held, or what the whole command writes; the site is the old one or the new
one, file by file; a record can be read; no stray file is left, no process, no traceback of ours.
In the end the command must work. `test` shows where pytest was, as pytest does. Use a clone:
what is refreshed loses its outputs.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MARK = "INTERRUPTED_BY_TEST"  # names a try in the environment of every process that it starts
IGNORED = {".pytest_cache", "__pycache__", ".hypothesis", ".ipynb_checkpoints"}
SITE = ROOT / "_build" / "html"


def start(command: list[str], name: str) -> subprocess.Popen[str]:
    """Start run.py in a group of its own."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    arguments = [sys.executable, "run.py", *command]
    environment = {**os.environ, MARK: name}
    return subprocess.Popen(arguments, cwd=ROOT, start_new_session=True, env=environment, **pipes)


def alive(name: str) -> dict[int, str]:
    """Return the processes of a try that are there, kernels in sessions of their own too."""
    listed = subprocess.run(["ps", "axeww", "-o", "pid,command"], capture_output=True)
    lines = listed.stdout.decode("utf-8", "replace").splitlines()
    found = [line.split() for line in lines if f"{MARK}={name}" in line]
    return {int(words[0]): " ".join(words[1:5]) for words in found}


def left(name: str) -> dict[int, str]:
    """Return what still is there after some seconds: a kernel looks for its parent every one."""
    for _ in range(30):
        if not alive(name):
            return {}
        time.sleep(1)
    return alive(name)


def held(folder: Path) -> dict[str, str]:
    """Return a digest of each file; a notebook that cannot be read is an error."""
    digests = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        if IGNORED.isdisjoint(path.parts):
            content = path.read_bytes()
            if path.suffix == ".ipynb":
                json.loads(content)
            if path.suffix == ".html":  # a page names the version of a style only if it was there
                content = re.sub(rb"\?v=\w+", b"", content)
            if path.name == "searchindex.js":  # Sphinx numbers its words anew each time
                content = content[:16] + content[-1:]
            digests[path.relative_to(folder).as_posix()] = hashlib.sha256(content).hexdigest()
    return digests


class Work:
    """What a command is to do, and what it may leave."""

    def __init__(self, command: list[str]) -> None:
        self.job = command[0]
        self.folder = ROOT / "workbook"
        self.named = [Path(n) for n in command[1:] if self.job == "refresh"]
        if self.job == "book":
            self.folder = SITE
        elif self.job == "students":
            self.folder = Path(command[1]).resolve()

    def prepare(self) -> None:
        """Make that there is something to write."""
        if self.job == "students":
            shutil.rmtree(self.folder, ignore_errors=True)
        for path in self.named:
            notebook = json.loads(path.read_text(encoding="utf-8"))
            for cell in notebook["cells"]:
                if cell["cell_type"] == "code":
                    cell.update(outputs=[], execution_count=None)
            text = json.dumps(notebook, indent=1, ensure_ascii=False, sort_keys=True) + "\n"
            path.write_text(text, encoding="utf-8")
        record = ROOT / "_build" / "executed.json"
        if self.job == "book" and record.is_file():
            kept = json.loads(record.read_text(encoding="utf-8"))
            for name in sorted(kept, key=lambda n: (ROOT / n).stat().st_size)[:2]:
                del kept[name]
            record.write_text(json.dumps(kept), encoding="utf-8")
            for tree in sorted((ROOT / "_build" / "doctrees").glob("*.doctree"))[:3]:
                tree.unlink()

    def faults(self, before: dict[str, str], after: dict[str, str]) -> list[str]:
        """Say what is neither as before nor as after the whole command."""
        now = held(self.folder)
        found = [
            f"another content: {name}"
            for name in sorted(now.keys() | before.keys())
            if now.get(name) not in (before.get(name), after.get(name))
        ]
        if self.job in ("book", "students") and now != before and now != after:
            found.append("a part of the old and a part of the new")
        if self.job == "students":
            names = [p.name for p in self.folder.parent.iterdir() if p != self.folder]
            found += [f"a stray file: {name}" for name in names if name not in self.beside]
        if self.job == "book":
            json.loads((ROOT / "_build" / "executed.json").read_text(encoding="utf-8"))
            held(ROOT / "_build" / "executed")
        return found

    def look(self) -> dict[str, str]:
        """Return what is there, and note what stands beside it."""
        if self.job == "students":
            self.beside = [p.name for p in self.folder.parent.iterdir()]
        return held(self.folder)


def disturb(process: subprocess.Popen[str], name: str, kill: random.Random | None) -> str:
    """Interrupt a try, or kill one of its processes; return what was done."""
    if kill is None:
        os.killpg(process.pid, signal.SIGINT)
        return "Ctrl-C"
    there = alive(name)
    victim = kill.choice([*there][1:] or [process.pid])
    try:
        os.kill(victim, signal.SIGKILL)
    except ProcessLookupError:
        return "too late"
    return "killed " + there.get(victim, "run.py").replace(str(ROOT), "")[:90]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kill", action="store_true")
    parser.add_argument("times", type=int)
    parser.add_argument("command", nargs=argparse.REMAINDER)
    options = parser.parse_args()
    command, rng = options.command, random.Random(options.seed)
    work = Work(command)
    work.prepare()
    before, began = work.look(), time.monotonic()
    start(command, "whole").communicate()
    seconds, after = time.monotonic() - began, held(work.folder)
    wrong = 0
    for moment in sorted(rng.uniform(0, seconds) for _ in range(options.times)):
        work.prepare()
        before, name = work.look(), f"{os.getpid()}_{moment:.3f}"
        process, did = start(command, name), "it was through"
        try:
            out, err = process.communicate(timeout=moment)
        except subprocess.TimeoutExpired:
            did = disturb(process, name, rng if options.kill else None)
            out, err = process.communicate()
        faults = [f"left running: {still}"] if (still := left(name)) else []
        if "Traceback" in out + err and work.job != "test":
            faults.append("a traceback: " + err[-2000:])
        faults += work.faults(before, after)
        wrong += bool(faults)
        said = ((err or out).strip().splitlines() or ["nothing"])[-1]
        print(f"{moment:6.2f} of {seconds:.2f} s, {did}: {'; '.join(faults) or 'whole'}", end="; ")
        print(f"exit code {process.returncode}, it said: {said}", flush=True)
    work.prepare()
    process = start(command, "last")
    out, err = process.communicate()
    same = held(work.folder) == after
    print(f"the next run: exit code {process.returncode}, the result {'' if same else 'NOT '}whole")
    return 1 if wrong or process.returncode or not same else 0


if __name__ == "__main__":
    if os.name == "nt":
        sys.exit("a console's Ctrl-C cannot be sent to one process group here: try it by hand")
    sys.exit(main())
