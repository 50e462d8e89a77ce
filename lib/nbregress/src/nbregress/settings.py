"""Settings of a run: defaults, ini files, pyproject.toml, command line, tags of a cell."""

import configparser
import importlib
import math
import os
import re
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from nbregress.patterns import NAMES

# pytest brings tomli along where Python has no tomllib.
tomllib = importlib.import_module("tomllib" if sys.version_info >= (3, 11) else "tomli")

_TAG = "regression-"  # of a cell
# Options of pytest that may stand in an ini file's addopts, and what they set here.
_ADDOPTS = {
    "--regression-rtol": "rtol",
    "--regression-atol": "atol",
    "--nbval-cell-timeout": "timeout",
    "--nbval-kernel-name": "kernel",
    "--nbval-sanitize-with": "sanitize_with",
}
_INI = ("pytest.ini", ".pytest.ini", "tox.ini", "setup.cfg")


class SettingsError(ValueError):
    """A setting that cannot be read; the message names it."""


@dataclass(frozen=True)
class Settings:
    """How notebooks are run and compared.

    Parameters
    ----------
    rtol : float >= 0
        Relative tolerance of a number; in a figure, of the range of its curve.
    atol : float >= 0
        Absolute tolerance.
    timeout : float > 0 [s]
        Longest time one cell may take.
    kernel : str, optional
        Name of the kernel; default: this Python, or what another language's notebook names.
    env : mapping of str to str
        Environment variables of the kernel.
    parameters : mapping
        Values assigned after the cell tagged ``parameters``.
    compare : tuple of str
        Noise patterns that are switched off: what they match is compared.
    sanitize : tuple of (str, str)
        Regular expressions and what replaces their matches before texts are compared.

    Examples
    --------
    >>> Settings().rtol
    1e-05
    """

    rtol: float = 1e-5
    atol: float = 0.0
    timeout: float = 300.0
    kernel: str | None = None
    env: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    compare: tuple[str, ...] = ()
    sanitize: tuple[tuple[str, str], ...] = ()

    def with_tags(self, cell: Any) -> "Settings":
        """Apply a cell's tags, such as ``regression-rtol=1e-3``.

        Parameters
        ----------
        cell : nbformat.NotebookNode

        Returns
        -------
        settings : Settings

        Raises
        ------
        SettingsError
            If a tag begins with ``regression-`` and means nothing.
        """
        given: dict[str, Any] = {}
        for tag in cell.metadata.get("tags", []):
            if not str(tag).startswith(_TAG):
                continue
            name, _, text = tag.removeprefix(_TAG).partition("=")
            if name not in ("rtol", "atol"):
                raise SettingsError(f"tag {tag!r} is not known; write {_TAG}rtol=X or {_TAG}atol=X")
            given[name] = _tolerance(f"tag {tag!r}: {name}", text)
        return replace(self, **given)


def load_settings(
    notebook: Path, given: Mapping[str, Any], ini: Mapping[str, Any] | None = None
) -> Settings:
    """Settings of one notebook.

    Parameters
    ----------
    notebook : pathlib.Path
    given : mapping
        What the command line sets, by the names of `Settings`, and ``sanitize_with``, a
        file of nbval's sanitizing patterns; None where it says nothing.
    ini : mapping, optional
        What pytest's ini file sets; default: looked up as pytest does.

    Returns
    -------
    settings : Settings
        The command line's before those of the nearest ``[tool.nbregress]`` in a
        pyproject.toml above the notebook, before the ini file's.

    Raises
    ------
    SettingsError
        If a setting is unknown or cannot be read.
    """
    notebook = Path(os.path.abspath(notebook))
    folders = list(notebook.parents)
    values = dict(_pytest_ini(folders) if ini is None else ini) | _project(folders, notebook)
    values |= {name: value for name, value in given.items() if value is not None}
    values = {name: value for name, value in values.items() if value is not None}
    pattern_file = values.pop("sanitize_with", None)
    known = {f.name for f in fields(Settings)}
    for name in values.keys() - known:
        raise SettingsError(
            f"setting {name!r} of nbregress is not known; there are {', '.join(sorted(known))}"
        )
    for name in ("rtol", "atol", "timeout"):
        if name in values:
            values[name] = _tolerance(name, values[name])
    if not values.get("timeout", 1.0):
        raise SettingsError("timeout must be positive, got 0")
    values["env"] = {str(k): str(v) for k, v in values.get("env", {}).items()}
    values["compare"] = tuple(values.get("compare", ()))
    for name in set(values["compare"]) - set(NAMES):
        raise SettingsError(f"noise {name!r} is not known; there are {', '.join(NAMES)}")
    if pattern_file:
        values["sanitize"] = _patterns(Path(pattern_file))
    return Settings(**values)


def _tolerance(name: str, text: Any) -> float:
    try:
        value = float(text)
    except (TypeError, ValueError):
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise SettingsError(f"{name} must be a number >= 0, got {text!r}")
    return value


def _patterns(path: Path) -> tuple[tuple[str, str], ...]:
    from nbval.plugin import get_sanitize_patterns

    try:
        pairs = get_sanitize_patterns(path.read_text(encoding="utf-8"))
        return tuple((re.compile(regex).pattern, new) for regex, new in pairs)
    except (OSError, re.error) as error:
        raise SettingsError(f"sanitizing patterns in {path} cannot be read: {error}") from None


def _toml(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            return tomllib.load(file).get("tool", {})
    except FileNotFoundError:
        return {}
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise SettingsError(f"{path} cannot be read: {error}") from None


def _project(folders: list[Path], notebook: Path) -> dict[str, Any]:
    """The nearest [tool.nbregress], with its overrides for this notebook."""
    for folder in folders:
        table = _toml(folder / "pyproject.toml").get("nbregress")
        if table is None:
            continue
        table = dict(table)
        name = notebook.relative_to(folder)
        for override in table.pop("overrides", []):
            override = dict(override)
            pattern = override.pop("match", None)
            if not isinstance(pattern, str):
                raise SettingsError(
                    "each [[tool.nbregress.overrides]] needs match = 'folder/*.ipynb'"
                )
            if any(part.match(pattern) for part in (name, *name.parents)):
                table |= override
        if "sanitize_with" in table:
            table["sanitize_with"] = folder / table["sanitize_with"]
        return table
    return {}


def _pytest_ini(folders: list[Path]) -> dict[str, Any]:
    """What the ini file that pytest would use says, its addopts included."""
    for folder in folders:
        found = _toml(folder / "pyproject.toml").get("pytest", {}).get("ini_options")
        parser = configparser.RawConfigParser(strict=False)
        try:
            parser.read([folder / name for name in reversed(_INI)], encoding="utf-8")
        except (configparser.Error, UnicodeDecodeError):
            continue  # pytest has the better message
        for section in ("tool:pytest", "pytest"):
            found = dict(parser[section]) if parser.has_section(section) else found
        if found is not None:
            return _from_ini(found, folder)
    return {}


def _from_ini(found: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    values = {name: found.get(f"regression_{name}") for name in ("rtol", "atol")}
    options = found.get("addopts", [])
    words = shlex.split(options) if isinstance(options, str) else [str(word) for word in options]
    for word, after in zip(words, [*words[1:], ""], strict=False):
        option, equals, value = word.partition("=")
        if option in _ADDOPTS:
            values[_ADDOPTS[option]] = value if equals else after
    if values.get("sanitize_with"):
        values["sanitize_with"] = folder / str(values["sanitize_with"])
    return values
