"""The pytest plugin on small notebooks: what must pass, what must fail, and why."""

import importlib.metadata
import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_notebook, new_output
from processes import in_process

from nbregress.__main__ import main
from nbregress.comparison import Comparison
from nbregress.settings import Settings
from nbregress.trees import figures_differences
from nbregress.values import array_digest

SOURCE = Path(__file__).resolve().parents[2] / "lib" / "nbregress" / "src"
SETUP = """\
import datetime, sys, uuid
import ipywidgets as w
from IPython.display import HTML
import numpy as np
import matplotlib.pyplot as plt
t = np.linspace(0, 10, 1000)
noise = 1 + 1e-13 * np.cos(7 * t)
def curve(y=np.sin(t), label="sine", xlabel="t [s]", **style):
    fig, ax = plt.subplots(**style)
    ax.plot(t, y, label=label)
    ax.set(xlabel=xlabel)
    return fig, ax
"""


FILM = """\
from matplotlib.animation import FuncAnimation
fig, ax = plt.subplots()
(line,) = ax.plot([0, 1])
film = FuncAnimation(fig, lambda k: line.set_data([0, 1], [0, [0, 1, {last}][k]]), frames=3)
plt.close(fig)
HTML(film.to_jshtml())"""
PICTURE = "from PIL import Image\nImage.new('RGB', (40, 40), ({}0, 90, 90))"


class Case(NamedTuple):
    """A cell as it was stored, and what it says now."""

    stored: str
    new: str
    reason: str = ""  # for those that must fail
    tags: tuple[str, ...] = ()


MUST_PASS = {
    "unchanged": Case("1 + 1", "1 + 1"),
    "last-digit noise": Case("0.1 + 0.2", "0.3"),
    "noise in an array": Case("np.sin(t)[:50]", "(np.sin(t) * noise)[:50]"),
    "wrapped array": Case("np.linspace(0, 1, 40)", "np.linspace(0, 1, 40) * (1 + 1e-15)"),
    "other line width": Case(
        "print(np.sin(t)[:30])", "print(np.array2string(np.sin(t)[:30], max_line_width=50))"
    ),
    "negative zero": Case("np.array([0.0, 1.5])", "np.array([-0.0, 1.5])"),
    "rounding noise": Case("print([2.0, 0.0])", "print([2.0, -2.2e-17])"),
    "last of eight digits": Case("print(0.33333333)", "print(0.33333334)"),
    "array that is printed otherwise": Case("t[:2] * 1.0", "t[:2] + [1e-17, 0.0]"),
    "progress bar": Case("for k in (1, 2): print(f'\\r{k}0 %', end='')", "print('20 %', end='')"),
    "cleared output": Case(
        "from IPython.display import clear_output\nprint(1); clear_output(wait=True); print(2)",
        "print(2)",
    ),
    "updated display": Case("h = display(1.5, display_id=True); h.update(2.5)", "_ = display(2.5)"),
    "order of stdout and stderr": Case(
        "print(1); print(2, file=sys.stderr)", "print(2, file=sys.stderr); print(1)"
    ),
    "output of a subprocess": Case("!echo hello", "print('hello')"),
    "uuid": Case("print(uuid.uuid4())", "print(uuid.uuid4())"),
    "time of day": Case("print(datetime.datetime.now())", "print(datetime.datetime.now())"),
    "timing": Case("%time None", "%time None"),
    "order of a set of words": Case("print({'a', 'b'})", "print(\"{'b', 'a'}\")"),
    "file in the home folder": Case("print('/home/ann/x.csv')", "print('/Users/bob/x.csv')"),
    "widget": Case("w.IntSlider(3)", "x = w.Text(); w.IntSlider(3)"),
    "figure in a widget": Case(
        "with (out := w.Output()): display(curve()[0])\nout",
        "with (out := w.Output()): display(curve(np.sin(t) * noise)[0])\nout",
    ),
    "complex noise": Case("np.exp(1j * np.pi)", "np.exp(1j * np.pi) * (1 - 1e-14)"),
    "inf and nan": Case("np.array([np.inf, np.nan])", "np.array([np.inf, -np.nan])"),
    "LaTeX number": Case(
        "from IPython.display import Latex\nLatex(r'$1.2345678 \\cdot 10^{-3}$')",
        "from IPython.display import Latex\nLatex(r'$1.2345679 \\cdot 10^{-3}$')",
    ),
    "HTML number": Case(
        "from IPython.display import HTML\nHTML('<td>1.25&times;10<sup>-3</sup></td>')",
        "from IPython.display import HTML\nHTML('<td>1.2500001&times;10<sup>-3</sup></td>')",
    ),
    "object address": Case("object()", "object()"),
    "prints in many pieces": Case(
        "print('a', 1.5)\nprint('b', 2.5)",
        "for c in 'a 1.5\\nb 2.5\\n': print(c, end='', flush=True)",
    ),
    "tolerance of a cell": Case("print(1.0)", "print(1.009)", tags=("regression-rtol=0.01",)),
    "absolute tolerance": Case("print(1e-5)", "print(3e-5)", tags=("regression-atol=1e-4",)),
    "expected error": Case("1 / 0", "2 / 0", tags=("raises-exception",)),
    "silenced by a semicolon": Case("np.sin(t);", "np.cos(t);"),
    "output to be ignored": Case("id(t)", "id(t) + 1", tags=("nbval-ignore-output",)),
    "unchanged figure": Case("curve();\nplt.show()", "curve();\nplt.show()"),
    "noise in a figure": Case("curve()\nplt.show()", "curve(np.sin(t) * noise)\nplt.show()"),
    "size of a figure": Case("curve()\nplt.show()", "curve(figsize=(3, 2), dpi=50)\nplt.show()"),
    "colour of a curve": Case(
        "fig, ax = curve()\nplt.show()",
        "fig, ax = curve()\nax.lines[0].set(color='k', linewidth=5)\nplt.show()",
    ),
    "font of a label": Case(
        "fig, ax = curve()\nplt.show()",
        "fig, ax = curve()\nax.xaxis.label.set(size=20, family='serif')\nplt.show()",
    ),
    "figure at the end of the cell": Case("fig, ax = curve()", "fig, ax = curve(dpi=50)"),
    "nothing": Case("x = 1", "x = 2"),
}

MUST_FAIL = {
    "sign": Case("print(0.25)", "print(-0.25)", "-0.25, stored 0.25"),
    "one per cent": Case("print(1.2345)", "print(1.2468)", "difference 0.0123"),
    "integer": Case("len(t)", "len(t) + 1", "1001, stored 1000 (integers are exact)"),
    "word": Case("print('stable')", "print('unstable')", "'unstable'"),
    "additional line": Case("print(1.5)", "print(1.5)\nprint(2.5)", "2 lines, stored 1"),
    "entry of an array": Case(
        "np.linspace(0, 1, 40)",
        "np.where(np.arange(40) == 7, 1.0, np.linspace(0, 1, 40))",
        "stored",
    ),
    "reordered dictionary": Case("{'a': 1.5, 'b': 2}", "{'b': 2, 'a': 1.5}", "'b'"),
    "missing output": Case("1.5", "x = 1.5", "0 displayed outputs (none), stored 1 (text)"),
    "output where none was": Case("x = 1.5", "1.5", "1 displayed outputs (text), stored 0 (none)"),
    "missing print": Case("print(1.5)", "x = 1.5", "stdout: stored, but nothing was printed"),
    "print where none was": Case("x = 1.5", "print(1.5)", "stdout: printed, but none is stored"),
    "semicolon added": Case("1.5", "1.5;", "0 displayed outputs"),
    "semicolon removed": Case("1.5;", "1.5", "1 displayed outputs"),
    "warning": Case(
        "x = 1", "import warnings; warnings.warn('x')", "stderr: printed, but none is stored"
    ),
    "error": Case("x = 1", "1 / 0", "ZeroDivisionError"),
    "no error any more": Case("1 / 0", "x = 1", "nothing was raised", ("raises-exception",)),
    "no error, none stored": Case("x = 1", "x = 1", "nothing was raised", ("raises-exception",)),
    "no error, output ignored": Case(
        "1 / 0", "x = 1", "nothing was raised", ("raises-exception", "nbval-ignore-output")
    ),
    "another error": Case("1 / 0", "int('x')", "ValueError", ("raises-exception",)),
    "unknown magic": Case("x = 1", "%unheard_of", "unheard_of"),
    "unknown magic, output ignored": Case(
        "print(1)", "%unheard_of", "unheard_of", ("nbval-ignore-output",)
    ),
    "bad tolerance": Case("x = 1", "x = 1", "got 'wide'", ("regression-rtol=wide",)),
    "negative tolerance": Case("x = 1", "x = 1", "got '-1'", ("regression-atol=-1",)),
    "unknown setting": Case("x = 1", "x = 1", "is not known", ("regression-tolerance=1",)),
    "one point of a curve": Case(
        "curve()\nplt.show()",
        "curve(np.where(np.arange(1000) == 437, 1.01, 1) * np.sin(t))\nplt.show()",
        "axes 1, line 1 'sine', y: point 438 of 1000 differs by",
    ),
    "swapped curve": Case(
        "curve()\nplt.show()", "curve(np.cos(t))\nplt.show()", "'sine', y: point"
    ),
    "sign of a curve": Case("curve()\nplt.show()", "curve(-np.sin(t))\nplt.show()", "'sine', y"),
    "label of a curve": Case(
        "curve()\nplt.show()", "curve(label='cosine')\nplt.show()", "label: 'cosine', stored 'sine'"
    ),
    "label of an axis": Case(
        "curve()\nplt.show()", "curve(xlabel='t [ms]')\nplt.show()", "'t [ms]', stored 't [s]'"
    ),
    "additional curve": Case(
        "curve()\nplt.show()",
        "fig, ax = curve()\nax.plot(t, t)\nplt.show()",
        "shows line 1 'sine', line 2; stored line 1 'sine'",
    ),
    "scale of an axis": Case(
        "curve()\nplt.show()", "fig, ax = curve()\nax.set_yscale('symlog')\nplt.show()", "symlog"
    ),
    "missing figure": Case("curve()\nplt.show()", "_ = curve()\nplt.close()", "stored 1 (figure)"),
    "additional figure": Case(
        "curve()\nplt.show()",
        "curve()\ncurve()\nplt.show()",
        "2 displayed outputs (figure, figure)",
    ),
    "rounding noise alone": Case("print(0.0)", "print(-2.2e-17)", "-2.2e-17, stored 0.0"),
    "step of a short number": Case("print('K = 1.0')", "print('K = 1.1')", "1.1, stored 1.0"),
    "hidden in an array": Case(
        "np.zeros(5000)", "(np.arange(5000) == 2345) * 1.0", "point 2346 of 5000 differs by 1"
    ),
    "type of an array": Case("np.array([1])", "np.array([1.0])", "dtype"),
    "value of a widget": Case("w.IntSlider(3)", "w.IntSlider(4)", "value: 4, stored 3"),
    "figure in a widget": Case(
        "with (out := w.Output()): display(curve()[0])\nout",
        "with (out := w.Output()): display(curve(1.001 * np.sin(t))[0])\nout",
        "within a widget: figure, axes 1, line 1 'sine', y",
    ),
    "frame of a film": Case(
        FILM.format(last=2), FILM.format(last=2.5), "frame 3 of 3: figure, axes 1, line 1, y"
    ),
    "picture": Case(PICTURE.format(5), PICTURE.format(6), "of the pixels differ"),
    "cell of a table in HTML": Case(
        "HTML('<table><tr><td>0.97</td></tr></table>')",
        "HTML('<table><tr><td>0.96</td></tr></table>')",
        "row 1, column 1 of table 1: 0.96, stored 0.97",
    ),
    "figure that cannot be read": Case(
        "curve()\nplt.show()",
        "fig, ax = curve()\nax.lines[0].get_label = None\nplt.show()",
        "it could not be made",
    ),
    "figure without its data": Case(
        "curve()\nplt.show()",
        "get_ipython().display_formatter.mimebundle_formatter.pop(type(curve()[0]))\nplt.show()\n"
        "%load_ext nbregress",
        "a figure's data are stored, but none came",
    ),
}


def environment():
    paths = [str(SOURCE), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}


def pytest_here(folder, *arguments):
    """A pytest run of its own within this process: a subprocess loads for seconds."""
    points = importlib.metadata.entry_points(group="pytest11")
    options = ["-q", "-p", "no:cacheprovider", "-p", "no:faulthandler", "--color=no"]
    if all(point.value != "nbregress.plugin" for point in points):
        options += ["-p", "nbregress.plugin"]
    return in_process(folder, pytest.main, [*options, "--nb", *arguments])


def run_pytest(folder, *arguments):
    """Results of a pytest run: {(file, cell): (outcome, text)}."""
    pytest_here(folder, "--junitxml=report.xml", *arguments)
    results = {}
    for case in ET.parse(folder / "report.xml").iter("testcase"):
        children = [c for c in case if c.tag in ("failure", "error", "skipped")]
        outcome = children[0].tag if children else "passed"
        text = (children[0].get("message") or "") + (children[0].text or "") if children else ""
        results[case.get("classname"), case.get("name")] = outcome, text
    return results


def store(path, cells):
    nbformat.write(new_notebook(cells=cells), path)


def cell(source, tags=(), **fields):
    return new_code_cell(source, metadata={"tags": list(tags)} if tags else {}, **fields)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Both tables as notebooks: executed as stored, then run with the new sources."""
    folder = tmp_path_factory.mktemp("cases")
    (folder / "pytest.ini").write_text("[pytest]\n")
    tables = {"passing.ipynb": MUST_PASS, "failing.ipynb": MUST_FAIL}
    for name, table in tables.items():
        # Tags such as a bad tolerance stop the executor too: they come with the new source.
        stored = [
            cell(case.stored, ["raises-exception"] if "1 / 0" in case.stored else ())
            for case in table.values()
        ]
        store(folder / name, [cell(SETUP), *stored])
    done = in_process(folder, main, ["refresh", "--jobs", "2", *tables])
    assert done.returncode == 0, done.stderr
    for name, table in tables.items():
        nb = nbformat.read(folder / name, as_version=4)
        for old, case in zip(nb.cells[1:], table.values(), strict=True):
            old.source, old.metadata["tags"] = case.new, list(case.tags)
        nbformat.write(nb, folder / name)
    broken_notebooks(folder)
    return run_pytest(folder, "."), folder


def broken_notebooks(folder):
    ran = {"execution_count": 1, "outputs": []}
    store(folder / "stripped.ipynb", [cell("print(1.5)"), cell("2.5")])
    store(folder / "half_stripped.ipynb", [cell("x = 1", **ran), cell("print(x)")])
    store(folder / "hangs.ipynb", [cell("while True: pass", **ran), cell("x = 1", **ran)])
    store(
        folder / "dies.ipynb",
        [cell("x = 1", **ran), cell("import os; os._exit(1)", **ran), cell("x = 1", **ran)],
    )
    own = "[[tool.nbregress.overrides]]\nmatch = 'hangs.ipynb'\ntimeout = 6\n"
    (folder / "pyproject.toml").write_text(own)
    (folder / "not_json.ipynb").write_text("hello")
    (folder / "not_a_notebook.ipynb").write_text('{"a": 1}')
    (folder / "empty.ipynb").write_text("")


@pytest.mark.parametrize("index", range(len(MUST_PASS)), ids=MUST_PASS)
def test_must_pass(results, index):
    outcome, text = results[0]["passing.ipynb", f"Cell {index + 1}"]
    assert outcome == "passed", text


@pytest.mark.parametrize("index", range(len(MUST_FAIL)), ids=MUST_FAIL)
def test_must_fail(results, index):
    outcome, text = results[0]["failing.ipynb", f"Cell {index + 1}"]
    assert outcome == "failure"
    assert list(MUST_FAIL.values())[index].reason in text


def test_a_difference_prints_the_command_that_accepts_it(results):
    _, text = results[0]["failing.ipynb", "Cell 1"]
    assert "to accept: python -m nbregress refresh failing.ipynb" in text


@pytest.mark.parametrize(
    ("name", "outcomes", "reason"),
    [
        ("stripped", {0: "failure", 1: "skipped"}, "the notebook was never executed"),
        ("half_stripped", {0: "passed", 1: "failure"}, "the cell was never executed"),
        ("hangs", {0: "failure", 1: "skipped"}, "Timeout of 6 seconds"),
        ("dies", {0: "passed", 1: "failure", 2: "skipped"}, "the kernel died"),
        ("not_json", {None: "failure"}, "does not appear to be JSON"),
        ("not_a_notebook", {None: "failure"}, "is not a readable notebook"),
        ("empty", {None: "failure"}, "is not a readable notebook"),
    ],
)
def test_broken_notebook_fails_once_and_the_rest_goes_on(results, name, outcomes, reason):
    found = {cell: value for (file, cell), value in results[0].items() if file == f"{name}.ipynb"}
    wanted = {f"Cell {k}" if k is not None else "notebook": v for k, v in outcomes.items()}
    assert {cell: outcome for cell, (outcome, _) in found.items()} == wanted
    assert reason in next(text for outcome, text in found.values() if outcome == "failure")


def test_missing_kernel(tmp_path):
    nb = new_notebook(cells=[cell("1", execution_count=1), cell("2", execution_count=2)])
    nb.metadata["kernelspec"] = {"name": "unheard_of", "display_name": "?", "language": "R"}
    nbformat.write(nb, tmp_path / "a.ipynb")
    done = pytest_here(tmp_path)
    assert (
        "has no kernel: it wants 'unheard_of' (language r)" in done.stdout
        and "1 failed, 1 skipped" in done.stdout
    )


@pytest.mark.parametrize("arguments", [["--regression-rtol=wide"], ["--regression-atol=-1"]])
def test_bad_option(tmp_path, arguments):
    done = pytest_here(tmp_path, *arguments)
    assert done.returncode == 4 and "must be a number >= 0" in done.stderr


def test_settings(tmp_path):
    (tmp_path / "pytest.ini").write_text("[pytest]\nregression_rtol = 0.1\n")
    waits = cell("import threading; threading.Event().wait()", execution_count=2)
    store(tmp_path / "a.ipynb", [printing("1.0500", "1.0000\n"), waits])
    assert run_pytest(tmp_path, "a.ipynb::Cell 0")["a.ipynb", "Cell 0"][0] == "passed"
    options = ["--regression-rtol=0.01", "--nb-timeout=3", "--nb-report=page.html"]
    found = run_pytest(tmp_path, *options)
    assert found["a.ipynb", "Cell 0"][0] == "failure"
    assert "Timeout of 3 seconds" in found["a.ipynb", "Cell 1"][1]
    page = (tmp_path / "page.html").read_text("utf-8")
    assert "2 of 2 cells differ or fail" in page and "Timeout of 3 seconds" in page


def test_without_nbval_the_plugin_loads_nothing():
    code = (
        "import sys, nbregress.plugin, nbregress as r\n"
        "print(*sorted({'numpy', 'matplotlib', 'nbval', 'nbformat', 'IPython'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment(), capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []


def test_the_extension_loads_no_matplotlib():
    code = (
        "from IPython.core.interactiveshell import InteractiveShell\nimport sys\n"
        "shell = InteractiveShell.instance()\n"
        "shell.run_line_magic('load_ext', 'nbregress')\n"
        "assert 'matplotlib.figure' not in sys.modules and 'numpy' not in sys.modules\n"
        "from matplotlib.figure import Figure\n"
        "print(*shell.display_formatter.format(Figure())[0])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment(), capture_output=True, text=True
    )
    assert done.stdout.split() == [
        "application/vnd.nbregress.figure+json",
        "text/plain",
    ], done.stderr


@pytest.mark.skipif(not Path("/proc/self/cwd").exists(), reason="lists processes through /proc")
def test_no_kernel_survives(results):
    folder = os.path.realpath(results[1])
    left = []
    for process in Path("/proc").glob("[0-9]*/cwd"):
        try:
            if os.path.realpath(process) == folder:
                left.append((process.parent / "cmdline").read_text())
        except OSError:
            pass  # ended meanwhile, or another user's
    assert left == []


def printing(text, stored):
    output = new_output("stream", name="stdout", text=stored)
    return cell(f"print({text!r})", execution_count=1, outputs=[output])


def test_beside_nbval_a_cell_is_tested_once(tmp_path):
    store(tmp_path / "a.ipynb", [printing("1", "1\n")])
    listed = pytest_here(tmp_path, "--collect-only", "--nbval").stdout
    assert listed.count("a.ipynb::Cell 0") == 1


def test_what_cannot_be_written_is_one_line_and_the_old_file_stays(tmp_path, monkeypatch):
    path = tmp_path / "an ä.ipynb"
    store(path, [printing("2", "1\n")])
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", full)
        done = pytest_here(tmp_path, "--nb-update")
    assert "cannot be written, and the old file is untouched" in done.stdout
    assert "During handling" not in done.stdout and "tempfile" not in done.stdout
    assert path.read_bytes() == before and [*filter(Path.is_file, tmp_path.iterdir())] == [path]


def test_another_language_is_said_and_a_path_with_a_space_can_be_pasted(tmp_path, monkeypatch):
    """A Python kernel that its specification calls R's stands for R's."""
    folder = tmp_path / "share" / "kernels" / "pretends"
    folder.mkdir(parents=True)
    start = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    spec = {"argv": start, "display_name": "R", "language": "R"}
    (folder / "kernel.json").write_text(json.dumps(spec))
    monkeypatch.setenv("JUPYTER_PATH", str(tmp_path / "share"))
    nb = new_notebook(cells=[printing("[1] 3.15", "[1] 3.14\n"), printing("a", "a\n")])
    nb.metadata["kernelspec"] = {"name": "pretends", "display_name": "R", "language": "R"}
    nbformat.write(nb, tmp_path / "an r.ipynb")
    done = pytest_here(tmp_path)
    assert "1 failed, 1 passed" in done.stdout and "3.15, stored 3.14" in done.stdout
    assert "language r: text compared, figures by pixels (2)" in done.stdout
    assert 'refresh "an r.ipynb"' in done.stdout
    done = in_process(tmp_path, main, ["refresh", "."])
    assert "language r: text compared, figures by pixels; rewritten" in done.stderr


def test_a_data_frame_s_column_is_named():
    old, new = (
        {
            "type": "DataFrame",
            "names": ["name", "force"],
            "columns": [array_digest(["a"]), array_digest([f])],
        }
        for f in (1.0, 1.5)
    )
    (message,) = figures_differences(old, new, Comparison(Settings()), "data")
    assert message.startswith("data, columns, float64 1 'force', values")
