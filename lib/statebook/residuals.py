"""The residual of an equilibrium, its derivatives, and its noise."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from statebook import _validate
from statebook.complex_step import step_scale
from statebook.derivatives import Derivative, differentiate
from statebook.systems import System

TOLERANCE = 1e-8  # relative error of a state that a caller has written down
_ROUNDING = 1e-12  # of a component beside others: a zero that was computed
_EPS = float(np.finfo(float).eps)


def point(
    system: System, x0: Any, u0: Any, *, batch: bool = True, names: tuple[str, str] = ("x0", "u0")
) -> tuple[np.ndarray, np.ndarray]:
    """Return x0 and u0 as checked real arrays; u0 None is zeros."""
    x0 = _validate.real_array(names[0], x0)
    u0 = np.zeros(system.m) if u0 is None else _validate.real_array(names[1], u0)
    for name, value, rows in ((names[0], x0, system.n), (names[1], u0, system.m)):
        if value.ndim not in ((1, 2) if batch else (1,)) or value.shape[0] != rows:
            also = f" or ({rows}, N)" if batch else ""
            raise ValueError(f"{name} must have shape ({rows},){also}, got {value.shape}")
    if x0.ndim == u0.ndim == 2 and x0.shape[1] != u0.shape[1]:
        raise ValueError(f"{' and '.join(names)} must agree in N, got {x0.shape} and {u0.shape}")
    return x0, u0


def labels_among(name: str, labels: Any, known: Sequence[str]) -> tuple[str, ...]:
    """Return labels as a tuple, refusing a bare string and what is not known."""
    if isinstance(labels, str):
        raise TypeError(f"{name} must be a sequence of labels; write {name}=[{labels!r}]")
    if not isinstance(labels, Collection):
        raise TypeError(f"{name} must be a sequence of labels, got {labels!r}")
    for label in labels:
        if label not in known:
            raise ValueError(f"{name} must hold labels among {tuple(known)}, got {label!r}")
    return tuple(labels)


def mapping(name: str, value: Any, known: Sequence[str], example: str) -> Mapping[str, Any]:
    """Return a mapping of labels as it is; None is an empty one."""
    if value is not None and not isinstance(value, Mapping):
        raise TypeError(f"{name} must map labels to values, as {{{known[0]!r}: {example}}}")
    return value or {}


def values_by_label(
    name: str, values: Any, known: Sequence[str], *, positive: bool = False
) -> dict[str, float]:
    """Return a mapping of labels to numbers, checked; None is an empty one."""
    if values is None:
        return {}
    labels_among(name, tuple(mapping(name, values, known, "1.0")), known)
    check = _validate.positive if positive else _validate.number
    return {label: check(f"{name}[{label!r}]", value) for label, value in values.items()}


def scale_of(system: System, z: np.ndarray, scale: Any) -> np.ndarray:
    """Return over which distance f varies, (k, N), with a caller's `scale` by label."""
    labels = (*system.states, *system.inputs)
    s = step_scale(z)
    for label, size in values_by_label("scale", scale, labels, positive=True).items():
        s[labels.index(label)] = size
    return s


def jacobian(
    system: System,
    x0: np.ndarray,
    u0: np.ndarray,
    t: float = 0.0,
    *,
    columns: Sequence[int] | None = None,
    scale: Any = None,
    f0: np.ndarray | None = None,
) -> Derivative:
    """Return the derivative with respect to (x, u), with its evidence."""
    x, u = (a[:, None] if a.ndim == 1 else a for a in (x0, u0))
    N = max(x.shape[1], u.shape[1])
    z = np.concatenate([a if a.shape[1] == N else np.repeat(a, N, axis=1) for a in (x, u)])
    n, labels = system.n, (*system.states, *system.inputs)

    def f(z: np.ndarray) -> np.ndarray:
        return system.probe(z[:n], z[n:], t)

    s, start = scale_of(system, z, scale), None if f0 is None else f0.reshape(n, N)
    return differentiate(f, z, columns, scale=s, labels=labels, f0=start)


def noise_of(residual: Any, z: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Measure how far rounding of z moves the residual.

    Parameters
    ----------
    residual : callable
        Maps (k, N) to (r, N), NaN where it is undefined.
    z, s : array, shape (k,)
        The point, and over which distances the residual varies.

    Returns
    -------
    array, shape (r,)
        A residual of this size may be rounding.
    """
    rng = np.random.default_rng(1)
    largest = np.abs(z).max(initial=0.0)
    # What is rounding beside the other components is a zero that was computed.
    size = np.where(np.abs(z) <= _ROUNDING * largest, _ROUNDING * largest, 2 * _EPS * np.abs(z))
    size = np.maximum(size, np.where(np.abs(z) < 1e-14 * s, 2 * _EPS * s, 0.0))
    shifts = size[:, None] * rng.choice([-2.0, -1.0, 1.0, 2.0], (z.size, 6))
    # At a zero that is flat all this vanishes with the slope. Look beside it for the part of f
    # that is not smooth: second differences, free of what falls like the square of the step.
    beside = z + 1e-3 * s * rng.uniform(0.5, 1.0, z.size) * rng.choice([-1.0, 1.0], z.size)
    wide = 1e-9 * s[:, None] * rng.uniform(0.1, 1.0, (z.size, 8))
    steps = np.concatenate([wide, wide / 2], axis=1)
    columns = [z, beside, z[:, None] + shifts, beside[:, None] + steps, beside[:, None] - steps]
    values = residual(np.concatenate([c.reshape(z.size, -1) for c in columns], axis=1))
    here, there, moved, up, down = np.split(values, [1, 2, 8, 24], axis=1)
    bent = up + down - 2 * there
    noise = np.concatenate([np.abs(moved - here), np.abs(bent[:, :8] / 4 - bent[:, 8:])], axis=1)
    return 8 * np.nan_to_num(noise, nan=0.0, posinf=0.0).max(axis=1, initial=0.0)
