"""The executor: reproducible outputs, one clear line for each failure."""

import base64
import os
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

from nbregress.execute import NotebookError, keep_agreeing, read, write
from nbregress.normalize import normalize

SOURCE = Path(__file__).resolve().parents[2] / "lib" / "nbregress" / "src"


def regression(folder, *arguments):
    paths = [str(SOURCE), os.environ.get("PYTHONPATH", "")]
    return subprocess.run(
        [sys.executable, "-m", "nbregress", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
        capture_output=True,
        text=True,
    )


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
                "%load_ext nbregress\nimport os, sys\nprint(os.getcwd(), hash('a'))",
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
    assert "cannot be read" in lines["no.ipynb"]
    assert lines["good.ipynb"].endswith("executed")
    assert "4 of 5 notebooks failed" in done.stderr.splitlines()[-1]
    assert [path.name for path in (folder / "out/copies").iterdir()] == ["good.ipynb"]


def test_a_cell_that_takes_too_long(tmp_path):
    nbformat.write(new_notebook(cells=cells("x = 1", "while True: pass")), tmp_path / "a.ipynb")
    before = (tmp_path / "a.ipynb").read_bytes()
    done = regression(tmp_path, "refresh", "--timeout", "2", "a.ipynb")
    assert done.returncode == 1
    assert "In [2] (cell 2 of 2): took longer than 2 s" in done.stderr
    assert (tmp_path / "a.ipynb").read_bytes() == before


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
    assert "version" not in nb.metadata.language_info
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


def test_a_digest_under_its_old_name_is_renamed(run, tmp_path):
    copy, path = run[0] / "out/copies/good.ipynb", tmp_path / "good.ipynb"
    today = copy.read_text("utf-8")
    old = today.replace("vnd.nbregress.figure", "vnd.statebook.figure")
    assert old.count("vnd.statebook.figure") == 1
    for stored, changes, written in (
        (old, ([], []), today),
        # The output is kept as it was stored, but for the name.
        (noisy := old.replace('"1 2"', '"1 2.0000000001"'), ([], ["In [3]"]), None),
        (old.replace('"1 2"', '"1 3"'), (["In [3]"], []), today),
    ):
        path.write_text(stored, "utf-8")
        executed = read(copy)
        assert keep_agreeing(read(path), executed) == changes
        assert write(executed, path)
        wanted = written or noisy.replace("vnd.statebook.figure", "vnd.nbregress.figure")
        assert path.read_text("utf-8") == wanted


def test_bad_arguments(tmp_path):
    for arguments, message in (
        (["execute", "a.ipynb"], "--output-dir"),
        (["execute", "--output-dir", "o", "a/x.ipynb", "b/x.ipynb"], "two files are named x.ipynb"),
        (["refresh", "--jobs", "0", "a.ipynb"], "must be at least 1"),
        (["refresh", "--timeout", "-1", "a.ipynb"], "must be positive"),
    ):
        done = regression(tmp_path, *arguments)
        assert done.returncode == 2 and message in done.stderr


def test_another_language_is_refused(tmp_path):
    nb = new_notebook()
    nb.metadata["kernelspec"] = {"name": "ir", "language": "R", "display_name": "R"}
    nbformat.write(nb, tmp_path / "r.ipynb")
    with pytest.raises(NotebookError, match="wants the kernel 'ir'"):
        read(tmp_path / "r.ipynb")


def test_write_says_whether_it_changed_the_file(tmp_path):
    path = tmp_path / "a.ipynb"
    nb = new_notebook(cells=cells("x = 1"))
    assert write(nb, path) and not write(nb, path)
    assert [file.name for file in tmp_path.iterdir()] == ["a.ipynb"]


def test_normalize():
    def stream(name, text):
        return new_output("stream", name=name, text=text)

    cell = new_code_cell("x", metadata={"execution": {"iopub.status.busy": "2024"}})
    cell.outputs = [stream("stdout", "a"), stream("stdout", "b"), stream("stderr", "c")]
    cell.outputs.append(new_output("display_data", data={"image/png": "no picture"}))
    view = "application/vnd.jupyter.widget-view+json"
    cell.outputs.append(new_output("display_data", data={view: {}, "text/plain": "widget"}))
    nb = new_notebook(cells=[cell, new_markdown_cell("m"), new_markdown_cell("n")])
    nb.cells[1]["id"], nb.cells[2]["id"] = "", "cell-1"
    normalize(nb)
    assert [o.text for o in cell.outputs[:2]] == ["ab", "c"]
    assert cell.outputs[2].data["image/png"] == "no picture"
    assert set(cell.outputs[3].data) == {"text/plain"}
    assert cell.metadata == {}
    assert [c.id for c in nb.cells[1:]] == ["cell-2", "cell-1"]


def test_a_picture_without_its_data_is_kept_only_if_it_is_the_same():
    def notebook(png):
        cell = new_code_cell("show", execution_count=1)
        cell.outputs = [new_output("display_data", data={"image/png": png})]
        return new_notebook(cells=[cell])

    assert keep_agreeing(notebook("AAAA"), notebook("AAAA")) == ([], [])
    assert keep_agreeing(notebook("AAAA"), notebook("BBBB")) == (["In [1]"], [])
