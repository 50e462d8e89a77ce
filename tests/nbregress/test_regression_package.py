"""nbregress as a package of its own: what it brings, needs and leaves out."""

import ast
import os
import shutil
import subprocess
import sys
import zipfile
from email import message_from_string
from fnmatch import fnmatch
from graphlib import TopologicalSorter
from pathlib import Path

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_notebook

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "lib" / "nbregress" / "src"
MODULES = sorted((SOURCE / "nbregress").rglob("*.py"))
BUILD = "import sys\nfrom setuptools import build_meta\nprint(build_meta.build_wheel(sys.argv[1]))"
UNBUILT = shutil.ignore_patterns("build", "dist", "*.egg-info", "__pycache__")


def python(*arguments, path=(), cwd=None):
    """Run this Python with folders before all others on its path, and nbregress among them."""
    folders = [*map(str, path), str(SOURCE), os.environ.get("PYTHONPATH", "")]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, folders))}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True)


# ---- the wheels ----


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """Both packages' wheels, built from a copy: their files by name."""
    folder = tmp_path_factory.mktemp("wheels")
    root = folder / "root"
    shutil.copytree(ROOT / "lib", root / "lib", ignore=UNBUILT)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, root)
    found = {}
    for package, place in (("statebook", root), ("nbregress", root / "lib" / "nbregress")):
        done = python("-c", BUILD, folder, cwd=place)
        assert done.returncode == 0, done.stderr
        (wheel,) = folder.glob(f"{package}-*.whl")
        with zipfile.ZipFile(wheel) as archive:
            found[package] = {name: archive.read(name) for name in archive.namelist()}
    return found


@pytest.mark.parametrize("package", ["statebook", "nbregress"])
def test_a_wheel_holds_its_own_package_and_no_other(wheels, package):
    source = {"statebook": ROOT / "lib", "nbregress": SOURCE}[package]
    assert [name for name in wheels[package] if not fnmatch(name, f"{package}*/*")] == []
    files = [path for path in (source / package).rglob("*") if path.suffix in (".py", ".pyi")]
    wanted = {path.relative_to(source).as_posix() for path in files}
    assert wanted <= wheels[package].keys()


def metadata(files):
    (name,) = (name for name in files if name.endswith(".dist-info/METADATA"))
    return message_from_string(files[name].decode("utf-8"))


def entry_points(files):
    return [files[name].decode("utf-8") for name in files if name.endswith("/entry_points.txt")]


def test_only_nbregress_brings_a_pytest_plugin(wheels):
    assert entry_points(wheels["statebook"]) == []
    command = "[console_scripts]\nnbregress = nbregress.__main__:main\n\n"
    plugin = "[pytest11]\nnbregress = nbregress.plugin\n"
    assert entry_points(wheels["nbregress"]) == [command + plugin]


def test_neither_package_asks_for_the_other(wheels):
    needs = {name: " ".join(metadata(f).get_all("Requires-Dist")) for name, f in wheels.items()}
    assert "nbregress" not in needs["statebook"]
    heavy = ("statebook", "control", "scipy", "toppra", "matplotlib", "tqdm")
    assert [name for name in heavy if name in needs["nbregress"]] == []


def test_nbregress_is_typed_and_licensed(wheels):
    assert "nbregress/py.typed" in wheels["nbregress"]
    assert metadata(wheels["nbregress"])["License-Expression"] == "Apache-2.0"


# ---- what imports what ----


def imports(path):
    """Names of the modules that a module imports: when it is loaded, and later."""
    first, later = set(), set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "imports are absolute"
            names = [node.module]
        else:
            continue
        (first if node in tree.body else later).update(names)
    return first, later


def test_imports_only_go_down():
    graph = {}
    for path in MODULES:
        name = "nbregress" if path.stem == "__init__" else f"nbregress.{path.stem}"
        graph[name] = {m for part in imports(path) for m in part if m.startswith("nbregress.")}
    assert "nbregress.items" in graph["nbregress.plugin"]
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the modules


def test_matplotlib_is_imported_late_and_statebook_never():
    for path in MODULES:
        first, later = imports(path)
        roots = {name.partition(".")[0] for name in first}
        assert "matplotlib" not in roots, path.name
        assert not {"statebook", "control", "scipy", "toppra"} & {
            name.partition(".")[0] for name in first | later
        }, path.name


# ---- where something is missing ----


@pytest.mark.parametrize("missing", ["nbclient", "nbformat", "ipykernel"])
def test_a_missing_package_is_named(tmp_path, missing):
    """In one sentence, without a traceback."""
    absent(tmp_path, missing)
    done = python("-m", "nbregress", "refresh", "a.ipynb", path=[tmp_path], cwd=tmp_path)
    assert done.returncode == 1
    assert f"nbregress needs the package {missing}," in done.stderr
    assert done.stderr.endswith(f"-m pip install {missing}\n") and done.stderr.count("\n") == 1


def absent(folder, name):
    """Let a package seem not to be installed for a Python that finds this folder first."""
    text = f"raise ModuleNotFoundError(\"No module named '{name}'\", name={name!r})\n"
    (folder / f"{name}.py").write_text(text)


def test_a_notebook_without_figures_needs_no_matplotlib(tmp_path):
    absent(tmp_path, "matplotlib")
    sources = [
        "%load_ext nbregress",
        "try:\n    import matplotlib\nexcept ImportError as error:\n    print(error)",
        "0.1 + 0.2",
    ]
    nbformat.write(new_notebook(cells=list(map(new_code_cell, sources))), tmp_path / "a.ipynb")
    done = python("-m", "nbregress", "refresh", "a.ipynb", path=[tmp_path], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    stored = nbformat.read(tmp_path / "a.ipynb", as_version=4)
    assert stored.cells[0].outputs == []
    assert stored.cells[1].outputs[0].text == "No module named 'matplotlib'\n"
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    options = ["-q", "-p", "no:cacheprovider", "--nb"]
    done = python("-m", "pytest", *options, "a.ipynb", path=[tmp_path], cwd=tmp_path)
    assert "3 passed" in done.stdout, done.stdout + done.stderr
