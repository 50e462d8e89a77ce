"""book/build.py: what is executed again, and what a failure leaves."""

import importlib.util
import json
import os
import sys
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).resolve().parents[1]


def save(path, source):
    """Write a notebook of one cell."""
    path.parent.mkdir(parents=True, exist_ok=True)
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source)])
    nbformat.write(book, path)


@pytest.fixture
def build(tmp_path, monkeypatch):
    """A build.py whose root is a small copy, and whose notebooks are not executed."""
    spec = importlib.util.spec_from_file_location("build_under_test", ROOT / "book" / "build.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "build_under_test", module)
    spec.loader.exec_module(module)
    for name, place in {
        "ROOT": tmp_path,
        "BUILD": tmp_path / "_build",
        "EXECUTED": tmp_path / "_build" / "executed",
        "RECORD": tmp_path / "_build" / "executed.json",
    }.items():
        monkeypatch.setattr(module, name, place)
    (tmp_path / "_build").mkdir()
    (tmp_path / "lib").mkdir()
    (tmp_path / "requirements.txt").write_text("# ours\nnbformat>=5\n")
    (tmp_path / "lib" / "a.py").write_text("x = 1\n")
    for name in ("00_a", "01_b"):
        save(tmp_path / "workbook" / f"{name}.ipynb", "1 + 1")
    module.executed = []
    module.fails = set()

    def run_all(paths, finish, *, jobs, given):
        failed = []
        for path in paths:
            module.executed.append(path.stem)
            if path.stem in module.fails:
                failed.append(path)
            else:
                run = type("Run", (), {"executed": nbformat.read(path, 4)})
                finish(path, run)
        return failed

    monkeypatch.setattr(module, "run_all", run_all)
    monkeypatch.chdir(tmp_path)
    return module


def go(build, everything=False):
    build.executed.clear()
    notebooks = sorted((build.ROOT / "workbook").glob("*.ipynb"))
    failed = build.execute(notebooks, everything, jobs=1)
    return build.executed[:], [path.stem for path in failed]


def test_only_what_changed_is_executed(build):
    assert go(build) == (["00_a", "01_b"], [])
    assert go(build) == ([], [])
    save(build.ROOT / "workbook" / "01_b.ipynb", "1 + 2")
    assert go(build) == (["01_b"], [])
    assert go(build, everything=True) == (["00_a", "01_b"], [])


def test_a_package_that_no_notebook_uses_executes_nothing(build):
    """As the driver of a browser, which `run.py test` installs."""
    used = build.used_packages()
    assert {"nbformat", "traitlets"} <= set(used)
    assert not {"pytest", "sphinx", "statebook"} & set(used)


@pytest.mark.parametrize("what", ["library", "versions", "packages", "copy"])
def test_a_change_of_what_outputs_depend_on_executes_again(build, monkeypatch, what):
    go(build)
    if what == "library":
        (build.ROOT / "lib" / "a.py").write_text("x = 2\n")
    elif what == "versions":
        monkeypatch.setattr(build.platform, "python_version", lambda: "3.99.0")
    elif what == "packages":
        monkeypatch.setattr(build, "used_packages", lambda: {"nbformat": "99"})
    else:
        for path in build.EXECUTED.rglob("*.ipynb"):
            path.unlink()
    assert go(build) == (["00_a", "01_b"], [])


def test_a_clock_set_back_hides_no_change(build):
    """Files from now on look older than all that was made before."""
    go(build)
    page = build.ROOT / "page.md"
    page.write_text("one")
    source, doctrees = build.BUILD / "source", build.BUILD / "doctrees"
    build.gather({source / "page.md": page}, source, doctrees)
    doctrees.mkdir()
    tree = doctrees / "page.doctree"
    tree.touch()
    build.gather({source / "page.md": page}, source, doctrees)
    assert tree.exists()
    save(build.ROOT / "workbook" / "01_b.ipynb", "1 + 2")
    page.write_text("two")
    for path in build.ROOT.rglob("*"):
        os.utime(path, (1e9, 1e9))
    assert go(build) == (["01_b"], [])
    build.gather({source / "page.md": page}, source, doctrees)
    assert not tree.exists() and (source / "page.md").read_text() == "two"


def test_a_notebook_that_failed_is_executed_again_and_the_others_are_not(build):
    build.fails = {"01_b"}
    assert go(build) == (["00_a", "01_b"], ["01_b"])
    build.fails = set()
    assert go(build) == (["01_b"], [])


def test_what_an_interruption_leaves_is_used(build, monkeypatch):
    run_all = build.run_all

    def interrupted(paths, finish, **options):
        run_all(paths[:1], finish, **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(build, "run_all", interrupted)
    with pytest.raises(KeyboardInterrupt):
        go(build)
    monkeypatch.setattr(build, "run_all", run_all)
    assert go(build) == (["01_b"], [])


def test_the_old_site_stays_until_the_new_one_is_whole(build, monkeypatch):
    html = build.BUILD / "html"
    html.mkdir()
    (html / "index.html").write_text("old")
    (build.ROOT / "book").mkdir()
    (build.ROOT / "workbook" / "inventory.toml").write_text("")

    def sphinx(command, check):
        (build.BUILD / "site").mkdir(exist_ok=True)
        (build.BUILD / "site" / "index.html").write_text("new")
        if build.fails:
            raise build.subprocess.CalledProcessError(2, command)

    monkeypatch.setattr(build.subprocess, "run", sphinx)
    build.fails = {"sphinx"}
    with pytest.raises(build.subprocess.CalledProcessError):
        build.build([], [], [])
    assert (html / "index.html").read_text() == "old"
    build.fails = set()
    build.build([], [], [])
    assert (html / "index.html").read_text() == "new"
    assert not list(build.BUILD.glob("html.*"))


def test_the_old_site_comes_back_after_an_interruption_between_two_renamings(build):
    old, html = build.BUILD / "html.old", build.BUILD / "html"
    old.mkdir()
    build.restore()
    assert html.exists() and not old.exists()
    old.mkdir()
    build.restore()  # a whole new site is there: it stays
    assert html.exists() and old.exists()


def test_pages_of_notebooks_that_are_gone_go(build):
    go(build)
    source = build.BUILD / "source"
    save(source / "chapters" / "99_gone.ipynb", "1")
    kept = source / "chapters" / "00_a.ipynb"
    build.gather({kept: build.ROOT / "workbook" / "00_a.ipynb"}, source, build.BUILD)
    assert json.loads(kept.read_text())["cells"][0]["source"] in ("1 + 1", ["1 + 1"])
    assert not (source / "chapters" / "99_gone.ipynb").exists()
