"""Checks that print one stable line each, and their summary at the end of a notebook."""

import sys
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from statebook import _validate

_NOISE = 1e-10  # a value below this may be rounding alone, which differs between machines


@dataclass(frozen=True, eq=False)
class Claim:
    """A claim as it was checked, kept for the summary.

    Attributes
    ----------
    name : str
    value, expected : number, array, str or bool
    relation : str
    rtol, atol : float
    run : int
        Number of the notebook cell's execution; 0 outside a notebook.
    failure : str
        Why it does not hold, or nothing.
    """

    name: str
    value: Any
    expected: Any
    relation: str
    rtol: float
    atol: float
    run: int
    failure: str


_claims: list[Claim] = []


def check(
    name: str,
    value: Any,
    expected: Any,
    *,
    relation: str = "==",
    rtol: float = 1e-9,
    atol: float = 0.0,
) -> None:
    """Check a claim and print it as one stable line.

    value and expected agree when abs(value - expected) <= atol + rtol abs(expected) in
    every entry; "differs" holds when they disagree in at least one. Texts and truth values
    are compared exactly. A claim that does not hold prints a line that begins with FAILED, and
    the notebook goes on; `summary`, its last cell, raises.

    Parameters
    ----------
    name : str
        The claim in words.
    value, expected : number, array, str or bool
        What was computed, and what something else says it must be. They broadcast. A claim about
        NaN, or about an empty array, does not hold.
    relation : {"==", "<", ">", "differs"}
        "<" and ">" are strict, hold for every entry and use no tolerance.
    rtol, atol : float >= 0
        Relative and absolute tolerance.

    Raises
    ------
    TypeError, ValueError
        The arguments make no claim: an unknown relation, a negative tolerance, an order of texts
        or of complex numbers, something that is neither number, text nor truth value.

    Examples
    --------
    >>> check("frequency [rad/s]", 3.122499, (10 - 1 / 4) ** 0.5, rtol=1e-6)
    ok  frequency [rad/s]: 3.122 (rtol 1e-06)
    """
    _validate.choice("relation", relation, ("==", "<", ">", "differs"))
    rtol, atol = _validate.non_negative("rtol", rtol), _validate.non_negative("atol", atol)
    failure, line = _judged(name, value, expected, relation, rtol, atol)
    run = _run()
    # A cell that is executed again replaces what it said before.
    _claims[:] = [claim for claim in _claims if claim.name != name or claim.run == run]
    _claims.append(Claim(name, value, expected, relation, rtol, atol, run, failure))
    print(f"FAILED  {name}: {failure}" if failure else f"ok  {name}: {line}")


def summary() -> None:
    """Say whether every check since the last summary holds, and raise if one does not.

    Raises
    ------
    AssertionError
        A check failed; the message names each.

    Examples
    --------
    >>> check("two", 1 + 1, 2)
    ok  two: 2 (rtol 1e-09)
    >>> summary()  # doctest: +ELLIPSIS
    All checks hold (...).
    """
    claims, _claims[:] = list(_claims), []
    failed = [claim for claim in claims if claim.failure]
    if failed:
        names = "".join(f"\n  {claim.name}: {claim.failure}" for claim in failed)
        raise AssertionError(f"{len(failed)} of {len(claims)} checks failed:{names}")
    print(f"All checks hold ({len(claims)}).")


def recorded() -> tuple[Claim, ...]:
    """Return the claims since the last summary."""
    return tuple(_claims)


def verdict_on(claim: Claim, value: Any) -> str:
    """Return why a claim would not hold of another value, or nothing."""
    return _judged(claim.name, value, claim.expected, claim.relation, claim.rtol, claim.atol)[0]


def _judged(
    name: str, value: Any, expected: Any, relation: str, rtol: float, atol: float
) -> tuple[str, str]:
    """Return why a claim does not hold, or nothing, and the claim in words."""
    exact = _is_exact(value) or _is_exact(expected)
    if exact:
        if relation in "<>":
            raise TypeError(f"{name}: {relation} needs numbers, got {value!r} and {expected!r}")
        agree = value == expected
    else:
        value, expected = _numbers(name, value), _numbers(name, expected)
        if relation in "<>" and (np.iscomplexobj(value) or np.iscomplexobj(expected)):
            raise TypeError(
                f"{name}: {relation} needs real numbers, got complex ones, which have no order;"
                " compare their real parts or sizes"
            )
        if value.size == 0 or expected.size == 0:
            return "there is nothing to compare, got an empty array", ""
        if np.isnan(value).any() or np.isnan(expected).any():
            return f"{value} {relation} {expected} does not hold: NaN is no result", ""
        # isclose would round large integers.
        same = np.equal if rtol == atol == 0 else partial(np.isclose, rtol=rtol, atol=atol)
        try:
            agree = bool(np.all(same(value, expected)))
        except ValueError:
            raise ValueError(f"{name}: shapes {value.shape}, {expected.shape} must agree") from None
    if relation in "<>":
        holds = bool(np.all(value < expected if relation == "<" else value > expected))
    else:
        holds = agree == (relation == "==")
    tolerance = "" if exact or relation in "<>" else _tolerance(expected, rtol, atol)
    if not holds:
        return f"{_worst(value, expected, relation)} does not hold{tolerance}", ""
    # What agrees is printed once, in the digits of the expectation: they are the stable ones.
    words = _text(expected, {"==": atol, "differs": _NOISE}.get(relation, 0.0))
    if relation != "==":
        words = f"{_text(value, _NOISE)} {relation} {words}"
    elif np.size(value) > np.size(expected):
        words = f"{np.size(value)} values, all {words}"
    return "", words + tolerance


def _run() -> int:
    """Number of the execution in which a notebook's cell runs; 0 elsewhere."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return int(getattr(shell, "execution_count", 0))


def _is_exact(value: Any) -> bool:
    return isinstance(value, str | bool | np.bool_)


def _numbers(name: str, value: Any) -> np.ndarray:
    try:
        result = np.asarray(value)
    except ValueError as error:
        raise TypeError(f"{name} must be about numbers, got ragged rows: {value!r}") from error
    if result.dtype.kind not in "biufc":
        raise TypeError(f"{name} must be about numbers, texts or truth values, got {value!r}")
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
    real = f"{parts[0]:.4g}"
    return f"{real}{parts[1]:+.4g}j" if np.iscomplexobj(value) else real
