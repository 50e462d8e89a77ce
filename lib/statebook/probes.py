"""What a plain function can do, found by calling it."""

import inspect
import re
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from statebook._validate import brief

_TIMES = (0.0, 1e-3, 0.7310586, 4.269, 61.803, 2718.28)
_INPUTS = 12  # up to which the number of a function's inputs is looked for


def is_time(name: str) -> bool:
    """Whether an argument of this name is a time: t, time, _t, time_s."""
    return re.fullmatch(r"_*(t|time)(_\w*)?", name) is not None


def positional(f: Callable[..., Any]) -> tuple[list[str], int, bool] | None:
    """Return a function's positional arguments, how many it requires, whether it takes more.

    None of what is built in C: there is nothing to read.
    """
    code = getattr(f, "__code__", None)
    if code is not None and not (code.co_flags & 0x0C or code.co_kwonlyargcount):
        # Much faster than a signature, and most functions are this plain.
        names = list(code.co_varnames[: code.co_argcount])
        required = len(names) - len(getattr(f, "__defaults__", None) or ())
        bound = inspect.ismethod(f)
        return names[bound:], max(required - bound, 0), False
    try:
        parameters = inspect.signature(f).parameters.values()
    except (TypeError, ValueError):
        return None
    kinds = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    required = sum(p.default is p.empty for p in kinds)
    return [p.name for p in kinds], required, any(p.kind is p.VAR_POSITIONAL for p in parameters)


def arguments_of(f: Callable[..., Any]) -> tuple[int, int]:
    """Return how many of x, u, t the function requires and how many it accepts.

    Raises
    ------
    TypeError
        It takes the time first, x and the time alone, or something else.
    """
    names, required, variadic = positional(f) or (["x", "u"], 1, False)
    given = ", ".join(names)
    times = [is_time(name) for name in names]
    if len(names) > 1 and (times[0] or (required == 2 and times[1])):
        order = "x, u, t" if len(names) > 2 else "x, t"
        raise TypeError(
            f"a system's function must take (x), (x, u) or (x, u, t), got one of ({given}), with"
            f" the time in another place; write lambda x, u, t: f({', '.join(names[:3])})"
            + ("" if order == "x, u, t" else " and leave u0 out")
        )
    if required > 3 or not (names or variadic):
        raise TypeError(
            f"a system's function must take (x), (x, u) or (x, u, t), got {required} required"
            " arguments; bind the others first (functools.partial)"
        )
    timed = len(names) > 2 and (required == 3 or times[2])
    accepted = 2 if variadic else 3 if timed else min(len(names), 2)
    return max(required, 1), accepted


def number_of_inputs(call: Callable[[np.ndarray], Any], n: int) -> int | None:
    """Return how many inputs a function takes, or None where that is not clear.

    Parameters
    ----------
    call : callable
        The function of u at a given state; it raises where u has too few entries.
    n : int
        Number of states, the length of what it returns.
    """

    def returned(u: np.ndarray) -> np.ndarray | None:
        try:
            value = np.asarray(call(u), dtype=float)
        except Exception:  # an entry that u does not have, a matrix of another width
            return None
        return value if value.shape == (n,) else None

    drive = 0.3 + 0.1 * np.arange(_INPUTS + 1)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        results = [returned(drive[:m]) for m in range(_INPUTS + 1)]
    works = [(m, value) for m, value in enumerate(results) if value is not None]
    if not works:
        return None
    fewest, first = works[0]
    alike = all(np.array_equal(value, first, equal_nan=True) for _, value in works)
    return fewest if alike else None


def require_pure(f: Callable[..., Any], arguments: tuple[np.ndarray, ...]) -> None:
    """Refuse a function that changes its arguments or remembers its last call."""
    copies = [a.copy() for a in arguments]
    first = f(*copies)
    _require_unchanged(arguments, copies)
    # An equilibrium at 0 hides both a memory (of 0) and x *= 2: call f beside it in between.
    beside = [a + 1e-3 * (1 + np.abs(a)) for a in arguments]
    copies = [a.copy() for a in beside]
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            f(*copies)
        except Exception:  # outside its domain, whatever it raises there
            copies = beside
    _require_unchanged(beside, copies)
    second = f(*(a.copy() for a in arguments))
    if first.dtype.kind in "biufc" and not np.array_equal(first, second, equal_nan=True):
        raise ValueError(
            "a system's function must depend on its arguments alone, but two calls at"
            f" x = {brief(arguments[0])} gave {brief(first)} and {brief(second)};"
            " make its memory part of the state"
        )


def _require_unchanged(arguments: Sequence[np.ndarray], copies: Sequence[np.ndarray]) -> None:
    if any((a != b).any() for a, b in zip(arguments, copies, strict=True)):
        raise ValueError(
            "a system's function must leave its arguments alone, but it changed one in place;"
            " work on a copy (x = x.copy())"
        )


def takes_batches(
    function: Callable[..., Any], *batches: np.ndarray, alone: Callable[..., Any], rtol: float
) -> bool:
    """Whether a function of batches gives what `alone` gives for their columns, one by one.

    Parameters
    ----------
    function : callable
        Called once with the batches; whatever it raises means no.
    *batches : array, shape (k, N)
        One batch for each argument. The columns should differ, or a function that mixes them up
        would pass; so should N from all other dimensions, or a transposed result would pass.
    alone : callable
        The same function for single columns (k,), which returns (r,).
    rtol : float
        Relative tolerance of the comparison.

    Examples
    --------
    >>> takes_batches(np.sin, np.eye(2, 3), alone=np.sin, rtol=1e-12)
    True
    >>> takes_batches(np.sort, np.eye(2, 3), alone=np.sort, rtol=1e-12)
    False
    """
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            batch = np.array(function(*batches))
            columns = [np.array(alone(*c)) for c in zip(*(b.T for b in batches), strict=True)]
        except Exception:  # whatever a function does with an array it was not written for
            return False
    expected = np.stack(columns, axis=-1) if len({c.shape for c in columns}) == 1 else None
    if expected is None or batch.shape != expected.shape:
        return False
    # Equal to the bit, most are: that is found much faster.
    same = bool((batch == expected).all())
    return same or np.allclose(batch, expected, rtol=rtol, atol=0, equal_nan=True)


def depends_on_time(
    f: Callable[[np.ndarray, np.ndarray, float], Any], x: np.ndarray, u: np.ndarray
) -> bool:
    """Whether f(x, u, t) differs between times, beside x (where t x does not vanish) or at x."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        for near in (0.1, -0.1, 0.0):
            state, drive = (a + near * (1 + np.abs(a)) for a in (x, u))
            try:
                values = [np.array(f(state, drive, t)) for t in _TIMES]
            except Exception:  # outside its domain; what it raises at x itself, its caller shows
                continue
            return not all(np.array_equal(values[0], v, equal_nan=True) for v in values)
    return False


def spread_beside(x: np.ndarray, number: int) -> np.ndarray:
    """Return `number` different columns beside x, (n, number), the first of them x."""
    return x[:, None] + (1 + np.abs(x))[:, None] * np.linspace(0, 1e-3, number)


def copied(value: Any) -> np.ndarray:
    """Return what a function returned, which may be its buffer, as another array."""
    try:
        return np.array(value)
    except (TypeError, ValueError) as error:
        rule = "a system's function must return one number for each state"
        rows = [np.shape(row) for row in value] if isinstance(value, list | tuple) else []
        odd = next((i for i, shape in enumerate(rows) if shape != rows[0] or shape), None)
        if odd is None:  # quantities with units, an object with an __array__ of its own
            raise TypeError(f"{rule}, got {value!r}; convert it to floats ({error})") from None
        raise TypeError(
            f"{rule}, got rows of the shapes"
            f" {', '.join(map(str, rows))}; in row {odd} write u[0] instead of u, say ({error})"
        ) from None
