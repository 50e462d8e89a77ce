"""The bootstrap run.py and the files that it reads: no network, nothing installed."""

import ast
import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
SOURCE = (ROOT / "run.py").read_text(encoding="utf-8")


def notebook(path, *sources, cell_type="code"):
    """Write a notebook of the given cells."""
    cells = [{"cell_type": cell_type, "source": [s], "metadata": {}} for s in sources]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"cells": cells}), encoding="utf-8")


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A run.py of its own, in a folder with a space in its name, that installs nothing."""
    spec = importlib.util.spec_from_file_location("run_under_test", ROOT / "run.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    root = tmp_path / "my copy"
    root.mkdir()
    (root / "requirements.txt").write_text("# core\n\nnumpy>=2.2\ntoppra>=0.6.3\nscipy>=1.15\n")
    for folder in (root, root / "lib" / "nbregress"):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "pyproject.toml").write_text("[project]\n")
    monkeypatch.setattr(module, "ROOT", root)
    monkeypatch.setattr(module, "VENV", root / ".venv")
    monkeypatch.setattr(module, "BUILD", root / "_build")
    module.calls = []
    module.codes = {}

    def make_venv():
        module.calls.append("venv")
        module.venv_python().parent.mkdir(parents=True, exist_ok=True)
        module.venv_python().touch()
        (module.VENV / "statebook-stamp").unlink(missing_ok=True)

    def pip(packages, doing):
        module.calls.append(packages)
        return module.codes.get(doing, 0), "ERROR: no compiler"

    module.real_browser_tools = module.browser_tools
    monkeypatch.setattr(module, "browser_tools", lambda: None)
    monkeypatch.setattr(module, "make_venv", make_venv)
    monkeypatch.setattr(module, "pip", pip)
    return module


def test_old_pythons_parse_run_py():
    ast.parse(SOURCE, feature_version=(3, 6))


def test_run_py_needs_the_standard_library_alone():
    names = set()
    for node in ast.walk(ast.parse(SOURCE)):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module.partition(".")[0])
    assert names <= sys.stdlib_module_names


def test_old_python_is_turned_away(run, monkeypatch):
    monkeypatch.setattr(run.sys, "version_info", (3, 9, 18))
    with pytest.raises(SystemExit, match=r"needs Python 3\.10 or newer and this is Python 3\."):
        run.main(["book"])
    assert run.calls == []


@pytest.mark.parametrize("missing", ["venv", "ensurepip"])
def test_missing_venv_names_the_package(run, monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(SystemExit, match="install the package python3-venv"):
        run.main(["test"])


def test_usage_without_a_job():
    done = subprocess.run([sys.executable, ROOT / "run.py"], capture_output=True, text=True)
    assert done.returncode == 2
    assert all(f"run.py {job}" in done.stdout for job in ("book", "test", "lab", "refresh"))


def test_second_run_installs_nothing(run):
    nbregress = str(run.ROOT / "lib" / "nbregress")
    run.ensure_environment()
    assert run.calls == [
        "venv",
        ["numpy>=2.2", "scipy>=1.15", "--editable", str(run.ROOT), "--editable", nbregress],
        ["toppra>=0.6.3"],
    ]
    run.calls.clear()
    run.ensure_environment()
    assert run.calls == []


@pytest.mark.parametrize(
    "name", ["requirements.txt", "pyproject.toml", "lib/nbregress/pyproject.toml"]
)
def test_changed_file_installs_again_without_a_new_venv(run, name):
    run.ensure_environment()
    run.calls.clear()
    with (run.ROOT / name).open("a") as file:
        file.write("# changed\n")
    run.ensure_environment()
    assert len(run.calls) == 2 and "venv" not in run.calls


def test_moved_folder_or_other_python_makes_a_new_venv(run, monkeypatch):
    run.ensure_environment()
    run.calls.clear()
    monkeypatch.setattr(run.platform, "python_version", lambda: "3.10.1")
    run.ensure_environment()
    assert run.calls[0] == "venv"
    run.calls.clear()
    moved = run.ROOT.with_name("moved")
    run.ROOT.rename(moved)
    monkeypatch.setattr(run, "ROOT", moved)
    monkeypatch.setattr(run, "VENV", moved / ".venv")
    monkeypatch.setattr(run, "BUILD", moved / "_build")
    run.ensure_environment()
    assert run.calls[0] == "venv"


def test_venv_without_its_interpreter_is_made_anew(run):
    run.ensure_environment()
    run.venv_python().unlink()
    run.calls.clear()
    run.ensure_environment()
    assert run.calls[0] == "venv"


@pytest.mark.parametrize("doing", ["installing", "installing toppra"])
def test_interrupted_installation_starts_anew(run, monkeypatch, doing):
    run.ensure_environment()
    (run.ROOT / "requirements.txt").write_text("numpy>=2.3\ntoppra>=0.6.3\n")
    pip = run.pip

    def interrupted(packages, what):
        if what == doing:
            raise KeyboardInterrupt
        return pip(packages, what)

    monkeypatch.setattr(run, "pip", interrupted)
    with pytest.raises(SystemExit, match="interrupted"):
        run.main(["book"])
    monkeypatch.setattr(run, "pip", pip)
    run.calls.clear()
    run.ensure_environment()
    assert run.calls[0] == "venv"


def test_failed_installation_says_why_and_is_repeated(run):
    run.codes["installing"] = 1
    with pytest.raises(SystemExit, match="pip failed with 'no compiler'"):
        run.ensure_environment()
    run.codes.clear()
    run.calls.clear()
    run.ensure_environment()
    assert run.calls[0] == "venv"


def test_goes_on_without_toppra(run, capsys):
    run.codes["installing toppra"] = 1
    run.ensure_environment()
    assert "goes on without it" in capsys.readouterr().out
    run.calls.clear()
    run.ensure_environment()
    assert run.calls == []


@pytest.mark.parametrize(
    ("log", "sentence"),
    [
        ("ERROR: [Errno 28] No space left on device", "the disk is full"),
        (
            "WARNING: Retrying after connection broken by 'NewConnectionError(': Failed to "
            "establish a new connection: [Errno -3] Temporary failure in name resolution')'\n"
            "ERROR: Could not find a version that satisfies the requirement numpy>=2.2\n"
            "ERROR: No matching distribution found for numpy>=2.2",
            "cannot reach the package index",
        ),
        ("ERROR: ReadTimeoutError: HTTPSConnectionPool: Read timed out.", "check the network"),
        ("  error: command 'gcc' failed\nERROR: Failed to build toppra", "Failed to build toppra"),
        ("", "no reason"),
    ],
)
def test_pip_trouble_becomes_one_sentence(run, log, sentence):
    explained = run.explain(log)
    assert sentence in explained and "\n" not in explained


def test_unwritable_folder_is_one_sentence(run, monkeypatch):
    def denied():
        raise PermissionError(13, "Permission denied", "/srv/.venv")

    monkeypatch.setattr(run, "make_venv", denied)
    with pytest.raises(SystemExit, match=r"run\.py: /srv/\.venv: Permission denied"):
        run.main(["book"])


def test_chapters_that_need_toppra_are_skipped_by_name(run, capsys):
    workbook = run.ROOT / "workbook"
    notebook(workbook / "15_by_hand.ipynb", "slow_down = 2")
    notebook(workbook / "15_prose.ipynb", "call `sb.time_scale(path)`", cell_type="markdown")
    notebook(workbook / "16_optimal.ipynb", "timed = sb.time_scale(path, velocity=1)")
    notebook(workbook / "17_imported.ipynb", "import numpy\nimport toppra")
    notebook(workbook / "exercises" / "16_solved.ipynb", "sb.time_scale(path)")
    (workbook / "18_broken.ipynb").write_text("not a notebook")
    runs, left_out = run.notebooks("**/*.ipynb")
    assert runs == [f"workbook/{name}.ipynb" for name in ("15_by_hand", "15_prose", "18_broken")]
    assert left_out == [
        f"workbook/{name}.ipynb" for name in ("16_optimal", "17_imported", "exercises/16_solved")
    ]
    assert capsys.readouterr().out.endswith(": " + ", ".join(left_out) + "\n")
    (run.site_packages() / "toppra").mkdir(parents=True)
    runs, left_out = run.notebooks(run.CHAPTERS)
    assert (len(runs), left_out, capsys.readouterr().out) == (6, [], "")


def test_pytest_gets_the_arguments_and_the_skipped_chapters(run, monkeypatch):
    notebook(run.ROOT / "workbook" / "16_optimal.ipynb", "sb.time_scale(path)")
    monkeypatch.setattr(run, "run", lambda arguments: arguments)
    arguments = run.main(["test", "-k", "pendulum"])
    assert arguments[:2] == ["-m", "pytest"]
    assert arguments[-3:] == ["--ignore=workbook/16_optimal.ipynb", "-k", "pendulum"]
    assert {"--nb", "loadfile"} <= set(arguments)


@pytest.mark.parametrize(
    ("log", "line"),
    [
        ("", "doing [........................] "),
        (
            "[1/4] workbook/00_a.ipynb 2.0 s: executed",
            f"doing [{'#' * 6:.<24}] workbook/00_a.ipynb",
        ),
        ("reading... [ 50%] index\nreading... [100%] last\n", f"doing [{'#' * 24}] last"),
    ],
)
def test_progress_bar(run, log, line):
    assert run.bar("doing")(log) == line


def test_watch_returns_code_and_output(run, monkeypatch, capsys):
    monkeypatch.setattr(run, "venv_python", lambda: Path(sys.executable))
    code, log = run.watch(
        ["-c", "print('[1/2] half'); raise SystemExit(3)"], run.ROOT / "log", run.bar("working")
    )
    assert (code, log.strip()) == (3, "[1/2] half")
    assert re.fullmatch(r"  working \[#{12}\.{12}\] half, \d+ s\n", capsys.readouterr().out)


def test_environment_keeps_figures_and_one_thread(run, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    env = run.environment()
    assert "MPLBACKEND" not in env
    assert (env["OMP_NUM_THREADS"], env["OPENBLAS_NUM_THREADS"]) == ("3", "1")


def test_failing_notebook_is_named_and_the_old_site_stays(run, monkeypatch):
    (run.BUILD / "html").mkdir(parents=True)
    failed = "[2/2] workbook/01_b.ipynb FAILED In [3] (cell 5 of 9): ValueError: wrong"
    log = f"[1/2] workbook/00_a.ipynb 1 s: executed\n{failed}\na notebook failed"
    monkeypatch.setattr(run, "watch", lambda *_: (1, log))
    with pytest.raises(SystemExit) as stop:
        run.book([])
    assert str(stop.value).splitlines() == [
        "run.py: no new site was built, the old one stays",
        failed,
    ]
    assert (run.BUILD / "html").exists()


@pytest.mark.parametrize(
    ("log", "free"),
    [("Traceback ...\nOSError: [Errno 28] No space left on device", 10**9), ("Traceback ...", 0)],
)
def test_full_disk_is_one_sentence(run, monkeypatch, log, free):
    """The log itself may have ended before the reason, as it is on that disk."""
    monkeypatch.setattr(run.shutil, "disk_usage", lambda path: SimpleNamespace(free=free))
    monkeypatch.setattr(run, "watch", lambda *_: (1, log))
    with pytest.raises(SystemExit) as stop:
        run.book([])
    assert str(stop.value).splitlines()[1:] == [
        "the disk is full; .venv and _build take about 1 GB"
    ]


def test_chapters_that_cannot_run_are_skipped_by_the_build(run, monkeypatch):
    notebook(run.ROOT / "workbook" / "15_by_hand.ipynb", "1 + 1")
    notebook(run.ROOT / "workbook" / "16_optimal.ipynb", "sb.time_scale(path)")
    commands = []
    monkeypatch.setattr(run, "watch", lambda command, *_: (commands.append(command), (0, ""))[1])
    assert run.book(["--all"]) == 0
    assert commands[0][0] == "book/build.py"
    assert commands[0][-3:] == ["--all", "--skip", "workbook/16_optimal.ipynb"]


def test_two_runs_of_one_job_do_not_meet(run):
    with run.one_at_a_time("book"):
        with pytest.raises(SystemExit, match=r"another run\.py is busy with this \(book\)"):
            run.book([])
    with run.one_at_a_time("book"):
        pass  # free again


def test_lab_opens_a_copy_that_is_made_once(run, monkeypatch):
    calls = []

    def noted(arguments, cwd=None, output=None):
        calls.append((arguments, cwd))
        if "statebook.grading.students" in arguments:
            notebook(Path(arguments[-1]) / "00_start_here.ipynb", "1")
        return 0

    monkeypatch.setattr(run, "run", noted)
    monkeypatch.setattr(run.os, "geteuid", lambda: 0, raising=False)
    mine = run.ROOT / "mine"
    for _ in range(2):
        assert run.main(["lab", "--no-browser"]) == 0
    made = [arguments for arguments, _ in calls if "statebook.grading.students" in arguments]
    assert made == [["-m", "statebook.grading.students", str(mine)]]
    wanted = ["-m", "jupyterlab", "00_start_here.ipynb", "--allow-root", "--no-browser"]
    assert calls[-1] == (wanted, mine)
    (run.ROOT / "workbook").mkdir()
    run.main(["lab", "workbook"])
    assert calls[-1] == (["-m", "jupyterlab", "--allow-root"], run.ROOT / "workbook")


def test_an_unknown_job_is_told_the_jobs(run, capsys):
    assert run.main(["bogus"]) == 2
    assert "no job 'bogus'; there are book, test, lab" in capsys.readouterr().out


def test_lite_leaves_out_what_no_browser_runs(run, monkeypatch, capsys):
    notebook(run.ROOT / "workbook" / "00_a.ipynb", "1 + 1")
    notebook(run.ROOT / "workbook" / "16_timed.ipynb", "sb.time_scale(path)")
    notebook(run.ROOT / "workbook" / "cases" / "09_many.ipynb", "sb.sweep(f, grid)")
    commands = []
    monkeypatch.setattr(run, "watch", lambda command, *_: (commands.append(command), (0, ""))[1])
    assert run.main(["lite", "--pyodide", "p.tar.bz2"]) == 0
    left_out = ["workbook/16_timed.ipynb", "workbook/cases/09_many.ipynb"]
    assert commands == [["book/lite.py", "--pyodide", "p.tar.bz2", "--skip", *left_out]]
    assert ", ".join(left_out) in capsys.readouterr().out
    assert run.calls[-1] == ["--editable", f"{run.ROOT}[lite]"]
    monkeypatch.setattr(run, "watch", lambda *_: (1, "no wheel"))
    with pytest.raises(SystemExit, match="the old one stays\nno wheel"):
        run.main(["lite"])


def test_a_read_only_checkout_is_tested_without_a_new_driver(run, monkeypatch):
    def read_only(packages, doing):
        raise OSError(30, "Read-only file system", "pip.log")

    monkeypatch.setattr(run, "pip", read_only)
    monkeypatch.setattr(run.subprocess, "call", lambda *_, **__: 0)
    run.real_browser_tools()


@pytest.mark.parametrize(
    ("who", "arguments"),
    [
        ("students", ["statebook.grading.students", "analyses/mine", "--workbook", "{workbook}"]),
        ("statebook", ["statebook", "new", "car"]),
    ],
)
def test_a_folder_that_cannot_be_written_is_one_sentence(tmp_path, who, arguments):
    (tmp_path / "analyses").touch()  # nobody can write below a file, not even root
    given = [text.format(workbook=ROOT / "workbook") for text in arguments]
    command = [sys.executable, "-m", *given]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 1
    assert re.fullmatch(who + r": \[Errno \d+\] .*analyses.*\n", done.stderr), done.stderr
    assert list(tmp_path.iterdir()) == [tmp_path / "analyses"]


def test_slides_that_cannot_be_written_are_one_sentence(tmp_path, monkeypatch, capsys):
    spec = importlib.util.spec_from_file_location("slides_under_test", ROOT / "book" / "slides.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (tmp_path / "file").touch()
    monkeypatch.setattr(module, "DECKS", tmp_path / "file" / "slides")
    assert module.main(["07"]) == 1
    assert re.fullmatch(r"slides: .*file.* was not written: .*\n", capsys.readouterr().out)


def test_new_writes_and_says_how_to_go_on(run, monkeypatch, capsys):
    monkeypatch.setattr(run, "run", lambda arguments: run.calls.append(arguments) or 0)
    assert run.main(["new", "car.ipynb"]) == 0
    assert run.calls[-1] == ["-m", "statebook", "new", "car.ipynb"]
    assert "run.py refresh analyses/car.ipynb" in capsys.readouterr().out
    monkeypatch.setattr(run, "run", lambda arguments: 1)
    assert run.main(["new"]) == 1
    assert capsys.readouterr().out == ""


def test_students_takes_one_folder(run, monkeypatch, tmp_path):
    monkeypatch.setattr(run, "run", lambda arguments: arguments)
    assert run.main(["students", str(tmp_path / "a")])[-1] == str((tmp_path / "a").resolve())
    for arguments in ([], ["a", "b"]):
        with pytest.raises(SystemExit, match="students takes one folder"):
            run.main(["students", *arguments])


def test_matrix_needs_no_venv_and_gets_its_arguments(run, monkeypatch):
    def call(command):
        with pytest.raises(SystemExit, match=r"another run\.py is busy with this \(matrix\)"):
            run.main(["test", "--matrix"])
        return command

    monkeypatch.setattr(run.subprocess, "call", call)
    command = run.main(["test", "--matrix", "3.12-*"])
    assert command == [sys.executable, str(run.ROOT / "tests" / "matrix.py"), "3.12-*"]
    assert run.calls == []


def test_running_inside_a_stale_venv_is_refused(run, monkeypatch):
    spec = importlib.util.spec_from_file_location("fresh_run", ROOT / "run.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "VENV", Path("/somewhere/.venv"))
    monkeypatch.setattr(module, "sys", SimpleNamespace(prefix="/somewhere/.venv", exit=sys.exit))
    with pytest.raises(SystemExit, match="deactivate it"):
        module.make_venv()


def test_requirements_are_environment_free():
    lines = (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines()
    plain = re.compile(r"[a-z0-9-]+>=\d+(\.\d+)*")
    assert [line for line in lines if line[0] != "#" and not plain.fullmatch(line)] == []


def test_requirements_and_extras_agree():
    """requirements.txt is both packages with the extras that the two commands need."""
    text = (ROOT / "requirements.txt").read_text(encoding="utf-8")
    required = {line for line in text.splitlines() if line[0] != "#"}
    statebook, nbregress = (
        tomllib.loads((ROOT / folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        for folder in ("", "lib/nbregress")
    )
    extras = statebook["optional-dependencies"]
    wanted = {*statebook["dependencies"]}
    # nbregress by itself works with older ones, and with what Python itself has since 3.11.
    own = {name.partition(">")[0] for name in nbregress["dependencies"] if ";" not in name}
    wanted |= {line for line in required if line.partition(">")[0] in own}
    assert own == {line.partition(">")[0] for line in wanted} & own
    for extra in ("timescale", "lab", "test", "site"):
        wanted |= {name for name in extras[extra] if not name.startswith("statebook[")}
    assert required == wanted
    assert "optional-dependencies" not in nbregress
    assert not any("nbregress" in name for names in extras.values() for name in names)


def test_ci_runs_the_command_of_the_readme():
    command = "python3 run.py test"
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    assert script[-1] == command
    assert os.name == "nt" or os.access(ROOT / ".ci" / "run", os.X_OK)
    assert command in (ROOT / "README.md").read_text(encoding="utf-8")
