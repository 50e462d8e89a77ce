"""Both distributions as others get them: built, installed into an empty environment, tested there.

    python tests/installed.py                      wheels, the newest packages
    python tests/installed.py --sdist --oldest     sources, every lower bound of requirements.txt
    python tests/installed.py --python 3.13 -- -k pendulum     other arguments for pytest

The tests run in a folder of their own that knows nothing of the checkout: the doctests of the
installed packages, and the unit tests that read no file of the repository. Needs the package
index; uv, where there is one, makes it quick.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matrix

ROOT = Path(__file__).resolve().parents[1]
PROJECTS = (ROOT, ROOT / "lib" / "nbregress")
HELPERS = "built|run|ledger|planted|matrix|house|pattern"
LOCAL = re.compile(rf"\bROOT\b|\bparents?\[|PYTHONPATH|\b(from|import) ({HELPERS})\b")
INI = """[pytest]
filterwarnings =
    error
    ignore:'\\w+' (argument is )?deprecated.* use '\\w+':DeprecationWarning
    ignore:Setting the shape on a NumPy array:DeprecationWarning:control
"""
BUILD = "import sys, setuptools.build_meta as b; getattr(b, sys.argv[1])(sys.argv[2])"


def packed(folder: Path, kind: str) -> list[str]:
    """Build both distributions from copies of their sources; return the files."""
    for project in PROJECTS:
        copy = folder / f"source_{project.name}"
        skip = shutil.ignore_patterns(".*", "_build", "build", "*.egg-info", "workbook", "tests")
        shutil.copytree(project, copy, ignore=skip)
        command = [sys.executable, "-c", BUILD, f"build_{kind}", str(folder)]
        subprocess.run(command, cwd=copy, check=True, stdout=subprocess.DEVNULL)
    return [str(p) for p in folder.iterdir() if p.name.endswith((".whl", ".tar.gz"))]


def installed(folder: Path, files: list[str], python: str, oldest: bool) -> Path:
    """Make an environment with these files and what the tests need; return its interpreter."""
    text = (ROOT / "requirements.txt").read_text(encoding="utf-8")
    wanted = matrix.oldest(text) if oldest else text
    (folder / "wanted.txt").write_text(wanted, encoding="utf-8")
    venv = folder / "venv"
    inside = venv / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if uv := shutil.which("uv"):
        subprocess.run([uv, "venv", "-q", "--python", python, str(venv)], check=True)
        pip = [uv, "pip", "install", "-q", "--python", str(inside)]
    else:
        subprocess.run([f"python{python}", "-m", "venv", str(venv)], check=True)
        pip = [str(inside), "-m", "pip", "install", "-q"]
    subprocess.run([*pip, "-r", str(folder / "wanted.txt"), *files], check=True)
    return inside


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sdist", action="store_true", help="sources instead of wheels")
    parser.add_argument("--oldest", action="store_true", help="the lower bounds of all packages")
    parser.add_argument("--python", default="{}.{}".format(*sys.version_info))
    parser.add_argument("pytest", nargs="*", help="arguments for pytest, after --")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = packed(folder, "sdist" if options.sdist else "wheel")
        python = installed(folder, files, options.python, options.oldest)
        print("built and installed:", *(Path(f).name for f in files), flush=True)
        tests = folder / "tests"
        shutil.copytree(ROOT / "tests", tests, ignore=shutil.ignore_patterns("__pycache__"))
        for path in tests.rglob("*.py"):
            if path.name.startswith("test_") and LOCAL.search(path.read_text(encoding="utf-8")):
                path.unlink()
        shutil.copy(ROOT / "conftest.py", tests)
        (tests / "pytest.ini").write_text(INI, encoding="utf-8")
        options_ = ["-q", "-p", "no:cacheprovider", "--doctest-modules", "--pyargs"]
        command = [str(python), "-m", "pytest", *options_, "statebook", "nbregress", "."]
        environment = {
            k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")
        }
        return subprocess.call([*command, *options.pytest], cwd=tests, env=environment)


if __name__ == "__main__":
    sys.exit(main())
