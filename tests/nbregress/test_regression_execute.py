"""The executor: reproducible outputs, one clear line for each failure."""

import asyncio
import base64
import itertools
import os
import re
import subprocess
import sys
import time

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output
from processes import in_process

from nbregress.__main__ import main
from nbregress.session import NotebookError, Session
from nbregress.settings import Settings, SettingsError, load_settings
from nbregress.store import keep_agreeing, normalize, write


def regression(folder, *arguments):
    """The command line, in this process: Jupyter's packages take seconds to load."""
    return in_process(folder, main, arguments)


def cells(*sources):
    return [new_code_cell(source) for source in sources]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A notebook executed beside four that cannot be."""
    folder = tmp_path_factory.mktemp("run")
    good = new_notebook(
        cells=[
            new_markdown_cell("# Title"),
            *cells(
                "import os, sys\nprint(os.getcwd(), hash('a'))",
                "for k in range(3):\n    print(k, flush=True)",
                "",
                "import matplotlib.pyplot as plt\nplt.plot([1, 2]);",
                "{'ü', 'b', 'a'}",
                "open('written', 'w').close()",
            ),
            new_code_cell("1 / 0", metadata={"tags": ["raises-exception"]}),
        ]
    )
    nbformat.write(good, folder / "good.ipynb")
    nbformat.write(new_notebook(cells=cells("x = 1", "int('x')")), folder / "raises.ipynb")
    calm = new_code_cell("x = 1", metadata={"tags": ["raises-exception"]})
    nbformat.write(new_notebook(cells=[calm]), folder / "calm.ipynb")
    (folder / "text.ipynb").write_text("hello")
    names = ["raises.ipynb", "calm.ipynb", "text.ipynb", "good.ipynb", "no.ipynb"]
    options = ["--output-dir", "out/copies", "--jobs", "2"]
    return folder, regression(folder, "execute", *options, *names)


def test_failures_are_named_and_the_rest_goes_on(run):
    folder, done = run
    assert done.returncode == 1
    lines = {line.split()[1]: line for line in done.stderr.splitlines() if line.startswith("[")}
    assert "In [2] (cell 2 of 2): ValueError: invalid literal" in lines["raises.ipynb"]
    assert "tagged raises-exception, but nothing was raised" in lines["calm.ipynb"]
    assert "is not a notebook" in lines["text.ipynb"]
    assert "no notebook is named no.ipynb" in done.stderr
    assert lines["good.ipynb"].endswith("executed")
    assert "3 of 4 notebooks failed" in done.stderr.splitlines()[-1]
    assert [path.name for path in (folder / "out/copies").iterdir()] == ["good.ipynb"]


def test_a_cell_that_takes_too_long(tmp_path):
    nbformat.write(new_notebook(cells=cells("x = 1", "while True: pass")), tmp_path / "a.ipynb")
    before = (tmp_path / "a.ipynb").read_bytes()
    done = regression(tmp_path, "refresh", "--timeout", "2", "a.ipynb")
    assert done.returncode == 1
    assert "Timeout of 2 seconds exceeded executing cell" in done.stderr
    assert (tmp_path / "a.ipynb").read_bytes() == before


def test_a_kernel_that_eats_memory_fails_alone(tmp_path):
    pytest.importorskip("resource", reason="this system has no limits of memory")
    limit = "import resource\nresource.setrlimit(resource.RLIMIT_AS, (2**32, 2**32))"
    nbformat.write(new_notebook(cells=cells(limit, "x = bytearray(2**33)")), tmp_path / "a.ipynb")
    nbformat.write(new_notebook(cells=cells("'whole'")), tmp_path / "b.ipynb")
    before = (tmp_path / "a.ipynb").read_bytes()
    command = [sys.executable, "-m", "nbregress", "refresh", "."]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    a, b, end = done.stderr.splitlines()
    assert done.returncode == 1 and "1 of 2 notebooks failed" in end
    assert "In [2] (cell 2 of 2): MemoryError" in a and "rewritten" in b
    assert (tmp_path / "a.ipynb").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.ipynb", "b.ipynb"]


@pytest.mark.parametrize("step", [-3600.0, 86_400.0])
def test_a_clock_that_jumps_ends_nothing_and_lengthens_nothing(tmp_path, monkeypatch, step):
    nbformat.write(new_notebook(cells=cells("print(1)")), tmp_path / "a.ipynb")
    nbformat.write(new_notebook(cells=cells("while True: pass")), tmp_path / "b.ipynb")
    now = itertools.count(1.7e9, step)
    monkeypatch.setattr(time, "time", lambda: next(now))
    done = regression(tmp_path, "refresh", "--timeout", "2", ".")
    a, b, _ = done.stderr.splitlines()
    assert "rewritten, new outputs: In [1]" in a
    assert "Timeout of 2 seconds exceeded executing cell" in b


def test_executed_copy(run):
    folder, _ = run
    text = (folder / "out/copies/good.ipynb").read_text("utf-8")
    nb = nbformat.reads(text, as_version=4)
    original = nbformat.read(folder / "good.ipynb", as_version=4)
    assert [c.id for c in nb.cells] == [c.id for c in original.cells]
    assert not original.cells[1].outputs
    first, streams, empty, figure, words, _, error = nb.cells[1:]
    assert first.outputs[0].text.startswith(os.path.realpath(folder)), "runs in its own folder"
    assert (folder / "written").exists()
    assert [output.text for output in streams.outputs] == ["0\n1\n2\n"]
    assert empty.execution_count is None and figure.execution_count == 3
    assert len(figure.outputs) == 1, "a semicolon hides the list of lines"
    assert set(figure.outputs[0].data) == {
        "application/vnd.nbregress.figure+json",
        "image/png",
        "text/plain",
    }
    assert b"Software" not in base64.b64decode(figure.outputs[0].data["image/png"])
    assert "{'a', 'b', 'ü'}" in words.outputs[0].data["text/plain"]
    assert error.outputs[0].traceback == ["ZeroDivisionError: division by zero"]
    assert "execution" not in first.metadata
    assert text.endswith("}\n") and '\n "cells"' in text and "ü" in text


def test_refresh_is_byte_identical_and_keeps_what_agrees(run, tmp_path):
    folder, _ = run
    path = tmp_path / "good.ipynb"
    text = (folder / "out/copies/good.ipynb").read_text("utf-8")
    # The folder is another one, so the first cell's output changes; nothing else may.
    # Another machine's last digits and its PNG bytes:
    png = re.search(r'"image/png": "([^"]{60})', text).group(1)
    other = text.replace('"1 2"', '"1 2.0000000001"').replace(png, png[:-4] + "AAAA")
    assert other.count("AAAA") > text.count("AAAA") and "2.0000000001" in other
    path.write_text(other, "utf-8")
    done = regression(tmp_path, "refresh", "good.ipynb")
    assert "rewritten, new outputs: In [1] (kept In [3]: within the tolerance" in done.stderr
    refreshed = path.read_bytes()
    assert b"2.0000000001" in refreshed
    assert "unchanged" in regression(tmp_path, "refresh", "good.ipynb").stderr
    assert path.read_bytes() == refreshed
    assert "new outputs: all" in regression(tmp_path, "refresh", "--all", "good.ipynb").stderr
    assert b"2.0000000001" not in path.read_bytes()


def test_bad_arguments(tmp_path):
    for folder in "ab":
        (tmp_path / folder).mkdir()
        nbformat.write(new_notebook(), tmp_path / folder / "x.ipynb")
    for arguments, message in (
        (["execute", "a.ipynb"], "--output-dir"),
        (["execute", "--output-dir", "o", "."], "two files are named x.ipynb"),
        (["refresh", "--jobs", "0", "a.ipynb"], "must be at least 1"),
    ):
        done = regression(tmp_path, *arguments)
        assert done.returncode == 2 and message in done.stderr


def test_a_bad_setting_is_named(tmp_path):
    nbformat.write(new_notebook(), tmp_path / "a.ipynb")
    done = regression(tmp_path, "refresh", "--timeout", "-1", "a.ipynb")
    assert done.returncode == 1 and "timeout must be a number >= 0, got '-1'" in done.stderr


def test_write_says_whether_it_changed_the_file(tmp_path):
    path = tmp_path / "a.ipynb"
    nb = new_notebook(cells=cells("x = 1"))
    assert write(nb, path) and not write(nb, path)
    assert [file.name for file in tmp_path.iterdir()] == ["a.ipynb"]


def test_what_somebody_saved_while_a_notebook_ran_stays(tmp_path):
    """The notebook saves itself anew from within, as an editor would."""
    path = tmp_path / "a.ipynb"
    save = (
        "import json, pathlib\nfile = pathlib.Path('a.ipynb')\n"
        "book = json.loads(file.read_text())\nbook['cells'][1]['source'] = 'edited = 1'\n"
        "_ = file.write_text(json.dumps(book))"
    )
    nbformat.write(new_notebook(cells=cells(save, "x = 1")), path)
    done = regression(tmp_path, "refresh", "a.ipynb")
    assert done.returncode == 1 and "saved by somebody else while it ran" in done.stderr
    assert nbformat.read(path, 4).cells[1].source == "edited = 1"
    assert nbformat.read(path, 4).cells[0].outputs == []


def test_normalize():
    def stream(name, text):
        return new_output("stream", name=name, text=text)

    cell = new_code_cell("x", metadata={"execution": {"iopub.status.busy": "2024"}})
    cell.outputs = [stream("stdout", "a"), stream("stdout", "b"), stream("stderr", "c")]
    cell.outputs.append(new_output("display_data", data={"image/png": "no picture"}))
    view = "application/vnd.jupyter.widget-view+json"
    cell.outputs.append(new_output("display_data", data={view: {}, "text/plain": "widget"}))
    nb = new_notebook(cells=[cell, new_markdown_cell("m"), new_markdown_cell("n")])
    normalize(nb)
    assert [o.text for o in cell.outputs[:2]] == ["ab", "c"]
    assert cell.outputs[2].data["image/png"] == "no picture"
    assert cell.metadata == {}


def test_a_picture_without_its_data_is_kept_only_if_it_is_the_same():
    def notebook(png):
        cell = new_code_cell("show", execution_count=1)
        cell.outputs = [new_output("display_data", data={"image/png": png})]
        return new_notebook(cells=[cell])

    assert keep_agreeing(notebook("AAAA"), notebook("AAAA"), Settings()) == ([], [])
    assert keep_agreeing(notebook("AAAA"), notebook("BBBB"), Settings()) == (["In [1]"], [])


def code(source, text=None, **fields):
    outputs = [new_output("stream", name="stdout", text=text)] if text is not None else []
    return new_code_cell(source, execution_count=1, outputs=outputs, **fields)


def test_the_ini_file_and_pyproject_hold_for_refresh_too(tmp_path):
    """What fails in pytest is refreshed, what passes there is kept."""
    stored = new_notebook(cells=[code("print(1.0000001)", "1.0\n")])
    nbformat.write(stored, tmp_path / "a.ipynb")
    assert "unchanged" in regression(tmp_path, "refresh", "a.ipynb").stderr
    (tmp_path / "pytest.ini").write_text("[pytest]\naddopts = -q --regression-rtol 1e-9\n")
    assert load_settings(tmp_path / "a.ipynb", {}).rtol == 1e-9
    assert "differs in In [1]" in regression(tmp_path, "refresh", "--check", "a.ipynb").stderr
    text = "[tool.nbregress]\nrtol = 1e-3\n[[tool.nbregress.overrides]]\nmatch = 'b/*'\natol = 2"
    (tmp_path / "pyproject.toml").write_text(text)
    assert "agrees" in regression(tmp_path, "refresh", "--check", "a.ipynb").stderr
    assert load_settings(tmp_path / "b" / "c.ipynb", {}).atol == 2.0
    assert load_settings(tmp_path / "a.ipynb", {"rtol": 0.5}) == Settings(rtol=0.5)
    (tmp_path / "pyproject.toml").write_text("[tool.nbregress]\nrtl = 1e-3")
    with pytest.raises(SettingsError, match="'rtl' of nbregress is not known"):
        load_settings(tmp_path / "a.ipynb", {})


def test_tags_mean_the_same_to_refresh(tmp_path):
    (tmp_path / "folder").mkdir()
    tags = {"nbval-skip": "skipped", "nbval-ignore-output": "ignored", "parameters": "n = 2"}
    stored = [code("n = 1; print(n)", text, metadata={"tags": [tag]}) for tag, text in tags.items()]
    stored[2].source, stored[2].outputs = "n = 1", []
    nb = new_notebook(cells=[*stored, code("print(n)", "5\n")])
    nb.metadata["kernelspec"] = {"name": "x", "language": "python3", "display_name": "mine"}
    nb.nbformat_minor = 4
    for cell in nb.cells:
        cell.pop("id")
    (tmp_path / "folder" / "ä b.ipynb").write_bytes(
        nbformat.writes(nb).replace("\n", "\r\n").encode()
    )
    done = regression(tmp_path, "refresh", "--parameter", "n=7", "fold*", "missing")
    assert done.returncode == 1 and "no notebook is named missing" in done.stderr
    assert (tmp_path / "folder" / "ä b.ipynb").read_bytes().count(b"\r\n") > 40
    new = nbformat.reader.reads((tmp_path / "folder" / "ä b.ipynb").read_text("utf-8"))
    assert [c.outputs[0].text for c in new.cells if c.outputs] == ["skipped", "ignored", "7\n"]
    assert new.nbformat_minor == 4 and new.metadata.kernelspec.display_name == "mine"


def test_a_bad_tag_stops_only_its_own_notebook(tmp_path):
    nbformat.write(
        new_notebook(cells=[code("1", metadata={"tags": ["regression-x=1"]})]), tmp_path / "a.ipynb"
    )
    nbformat.write(new_notebook(cells=[code("1")]), tmp_path / "b.ipynb")
    done = regression(tmp_path, "refresh", ".")
    assert "FAILED tag 'regression-x=1' is not known" in done.stderr
    assert "b.ipynb" in done.stderr and "1 of 2 notebooks failed: a.ipynb" in done.stderr


@pytest.mark.parametrize("step", ["chmod", "replace"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failed_or_interrupted_write_leaves_the_old_file_alone(
    tmp_path, monkeypatch, step, error
):
    path = tmp_path / "a.ipynb"
    write(new_notebook(cells=cells("x = 1")), path)
    before = path.read_bytes()

    def ends(*_):
        raise error

    monkeypatch.setattr(os, step, ends)
    with pytest.raises((NotebookError, KeyboardInterrupt), match=r"the old file is untouched|^$"):
        write(new_notebook(cells=cells("x = 2")), path)
    assert path.read_bytes() == before and [f.name for f in tmp_path.iterdir()] == ["a.ipynb"]


def test_diff_compares_what_is_stored(tmp_path):
    for name, text in (("a", "1.0\n"), ("b", "1.1\n")):
        nbformat.write(
            new_notebook(cells=[code("print(x)", text), code("2")]), tmp_path / f"{name}.ipynb"
        )
    assert regression(tmp_path, "diff", "a.ipynb", "a.ipynb").returncode == 0
    done = regression(tmp_path, "diff", "--report", "r.html", "a.ipynb", "b.ipynb")
    assert done.returncode == 1 and "Cell 0: stdout, line 1: 1.1, stored 1.0" in done.stdout
    page = (tmp_path / "r.html").read_text("utf-8")
    assert "<pre>1.0\n</pre>" in page and "<pre>1.1\n</pre>" in page


@pytest.mark.parametrize("deaths", [1, 2])
def test_a_kernel_that_dies_at_once_is_started_once_more(tmp_path, monkeypatch, deaths):
    connect, tried = Session.async_start_new_kernel_client, []

    async def dies(self):
        tried.append(1)
        if len(tried) <= deaths:
            raise RuntimeError("Kernel died before replying to kernel_info")
        return await connect(self)

    async def run():
        session = Session(new_notebook(cells=[new_code_cell("print(7)")]), tmp_path, Settings())
        await session.start()
        try:
            await session.run(0)
        finally:
            await session.close()
        return session.nb.cells[0].outputs[0]["text"]

    monkeypatch.setattr(Session, "async_start_new_kernel_client", dies)
    if deaths == 1:
        assert asyncio.run(run()) == "7\n"
    else:
        with pytest.raises(NotebookError, match="does not start: RuntimeError: Kernel died"):
            asyncio.run(run())
    assert len(tried) == 2
