"""The site whose notebooks run in a browser: what is written before JupyterLite builds it."""

import importlib.util
import subprocess
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def lite(tmp_path, monkeypatch):
    """A lite.py whose root is a small copy."""
    spec = importlib.util.spec_from_file_location("lite_under_test", ROOT / "book" / "lite.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    for name in ("00_a.ipynb", "exercises/00_a.ipynb", "16_timed.ipynb"):
        path = tmp_path / "workbook" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        cells = [nbformat.v4.new_code_cell("x = 1\n### BEGIN SOLUTION\nx = 2\n### END SOLUTION")]
        nbformat.write(nbformat.v4.new_notebook(cells=cells), path)
    (tmp_path / "_build").mkdir()
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "BUILD", tmp_path / "_build")
    return module


def test_notebooks_begin_with_the_installation_and_some_are_left_out(lite, tmp_path):
    folder = tmp_path / "files"
    lite.contents(folder, ["workbook/16_timed.ipynb"])
    written = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*.ipynb"))
    assert written == ["00_a.ipynb", "exercises/00_a.ipynb"]
    for name in written:
        notebook = nbformat.read(folder / name, as_version=4)
        nbformat.validate(notebook)
        assert notebook.cells[0].source.startswith("%pip install -q statebook")
        assert notebook.metadata.kernelspec.name == "python"
    assert "SOLUTION" not in (folder / "exercises" / "00_a.ipynb").read_text()


@pytest.mark.parametrize("fails", [False, True])
def test_the_old_site_stays_until_the_new_one_is_whole(lite, monkeypatch, fails):
    old = lite.BUILD / "lite"
    old.mkdir()
    (old / "index.html").write_text("old")
    commands = []

    def build(command, check, cwd):
        commands.append(command)
        site = Path(command[command.index("--output-dir") + 1])
        site.mkdir()
        (site / "index.html").write_text("new")
        if fails:
            raise subprocess.CalledProcessError(1, command)

    monkeypatch.setattr(lite, "wheels", lambda folder: [folder / "a.whl"])
    monkeypatch.setattr(lite.subprocess, "run", build)
    assert lite.main(["--pyodide", "p.tar.bz2", "--skip", "workbook/16_timed.ipynb"]) == fails
    assert (old / "index.html").read_text() == ("old" if fails else "new")
    assert commands[0][-3:-1] == ["--pyodide", "p.tar.bz2"]
    assert commands[0][-1].startswith("--piplite-wheels=")
    assert [path.name for path in lite.BUILD.iterdir()] == ["lite"]


def test_what_it_brings_along_is_installed_there(lite):
    """A name in the first cell is the library, or a wheel that the site has."""
    names = lite.INSTALL.split()[3:]
    assert names[0] == "statebook" and set(names[1:]) <= set(lite.PACKAGES)
