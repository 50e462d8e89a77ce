"""Checks of callers' arguments: each error names the argument, the rule and what arrived."""

import numbers
from collections.abc import Collection
from typing import Any, TypeVar

import numpy as np

_Kind = TypeVar("_Kind")


def array(name: str, value: Any, shape: tuple[int | None, ...] | None = None) -> np.ndarray:
    """Return value as a finite float or complex array of a shape.

    Parameters
    ----------
    name : str
        The argument's name, for the error message.
    value : array_like
        Numbers, fractions, decimals or SymPy's constants; anything else is refused.
    shape : tuple of int or None, optional
        Required shape; None in it stands for any length, None instead of it for any shape.

    Returns
    -------
    numpy.ndarray
        dtype float64 or complex128. Not a copy where none is needed.

    Raises
    ------
    TypeError
        The value does not consist of numbers.
    ValueError
        The shape is wrong, or an entry is NaN, infinite or masked.

    Examples
    --------
    >>> array("x0", [1, 2], (2,))
    array([1., 2.])
    """
    try:
        result = np.asarray(value)
    except ValueError as error:
        raise TypeError(
            f"{name} must be an array of numbers, got ragged rows: {value!r}"
        ) from error
    if np.ma.is_masked(value):
        raise ValueError(f"{name} must have no masked entries; fill them first: .filled(...)")
    if result.dtype.kind == "O" and not any(isinstance(x, str | bytes) for x in result.flat):
        try:
            result = np.array([complex(x) for x in result.flat]).reshape(result.shape)
        except OverflowError as error:
            raise ValueError(f"{name} must be finite, got a number beyond 1.8e308") from error
        except (TypeError, ValueError):
            pass
        else:
            result = result if result.imag.any() else result.real
    if result.dtype.kind not in "biufc":
        raise TypeError(f"{name} must be an array of numbers, got {value!r}")
    result = np.asarray(result, dtype=complex if result.dtype.kind == "c" else float)
    if shape is not None and not matches(result.shape, shape):
        wanted = "(" + ", ".join("any" if s is None else str(s) for s in shape)
        wanted += ",)" if len(shape) == 1 else ")"
        raise ValueError(f"{name} must have shape {wanted}, got {result.shape}")
    if not np.isfinite(result).all():
        raise ValueError(f"{name} must be finite, got {result[~np.isfinite(result)][0]} in it")
    return result


def matches(shape: tuple[int, ...], required: tuple[int | None, ...]) -> bool:
    """Whether a shape agrees with one in which None stands for any length."""
    return len(shape) == len(required) and all(
        r is None or r == s for s, r in zip(shape, required, strict=True)
    )


def real_array(name: str, value: Any, shape: tuple[int | None, ...] | None = None) -> np.ndarray:
    """Return value as a finite float array; complex numbers are refused too."""
    result = array(name, value, shape)
    if np.iscomplexobj(result):
        raise TypeError(f"{name} must be real, got complex numbers")
    return result


def vectors(name: str, value: Any, n: int | str) -> np.ndarray:
    """Return value as an array (n,) or (n, N); n is a number, or a letter for any."""
    result = array(name, value)
    if result.ndim not in (1, 2) or len(result) != (len(result) if isinstance(n, str) else n):
        raise ValueError(f"{name} must have shape ({n},) or ({n}, N), got {result.shape}")
    return result


def state_and_input(x: Any, u: Any, n: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    """Return x, (n,) or (n, N), and u, (m,) or (m, N), as arrays; u None is zeros."""
    x = vectors("x", x, n)
    u = np.zeros(m) if u is None else array("u", u)
    if u.shape not in ((m,), (m, *x.shape[1:])):
        batch = f" or {(m, *x.shape[1:])}" if x.ndim == 2 else ""
        raise ValueError(f"u must have shape {(m,)}{batch}, got {u.shape}")
    return x, u


def number(name: str, value: Any) -> float:
    """Return value as a finite real float."""
    if isinstance(value, np.ndarray):
        if value.ndim:
            raise TypeError(f"{name} must be a single number, got an array of shape {value.shape}")
        value = value[()]
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Real):
        raise TypeError(f"{name} must be a real number, got {value!r}")
    # 0.1 of single precision means 0.1, not 0.10000000149: ticks of clocks depend on it.
    result = float(str(value) if isinstance(value, np.float32 | np.float16) else value)
    if not np.isfinite(result):
        raise ValueError(f"{name} must be finite, got {result}")
    return result


def positive(name: str, value: Any) -> float:
    """Return value as a finite float greater than zero."""
    result = number(name, value)
    if result <= 0:
        raise ValueError(f"{name} must be greater than 0, got {result:g}")
    return result


def non_negative(name: str, value: Any) -> float:
    """Return value as a finite float of at least zero."""
    result = number(name, value)
    if result < 0:
        raise ValueError(f"{name} must be at least 0, got {result:g}")
    return result


def integer(name: str, value: Any, minimum: int = 0) -> int:
    """Return value as an int of at least minimum."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Integral):
        raise TypeError(f"{name} must be an integer, got {value!r}")
    if value < minimum:
        raise ValueError(f"{name} must be at least {minimum}, got {value}")
    return int(value)


def choice(name: str, value: Any, options: Collection[str]) -> str:
    """Return value if it is one of the options."""
    if value not in options:
        raise ValueError(f"{name} must be one of {', '.join(options)}; got {value!r}")
    return value


def instance(name: str, value: _Kind, kind: type[_Kind]) -> _Kind:
    """Return value if it is of a kind."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} must be a {kind.__name__}, got {type(value).__name__}")
    return value


def interval(name: str, ends: Any) -> tuple[float, float]:
    """Return two ends, which increase."""
    low, high = map(float, real_array(name, ends, (2,)))
    if not low < high:
        raise ValueError(f"{name} must increase, got ({low:g}, {high:g})")
    return low, high


def brief(x: np.ndarray) -> str:
    """Return an array in a form short enough for a message."""
    return np.array2string(x, precision=4, threshold=8)


def square(name: str, A: Any) -> np.ndarray:
    """Return a matrix as a finite square array."""
    A = array(name, A)
    if A.ndim != 2 or A.shape[0] != A.shape[1]:
        raise ValueError(f"{name} must be a square matrix of shape (n, n), got {A.shape}")
    return A


def is_discrete(dt: float | bool | None) -> bool:
    """Whether a timebase is discrete; a negative one is refused."""
    return dt is True or (dt is not None and non_negative("dt", dt) > 0)


_ROUNDING = 1e-10  # of an entry, once the diagonal is scaled to 1


def semidefinite(name: str, matrix: np.ndarray, why: str = "") -> np.ndarray:
    """Return a real square array as an exactly symmetric, positive semidefinite one.

    Judged with the diagonal scaled to 1: a small entry beside a large one counts as much.
    """
    diagonal, largest = np.diag(matrix), float(np.abs(matrix).max(initial=0.0))
    if diagonal.min(initial=0.0) < -4 * np.finfo(float).eps * largest:
        raise ValueError(
            f"{name} must be positive semidefinite{why}, got {diagonal.min():.4g} on its diagonal"
        )
    scale = np.sqrt(np.where(diagonal > 0, diagonal, largest or 1.0))
    scaled = matrix / scale[:, None] / scale
    if np.abs(scaled - scaled.T).max(initial=0.0) > _ROUNDING:
        raise ValueError(
            f"{name} must be symmetric, got {matrix.tolist()}; "
            "if rounding made it so, pass (P + P.T) / 2"
        )
    lowest = np.linalg.eigvalsh((scaled + scaled.T) / 2).min(initial=0.0)
    if lowest < -len(matrix) * _ROUNDING:
        scaled_to = "" if np.all(scale == 1) else " once its diagonal is scaled to 1"
        raise ValueError(
            f"{name} must be positive semidefinite{why}, got the eigenvalue {lowest:.4g}{scaled_to}"
        )
    result = (matrix + matrix.T) / 2
    np.fill_diagonal(result, np.maximum(diagonal, 0.0))
    return result
