"""Assertions that print one stable line and say which rows of the ledger they cover."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from statebook import _validate

_NOISE = 1e-10  # a value below this may be rounding alone, which differs between machines


def check(
    name: str,
    value: Any,
    expected: Any,
    *,
    relation: str = "==",
    rtol: float = 1e-9,
    atol: float = 0.0,
    covers: Sequence[str] = (),
) -> None:
    """Assert a claim and print it as one stable line.

    value and expected agree when abs(value - expected) <= atol + rtol abs(expected) in
    every entry; "differs" holds when they disagree in at least one. Texts and truth values
    are compared exactly.

    Parameters
    ----------
    name : str
        The claim in words.
    value, expected : number, array, str or bool
        What was computed, and what something else says it must be. They broadcast.
    relation : {"==", "<", ">", "differs"}
        "<" and ">" are strict, hold for every entry and use no tolerance.
    rtol, atol : float >= 0
        Relative and absolute tolerance.
    covers : sequence of str
        Rows of workbook/inventory.toml, for example ("22", "E3").

    Raises
    ------
    AssertionError
        The claim does not hold.
    TypeError, ValueError
        An argument is no claim: an unknown relation, NaN, an empty array, an order of complex
        numbers.

    Examples
    --------
    >>> check("frequency [rad/s]", 3.122499, (10 - 1 / 4) ** 0.5, rtol=1e-6, covers=["36"])
    ok  frequency [rad/s]: 3.122 (rtol 1e-06)  [36]
    """
    _validate.choice("relation", relation, ("==", "<", ">", "differs"))
    rtol, atol = _validate.non_negative("rtol", rtol), _validate.non_negative("atol", atol)
    if isinstance(covers, str):
        raise TypeError(f"covers must be a sequence of rows; write covers=({covers!r},)")
    exact = _is_exact(value) or _is_exact(expected)
    if exact:
        if relation in "<>":
            raise TypeError(f"{name}: {relation} needs numbers, got {value!r} and {expected!r}")
        agree = value == expected
    else:
        value, expected = _numbers(name, value), _numbers(name, expected)
        agree = bool(np.all(np.isclose(value, expected, rtol=rtol, atol=atol)))
    if relation in "<>" and (np.iscomplexobj(value) or np.iscomplexobj(expected)):
        raise TypeError(
            f"{name}: {relation} needs real numbers, got complex ones, which have no order;"
            " compare their real parts or sizes"
        )
    if relation in "<>":
        holds = bool(np.all(value < expected if relation == "<" else value > expected))
    else:
        holds = agree == (relation == "==")
    tolerance = "" if exact or relation in "<>" else _tolerance(expected, rtol, atol)
    if not holds:
        raise AssertionError(
            f"{name}: {_worst(value, expected, relation)} does not hold{tolerance}"
        )
    # What agrees is printed once, in the digits of the expectation: they are the stable ones.
    claim = _text(expected, {"==": atol, "differs": _NOISE}.get(relation, 0.0))
    if relation != "==":
        claim = f"{_text(value, _NOISE)} {relation} {claim}"
    elif np.size(value) > np.size(expected):
        claim = f"{np.size(value)} values, all {claim}"
    rows = f"  [{', '.join(covers)}]" if covers else ""
    print(f"ok  {name}: {claim}{tolerance}{rows}")


def _is_exact(value: Any) -> bool:
    return isinstance(value, str | bool | np.bool_)


def _numbers(name: str, value: Any) -> np.ndarray:
    if isinstance(value, float) and np.isinf(value):
        return np.asarray(value)  # a legitimate result: an infinite critical step
    result = _validate.array(name, value)
    if result.size == 0:
        raise ValueError(f"{name}: nothing to compare, got an empty array")
    return result


def _worst(value: Any, expected: Any, relation: str) -> str:
    """Return the claim, of large arrays at the entry where it is farthest from holding."""
    if np.size(value) <= 4 or relation == "differs":
        return f"{value} {relation} {expected}"
    value, expected = np.broadcast_arrays(value, expected)
    excess = {"==": np.abs(value - expected), "<": value - expected, ">": expected - value}
    index = np.unravel_index(np.argmax(excess[relation]), value.shape)
    place = ", ".join(str(i) for i in index)
    return f"at [{place}]: {value[index]} {relation} {expected[index]}"


def _tolerance(expected: np.ndarray, rtol: float, atol: float) -> str:
    """Return the tolerance that matters in words: the wider of the two."""
    if rtol == atol == 0:
        return " (exactly)"
    if atol > rtol * float(np.max(np.abs(expected))):
        return f" (atol {atol:g})"
    return f" (rtol {rtol:g})"


def _text(value: Any, floor: float) -> str:
    """Return value in four significant digits, and 0 for what is below the floor."""
    if _is_exact(value):
        return str(value)
    value = np.asarray(value)
    if value.size > 4:
        low, high = (_text(f(np.abs(value)), floor) for f in (np.min, np.max))
        return f"{value.size} values of size {low} to {high}"
    if value.ndim:
        return "[" + ", ".join(_text(entry, floor) for entry in value.ravel()) + "]"
    parts = [part if abs(part) > floor else 0.0 for part in (value.real, value.imag)]
    if np.iscomplexobj(value):
        return f"{parts[0]:.4g}{parts[1]:+.4g}j"
    return f"{parts[0]:.4g}"
