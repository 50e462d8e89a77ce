"""Press Ctrl-C at random moments of a command, and look at what it leaves. POSIX alone.

    python tests/interrupt.py 5 refresh workbook/07_pendulum.ipynb
    python tests/interrupt.py 5 students DIR
    python tests/interrupt.py 5 test tests/test_angles.py

The command is run.py's. SIGINT goes to all of its processes, as from a keyboard: at moments
spread at random, by --seed, over the time that it takes undisturbed. Then nothing may be half
written (each notebook can be read, and holds what it held or what the whole command writes; no
stray file beside it), no process may be left, no traceback of ours printed; and the command must
work. `test` shows where pytest was, as pytest does.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def start(command: list[str]) -> subprocess.Popen[str]:
    """Start run.py in a session of its own."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    arguments = [sys.executable, "run.py", *command]
    return subprocess.Popen(arguments, cwd=ROOT, start_new_session=True, **pipes)


def left(session: int) -> list[str]:
    """Return the processes of a session that still are there."""
    listed = subprocess.run(["ps", "-s", str(session), "-o", "pid="], capture_output=True)
    return listed.stdout.decode().split()


def held(folders: list[Path]) -> dict[str, str]:
    """Return a digest of each file; a notebook that cannot be read is an error."""
    digests = {}
    for path in sorted(p for folder in folders for p in folder.rglob("*") if p.is_file()):
        if ".pytest_cache" in path.parts or "__pycache__" in path.parts:
            continue
        content = path.read_bytes()
        if path.suffix == ".ipynb":
            json.loads(content)
        digests[str(path)] = hashlib.sha256(content).hexdigest()
    return digests


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("times", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("command", nargs=argparse.REMAINDER)
    options = parser.parse_args()
    command, rng = options.command, random.Random(options.seed)
    folders = [ROOT / "workbook"]
    fresh = Path(command[1]).resolve() if command[0] == "students" else None

    def clear() -> None:
        if fresh is not None:
            shutil.rmtree(fresh, ignore_errors=True)

    def state() -> dict[str, str]:
        return held([*folders, *([fresh.parent] if fresh is not None else [])])

    clear()
    before, began = state(), time.monotonic()
    start(command).communicate()
    seconds, after = time.monotonic() - began, state()
    wrong = 0
    for moment in sorted(rng.uniform(0, seconds) for _ in range(options.times)):
        clear()
        process = start(command)
        try:
            out, err = process.communicate(timeout=moment)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGINT)
            out, err = process.communicate()
        strays, now = left(process.pid), state()
        faults = [f"left running: {strays}"] if strays else []
        if "Traceback" in out + err and command[0] != "test":
            faults.append("a traceback: " + err[-2000:])
        faults += [
            f"another content: {name}"
            for name in now.keys() | before.keys()
            if now.get(name) not in (before.get(name), after.get(name))
        ]
        partly = {name for name in after if after[name] != before.get(name)}
        if fresh is not None and len(partly & now.keys()) not in (0, len(partly)):
            faults.append("a part of the hand-out")
        wrong += bool(faults)
        said = ((err or out).strip().splitlines() or ["nothing"])[-1]
        print(f"{moment:6.2f} of {seconds:.2f} s: {'; '.join(faults) or 'whole'}; it said: {said}")
    clear()
    process = start(command)
    out, err = process.communicate()
    print(f"the next run: exit code {process.returncode}")
    clear()
    return 1 if wrong or process.returncode else 0


if __name__ == "__main__":
    if os.name == "nt":
        sys.exit("a console's Ctrl-C cannot be sent to one process group here: try it by hand")
    sys.exit(main())
