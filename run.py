#!/usr/bin/env python3
"""Make .venv, install statebook and nbregress and do one job, the same on Linux, macOS and Windows.

    python3 run.py book                     execute what changed, build the site in _build/html;
                                            --all: everything; --pdf: the core path on paper
    python3 run.py test [pytest options]    run every test
    python3 run.py test --matrix            test the chapters on every Python that is here
    python3 run.py lab [FOLDER or FILE]     open JupyterLab on a copy of yours, or on what is named
    python3 run.py refresh [chapter files]  execute committed chapters again, in place
    python3 run.py new NAME                 write analyses/NAME.ipynb, to analyse a model of yours
    python3 run.py slides [NN ...]          make the slides of chapters
    python3 run.py students DIR             write the hand-out, without solutions
    python3 run.py lite                     build a site whose notebooks run in the browser

Standard library only, in syntax that older Pythons parse, so that they can be turned away.
"""

import sys

try:
    import contextlib
    import hashlib
    import json
    import os
    import platform
    import re
    import shutil
    import subprocess
    import time
    from pathlib import Path
except KeyboardInterrupt:
    sys.exit("run.py: interrupted; run the same command again")

ROOT = Path(__file__).resolve().parent
NBREGRESS = Path("lib", "nbregress")  # a package of its own, below ROOT
VENV = ROOT / ".venv"
BUILD = ROOT / "_build"
CHAPTERS = "**/[0-9][0-9]_*.ipynb"
WORKERS = str(min(4, os.cpu_count() or 1))

# What pip prints, and the sentence that tells a reader what to do about it.
PIP_TROUBLES = [
    (r"No space left|Errno 28", "the disk is full; .venv and _build take about 1 GB"),
    (
        r"name resolution|getaddrinfo|NewConnectionError|Timeout|Max retries|ProxyError|SSLError",
        "pip cannot reach the package index; check the network and the proxy and run this again",
    ),
]


def fail(sentence):
    """End with one sentence on stderr and exit code 1."""
    sys.exit("run.py: " + sentence)


def check_python():
    """Turn away a Python that is too old or cannot make virtual environments."""
    if sys.version_info < (3, 10):
        fail(
            "statebook needs Python 3.10 or newer and this is Python %s; "
            "run it with a newer one, such as python3.12" % platform.python_version()
        )
    try:
        import ensurepip  # noqa: F401
        import venv  # noqa: F401
    except ImportError:
        fail(
            "this Python cannot make virtual environments; install the package python3-venv "
            "(Debian, Ubuntu: sudo apt install python3-venv)"
        )


def venv_python():
    """Return the path of .venv's interpreter."""
    return VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def site_packages():
    """Return the folder that .venv's packages are installed in."""
    if os.name == "nt":
        return VENV / "Lib" / "site-packages"
    return VENV / "lib" / ("python%d.%d" % sys.version_info[:2]) / "site-packages"


def requirements():
    """Return the lines of requirements.txt: all but toppra's, and toppra's."""
    text = (ROOT / "requirements.txt").read_text(encoding="utf-8")
    lines = [line.strip() for line in text.splitlines() if line.strip() and line[0] != "#"]
    toppra = [line for line in lines if line.startswith("toppra")]
    return [line for line in lines if line not in toppra], toppra


def ensure_environment():
    """Make or update .venv; do nothing where its stamp says that it is complete.

    The stamp is written last, so an installation that was interrupted starts anew.
    """
    names = ("requirements.txt", "pyproject.toml", NBREGRESS / "pyproject.toml")
    files = b"".join((ROOT / name).read_bytes() for name in names)
    wanted = [platform.python_version(), str(ROOT), hashlib.sha256(files).hexdigest()]
    stamp = VENV / "statebook-stamp"
    found = stamp.read_text(encoding="utf-8").splitlines() if stamp.is_file() else []
    usable = venv_python().exists() and found[:2] == wanted[:2]
    if usable and found == wanted:
        return
    with one_at_a_time("install"):
        install(usable, stamp)
        stamp.write_text("\n".join(wanted), encoding="utf-8")


def install(usable, stamp):
    """Install everything, into a new environment unless this one is usable."""
    if usable:
        stamp.unlink()
    else:
        make_venv()
    others, toppra = requirements()
    folders = ["--editable", str(ROOT), "--editable", str(ROOT / NBREGRESS)]
    code, log = pip([*others, *folders], "installing")
    if code:
        fail(explain(log))
    code, log = pip(toppra, "installing toppra")
    if code:
        print(
            "toppra cannot be installed, and statebook goes on without it: it has wheels for "
            "Linux x86_64 only and needs a C compiler elsewhere (%s)" % explain(log)
        )


def make_venv():
    """Make an empty .venv, whatever stands there."""
    import venv

    if Path(sys.prefix) == VENV:
        fail(".venv must be made anew and is in use; deactivate it and run this again")
    print("making %s for Python %s" % (VENV.name, platform.python_version()), flush=True)
    if VENV.is_symlink() or VENV.is_file():
        VENV.unlink()
    try:
        venv.create(str(VENV), clear=True, symlinks=os.name != "nt", with_pip=True)
    except subprocess.CalledProcessError as error:
        fail("this Python's venv module does not work (%s)" % error)


def pip(packages, doing):
    """Install packages; return pip's exit code and what it printed."""

    def status(log):
        names = re.findall(r"^Installing collected packages: (.*)$", log, re.MULTILINE)
        if not names:
            return "%s: %d packages found" % (doing, log.count("Collecting "))
        new = sum(1 for _ in site_packages().glob("*.dist-info")) - before
        return "%s: %d of %d packages" % (doing, new, names[0].count(",") + 1)

    before = sum(1 for _ in site_packages().glob("*.dist-info"))
    options = ["--disable-pip-version-check", "--no-input", "--progress-bar", "off"]
    return watch(["-m", "pip", "install", *options, *packages], VENV / "pip.log", status)


def explain(log):
    """Return one sentence on why pip failed."""
    for pattern, sentence in PIP_TROUBLES:
        if re.search(pattern, log):
            return sentence
    errors = re.findall(r"^\s*(?:ERROR|error): *(.+)$", log, re.MULTILINE)
    return "pip failed with '%s'; see %s" % ((errors or ["no reason"])[-1], VENV / "pip.log")


def bar(doing):
    """Return a status function that draws the last '[3/18]' or '[ 50%]' of an output."""

    def status(log):
        found = re.findall(r"\[ *(\d+)(?:/(\d+)|%)\] +(\w\S*)", log) or [(0, 1, "")]
        done, total, name = found[-1]
        filled = 24 * int(done) // int(total or 100)
        return "%s [%s] %s" % (doing, ("#" * filled).ljust(24, "."), name)

    return status


def environment():
    """Return the environment of every job.

    One thread each, as notebooks run side by side; and no MPLBACKEND, which would keep
    figures out of executed notebooks.
    """
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    env = {**threads, **os.environ, "PYTHONUTF8": "1"}
    env.pop("MPLBACKEND", None)
    return env


def watch(arguments, log_file, status):
    """Run .venv's Python with its output in a file, showing `status(output)` as it grows.

    On a terminal one line is rewritten; elsewhere a line is added every 10 seconds.
    """
    terminal = sys.stdout.isatty()
    width = shutil.get_terminal_size().columns - 1
    start = shown = time.monotonic()
    command = [str(venv_python()), *arguments]
    with log_file.open("wb") as output:
        process = subprocess.Popen(
            command, cwd=str(ROOT), env=environment(), stdout=output, stderr=subprocess.STDOUT
        )
    try:
        while True:
            ended = process.poll() is not None
            log = log_file.read_text(encoding="utf-8", errors="replace")
            now = time.monotonic()
            line = "  %s, %d s" % (status(log), now - start)
            if terminal:
                print("\r" + line[:width].ljust(width), end="\n" if ended else "", flush=True)
            elif ended or now - shown >= 10:
                print(line, flush=True)
                shown = now
            if ended:
                return process.returncode, log
            time.sleep(0.2)
    finally:
        process.kill()


# A module that is interrupted, perhaps while it still imports, ends without a traceback.
MODULE = """
import sys
try:
    import runpy
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
except KeyboardInterrupt:
    sys.exit("interrupted; what was written is whole")
"""


def run(arguments, cwd=ROOT, output=None):
    """Run .venv's Python in the foreground and return its exit code."""
    if arguments[0] == "-m":
        arguments = ["-c", MODULE, *arguments[1:]]
    command = [str(venv_python()), *arguments]
    process = subprocess.Popen(command, cwd=str(cwd), env=environment(), stdout=output)
    while True:
        try:
            return process.wait()
        except KeyboardInterrupt:
            pass  # pytest and JupyterLab got it too, and end in their own way


TOPPRA = r"time_scale\(|import toppra\b"


def code_has(notebook, pattern):
    """Tell whether a code cell of the notebook holds the pattern, at the beginning of a word."""
    try:
        cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    except (ValueError, KeyError):
        return False  # the job that reads it next has the better message
    code = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")
    return re.search(r"\b(?:%s)" % pattern, code) is not None


def notebooks(pattern):
    """Return the notebooks that can run here and those that want toppra, named on the way."""
    names = sorted(n.relative_to(ROOT).as_posix() for n in (ROOT / "workbook").glob(pattern))
    if (site_packages() / "toppra").is_dir():
        return names, []
    left_out = [name for name in names if code_has(ROOT / name, TOPPRA)]
    if left_out:
        print("not executed, as toppra is not installed: " + ", ".join(left_out), flush=True)
    return [name for name in names if name not in left_out], left_out


@contextlib.contextmanager
def one_at_a_time(job):
    """Hold a lock on the job, which the system frees however this process ends."""
    BUILD.mkdir(exist_ok=True)
    with (BUILD / (job + ".lock")).open("a") as file:
        try:
            if os.name == "nt":
                import msvcrt

                msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
            else:
                import fcntl

                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            fail("another run.py is busy with this (%s); wait until it ends" % job)
        yield


def book(arguments):
    """Execute what changed and build the site; notebooks that cannot run are shown as committed."""
    with one_at_a_time("book"):
        left_out = notebooks(CHAPTERS)[1]
        skip = ["--skip", *left_out] if left_out else []
        command = ["book/build.py", "--jobs", WORKERS, *arguments, *skip]
        code, log = watch(command, BUILD / "book.log", bar("building"))
    if code:
        lines = log.strip().splitlines()
        failed = [line for line in lines if "FAILED" in line]
        pattern, sentence = PIP_TROUBLES[0]
        room = shutil.disk_usage(str(BUILD)).free  # on a full disk the log ends before its reason
        full = [sentence] if re.search(pattern, log) or room < 1e6 else []
        fail("no new site was built, the old one stays\n" + "\n".join(full or failed or lines[-9:]))
    print("open " + (BUILD / "html" / "index.html").as_uri())
    if "--pdf" in arguments:
        print(log.strip().splitlines()[-1])
    return 0


def browser_tools():
    """Install what drives a browser, where there is one; without it those tests are skipped."""
    code = "from paper import find_chromium as f; import importlib.util as i; " + (
        "raise SystemExit(0 if f() and not i.find_spec('playwright') else 1)"
    )
    if subprocess.call([str(venv_python()), "-c", code], cwd=str(ROOT / "book")) == 0:
        with contextlib.suppress(OSError):  # nothing can be installed in a read-only checkout
            pip(["--editable", str(ROOT) + "[browser]"], "installing the driver of a browser")


def test(arguments):
    """Run every test; arguments go to pytest."""
    browser_tools()
    options = ["-n", WORKERS, "--dist", "loadfile", "--no-loadscope-reorder", "--nb"]
    ignored = ["--ignore=" + name for name in notebooks("**/*.ipynb")[1]]
    return run(["-m", "pytest", *options, *ignored, *arguments])


def matrix(arguments):
    """Test the chapters on every Python that is here, in environments below _build."""
    with one_at_a_time("matrix"):
        return subprocess.call([sys.executable, str(ROOT / "tests" / "matrix.py"), *arguments])


def lab(arguments):
    """Open JupyterLab on chapter 00 of a copy that is the reader's own, or on what is named.

    The copy, mine/, is the hand-out: exercises have no solutions. It is made once and kept.
    """
    mine = ROOT / "mine"
    if not arguments or not (ROOT / arguments[0]).exists():
        if not mine.exists():
            code = run(["-m", "statebook.grading.students", str(mine)])
            if code:
                return code
            trusted = [str(path) for path in sorted(mine.rglob("*.ipynb"))]
            run(["-m", "nbformat.sign", *trusted], output=subprocess.DEVNULL)  # players may play
        arguments = ["mine/00_start_here.ipynb", *arguments]
    named = ROOT / arguments[0]
    folder = named if named.is_dir() else named.parent
    first = [] if named.is_dir() else [named.name]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        first.append("--allow-root")  # as in a container, where root is the only user
    return run(["-m", "jupyterlab", *first, *arguments[1:]], cwd=folder)


def refresh(arguments):
    """Execute committed chapters again, in place."""
    files = [str(Path(name).resolve()) for name in arguments] or notebooks(CHAPTERS)[0]
    return run(["-m", "nbregress", "refresh", "--jobs", WORKERS, *files])


def slides(arguments):
    """Make the slide decks of chapters, by their numbers, in _build/slides."""
    return run(["book/slides.py", *arguments])


def lite(arguments):
    """Build a site in _build/lite whose notebooks run in the browser, but toppra's."""
    with one_at_a_time("lite"):
        code, log = pip(["--editable", str(ROOT) + "[lite]"], "installing JupyterLite")
        if code:
            fail(explain(log))
        names = sorted((ROOT / "workbook").glob("**/[0-9]*.ipynb"))
        skip = [n.relative_to(ROOT).as_posix() for n in names if code_has(n, r"sweep\(|" + TOPPRA)]
        print("left out, as a browser has no toppra and no processes: " + ", ".join(skip))
        command = ["book/lite.py", *arguments, "--skip", *skip]
        code, log = watch(command, BUILD / "lite.log", lambda log: "building")
    if code:
        fail("no new site was built, the old one stays\n" + "\n".join(log.splitlines()[-9:]))
    print("serve it, and open http://127.0.0.1:8000/lab/?path=00_start_here.ipynb")
    print("    python3 -m http.server --bind 127.0.0.1 --directory _build/lite")
    return 0


def new(arguments):
    """Write an analysis notebook for a model of the reader's own."""
    code = run(["-m", "statebook", "new", *arguments])
    if code == 0:
        file = "analyses/%s.ipynb" % re.sub(r"\.ipynb$", "", arguments[0])
        jobs = ("lab %s" % file, "refresh %s" % file, "test analyses")
        print("to edit it, store its outputs, and compare them with what was stored:")
        print("\n".join("    python3 run.py " + job for job in jobs))
    return code


def students(arguments):
    """Write chapters and exercises, without their solutions, into a new folder."""
    if len(arguments) != 1:
        fail("students takes one folder, which must be new: python3 run.py students DIR")
    folder = str(Path(arguments[0]).resolve())
    return run(["-m", "statebook.grading.students", folder])


def main(arguments):
    """Do the job that the first argument names and return the exit code."""
    jobs = {f.__name__: f for f in (book, test, lab, refresh, new, slides, students, lite)}
    if not arguments:
        print(__doc__)
        return 2
    if arguments[0] not in jobs:
        print("run.py: there is no job %r; there are %s" % (arguments[0], ", ".join(jobs)))
        return 2
    try:
        check_python()
        if arguments[:2] == ["test", "--matrix"]:
            return matrix(arguments[2:])  # which makes its own environments
        ensure_environment()
        return jobs[arguments[0]](arguments[1:])
    except OSError as error:
        fail("%s: %s" % (error.filename or "the system says", error.strerror or error))
    except KeyboardInterrupt:
        print()  # the message stands on a line of its own, after what a job has drawn
        fail("interrupted; run the same command again")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
