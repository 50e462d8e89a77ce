"""How far numbers may be apart: defaults, settings, tags of a cell."""

import math
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import pytest

_TAG = "regression-"  # of a cell
_OPTION = "regression_"  # of pytest


class Tolerance(NamedTuple):
    """How far numbers may be apart.

    Parameters
    ----------
    rtol : float >= 0
        Relative to the number; in a figure, to the largest modulus in its array.
    atol : float >= 0
        Absolute.
    """

    rtol: float = 1e-5
    atol: float = 1e-12


def tolerance(text: str) -> float:
    """Read a tolerance.

    Parameters
    ----------
    text : str

    Returns
    -------
    value : float >= 0

    Raises
    ------
    ValueError
        If the text is not a finite number >= 0.

    Examples
    --------
    >>> tolerance("1e-3")
    0.001
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise ValueError(f"must be a number >= 0, got {text!r}")
    return value


def configured_tolerance(config: "pytest.Config") -> Tolerance:
    """The tolerance that the command line or else the ini file gives.

    Parameters
    ----------
    config : pytest.Config

    Returns
    -------
    tolerance : Tolerance

    Raises
    ------
    ValueError
        If a setting is not a finite number >= 0.
    """
    values = {}
    for name in Tolerance._fields:
        given = config.getoption(f"{_OPTION}{name}")
        try:
            values[name] = tolerance(config.getini(f"{_OPTION}{name}") if given is None else given)
        except ValueError as error:
            raise ValueError(f"{_OPTION}{name} {error}") from None
    return Tolerance(**values)


def tolerance_tags(cell: Any) -> dict[str, float]:
    """Tolerances that a cell's tags set, as ``regression-rtol=1e-3`` does.

    Parameters
    ----------
    cell : nbformat.NotebookNode

    Returns
    -------
    tolerances : dict
        Some of the fields of `Tolerance`.

    Raises
    ------
    ValueError
        If a tag begins with ``regression-`` and means nothing.
    """
    values = {}
    for tag in cell.metadata.get("tags", []):
        if not tag.startswith(_TAG):
            continue
        name, _, text = tag.removeprefix(_TAG).partition("=")
        if name not in Tolerance._fields:
            raise ValueError(f"tag {tag!r} is not known; write {_TAG}rtol=X or {_TAG}atol=X")
        try:
            values[name] = tolerance(text)
        except ValueError as error:
            raise ValueError(f"tag {tag!r}: {name} {error}") from None
    return values
