"""One function u(x, t) from every form in which a control may be given."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from statebook import _validate
from statebook.control_trajectory import ControlTrajectory
from statebook.probes import takes_batches
from statebook.times import interval_of

Policy = Callable[[np.ndarray, float], np.ndarray]
Stretch = tuple[float, float, Policy]


def first_control(u: Any, x: np.ndarray, t: float) -> np.ndarray | None:
    """The control at the start: what tells m to a system that is a plain function."""
    if u is None:
        return None
    if isinstance(u, ControlTrajectory):
        return u.on_piece(interval_of(np.float64(t), u.breakpoints), t)
    if callable(u):
        return np.atleast_1d(_validate.real_array("u(x0, t0)", u(x.copy(), t)))
    return np.atleast_1d(_validate.real_array("u", u))


def as_policy(u: Any, m: int, x0: np.ndarray, t0: float) -> Policy:
    """The control as a function that returns (m,), or (m, N) for a batch of states.

    A function is probed: one that does not take a batch is called column by column.
    """
    batch = x0.shape[1:]
    if isinstance(u, ControlTrajectory):
        if u.m != m:
            raise ValueError(f"u must have m = {m} inputs, got a control trajectory of {u.m}")
        return lambda x, t: _spread(u(t), batch)
    if not callable(u):
        value = _shaped("u", np.zeros(m) if u is None else _validate.real_array("u", u), m, batch)
        return lambda x, t: value

    def call(x: np.ndarray, t: float, batch: tuple[int, ...]) -> np.ndarray:
        try:
            value = u(x.copy(), t)
        except ArithmeticError:  # Python's numbers raise where NumPy's become infinite
            value = np.full(m, np.nan)
        return _shaped("u(x, t)", value, m, batch)

    def alone(x: np.ndarray, t: float) -> np.ndarray:
        return call(x, t, ())

    def together(x: np.ndarray, t: float) -> np.ndarray:
        return call(x, t, batch)

    def one_by_one(x: np.ndarray, t: float) -> np.ndarray:
        return np.stack([alone(column, t) for column in x.T], axis=1)

    if not batch:
        return alone
    # Different columns, or a policy that mixes them up would pass.
    beside = x0 + (1 + np.abs(x0)) * np.linspace(0.0, 1e-3, batch[0])
    agrees = all(
        takes_batches(
            lambda x: together(x, t0), x, alone=lambda column: alone(column, t0), rtol=1e-9
        )
        for x in (x0, beside)
    )
    return together if agrees else one_by_one


def segments(u: Any, policy: Policy, start: float, end: float) -> list[Stretch]:
    """The stretches of time (a, b, policy) in which the control has no breakpoint.

    Up to b the policy is that of the stretch: at its end it is the limit from the left.
    """
    if not isinstance(u, ControlTrajectory):
        return [(start, end, policy)]
    slack = 1e-12 * max(abs(start), abs(end), end - start)
    inside = u.breakpoints[(u.breakpoints > start + slack) & (u.breakpoints < end - slack)]
    cuts = [start, *inside.tolist(), end]

    def piece(a: float, b: float) -> Policy:
        k = interval_of(np.float64((a + b) / 2), u.breakpoints)
        return lambda x, t: _spread(u.on_piece(k, t), x.shape[1:])

    return [(a, b, piece(a, b)) for a, b in itertools.pairwise(cuts)]


def _shaped(name: str, value: Any, m: int, batch: tuple[int, ...]) -> np.ndarray:
    """Check a control and bring it to the shape (m, *batch); it need not be finite."""
    value = np.asarray(value)
    if value.dtype.kind not in "biuf":
        raise TypeError(f"{name} must be real numbers, got {value!r}")
    if m == 1 and value.shape in ((), batch):
        value = value[None]
    if value.shape not in ((m,), (m, *batch)):
        allowed = f"({m},)" + (f" or ({m}, {batch[0]})" if batch else "")
        raise ValueError(f"{name} must have shape {allowed}, got {value.shape}")
    return _spread(value.astype(float, copy=False), batch)


def _spread(value: np.ndarray, batch: tuple[int, ...]) -> np.ndarray:
    return np.repeat(value[:, None], batch[0], axis=1) if batch and value.ndim == 1 else value
