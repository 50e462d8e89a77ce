"""What the code must not do: what one system alone can, or run what a file says."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("lib/statebook", "lib/statebook_exercises", "lib/nbregress/src", "book")
SOURCES = [ROOT / "run.py", *(p for f in FOLDERS for p in sorted((ROOT / f).rglob("*.py")))]
POSIX = {
    *("os.fork os.forkpty os.kill os.killpg os.setsid os.getuid os.geteuid os.getpgid".split()),
    *("os.mkfifo os.nice os.wait os.waitpid os.uname os.getloadavg os.sched_getaffinity".split()),
    *("signal.SIGALRM signal.alarm signal.setitimer signal.SIGKILL signal.SIGHUP".split()),
    *("signal.pause os.sync os.chown os.register_at_fork time.tzset".split()),
    *("signal.SIGUSR1 signal.SIGUSR2 signal.SIGCHLD signal.SIGQUIT signal.SIGTSTP".split()),
    *("signal.SIGSTOP signal.SIGCONT signal.sigwait signal.pthread_kill select.poll".split()),
    *("select.epoll select.kqueue os.getpgrp os.setpgid os.getgid os.setuid os.setgid".split()),
    *("os.getgroups os.statvfs os.mknod os.openpty os.chroot os.pread os.sendfile".split()),
    *("os.posix_spawn os.wait3 os.wait4 os.WNOHANG os.lockf os.getpriority os.fchown".split()),
    *("fcntl grp pwd resource termios pty tty posix syslog".split()),
}
UNSAFE = {
    *("pickle.load pickle.loads pickle.Unpickler marshal.load marshal.loads shelve.open".split()),
    *("cloudpickle.load cloudpickle.loads joblib.load dill.load dill.loads eval exec".split()),
    *("yaml.load yaml.unsafe_load pandas.read_pickle torch.load os.system os.popen".split()),
}
# What measures a wait or an age by these is led astray by a clock that is set.
CLOCKS = {"time.time", "time.time_ns", "datetime.now", "datetime.datetime.now", "os.path.getmtime"}
SHOWN = {"patterns.py": 1}  # whether a date that a notebook printed was that of its day

# A child process reads from its parent's pipe, never from a file.
PIPED = {"sandbox.py": ["cloudpickle.loads", "pickle.load"]}


def guarded(tree: ast.AST) -> set[ast.AST]:
    """Return what stands in a branch or an expression that asks for the system or for the name."""
    asks = ("os.name", "sys.platform", "platform.system", "hasattr(")
    inside: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.If | ast.IfExp | ast.BoolOp):
            test = node.values[0] if isinstance(node, ast.BoolOp) else node.test
            if any(text in ast.unparse(test) for text in asks):
                inside.update(ast.walk(node))
    return inside


def uses(source: str, names: set[str], *, guards: bool = False) -> list[str]:
    """Return where a source uses one of these names, imported or called whole."""
    tree = ast.parse(source)
    skipped = guarded(tree) if guards else set()
    aliases: dict[str, str] = {}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                top = alias.name.split(".")[0]
                aliases[alias.asname or top] = alias.name if alias.asname else top
            texts = [a.name for a in node.names]
        elif isinstance(node, ast.ImportFrom):
            texts = [f"{node.module}.{a.name}" for a in node.names] + [node.module or ""]
        else:
            texts = []
        if isinstance(node, ast.Attribute | ast.Name):
            head, _, rest = ast.unparse(node).partition(".")
            texts = [".".join(filter(None, (aliases.get(head, head), rest)))]
        found += [f"{node.lineno}: {t}" for t in texts if t in names and node not in skipped]
    return found


def allow_pickle(source: str) -> list[str]:
    """Return the calls that let NumPy unpickle."""
    calls = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Call)]
    return [
        f"{call.lineno}: allow_pickle"
        for call in calls
        for k in call.keywords
        if k.arg == "allow_pickle" and not (isinstance(k.value, ast.Constant) and not k.value.value)
    ]


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("import os\nos.fork()", ["2: os.fork"]),
        ("from os import fork", ["1: os.fork"]),
        ("import os as o\no.kill(1, 9)", ["2: os.kill"]),
        ("from signal import SIGALRM as s", ["1: signal.SIGALRM"]),
        ("def f():\n    import fcntl", ["2: fcntl"]),
        ("import os\nif os.name == 'nt':\n    a = 1\nelse:\n    import fcntl", []),
        ("import os\nhasattr(os, 'geteuid') and os.geteuid() == 0", []),
        ("import os\nos.replace(1, 2)", []),
        ("import time\ntime.time()", ["2: time.time"]),
        ("from signal import SIGUSR1, raise_signal", ["1: signal.SIGUSR1"]),
    ],
)
def test_the_search_sees_calls_and_guards(source, found):
    assert uses(source, POSIX | CLOCKS, guards=True) == found


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_no_call_that_only_posix_has_and_nothing_unpickled_or_evaluated(path):
    source = path.read_text(encoding="utf-8")
    assert uses(source, POSIX, guards=True) == []
    unsafe = [text.split()[-1] for text in uses(source, UNSAFE) + allow_pickle(source)]
    assert sorted(unsafe) == PIPED.get(path.name, [])
    assert len(uses(source, CLOCKS)) == SHOWN.get(path.name, 0)
    texts = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Constant)]
    fixed = [t.value for t in texts if isinstance(t.value, str) and t.value.startswith("/tmp")]
    assert fixed == []


# What numpy, scipy, control and the others warn of at their own import is not ours to mend.
IMPORTS = [
    "import statebook; [getattr(statebook, name) for name in statebook.__all__]",
    "import statebook.plotting, statebook.grading, statebook.analysis",
    "import nbregress, nbregress.plugin, nbregress.batch, nbregress.__main__",
]
THEIRS = ["ignore::DeprecationWarning:" + name for name in ("matplotlib", "pyparsing", "dateutil")]


@pytest.mark.parametrize("code", IMPORTS)
def test_imports_warn_of_nothing(code):
    if "__all__" in code:
        pytest.importorskip("toppra")
    ours = [option for text in THEIRS for option in ("-W", text)]
    command = [sys.executable, "-W", "error", *ours, "-c", code]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0 and result.stderr == "", result.stderr


def test_licences_are_listed_of_all_that_we_name():
    """What those bring in turn is listed too, by tests/licences.py; here are our own names."""
    listed = (ROOT / "DEPENDENCIES.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| ([\w.-]+) \| ([^|]+) \|", listed, re.MULTILINE))
    projects = [ROOT / "pyproject.toml", ROOT / "lib" / "nbregress" / "pyproject.toml"]
    text = "\n".join(path.read_text(encoding="utf-8") for path in projects)
    named = {n.lower() for n in re.findall(r'"([A-Za-z][\w.-]*)>=[\d.]+"', text)}
    assert len(named) > 40 and named - rows.keys() == set()
    assert [name for name, licence in rows.items() if licence == "?" or "(not" in licence] == []
