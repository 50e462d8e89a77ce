"""How far a point is from an equilibrium, and how that changes beside it."""

from __future__ import annotations

from typing import Any

import numpy as np

from statebook import _validate
from statebook.derivatives import derivative
from statebook.systems import System

TOLERANCE = 1e-8  # of a residual, against the size of f's terms
ROUNDING = 1e-12


def point(system: System, x0: Any, u0: Any, *, batch: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Return x0 and u0 as checked real arrays; u0 None is zeros."""
    x0 = _validate.real_array("x0", x0)
    u0 = np.zeros(system.m) if u0 is None else _validate.real_array("u0", u0)
    for name, value, rows in (("x0", x0, system.n), ("u0", u0, system.m)):
        if value.ndim not in ((1, 2) if batch else (1,)) or value.shape[0] != rows:
            also = f" or ({rows}, N)" if batch else ""
            raise ValueError(f"{name} must have shape ({rows},){also}, got {value.shape}")
    if x0.ndim == u0.ndim == 2 and x0.shape[1] != u0.shape[1]:
        raise ValueError(f"x0 and u0 must agree in N, got {x0.shape} and {u0.shape}")
    return x0, u0


def jacobian(system: System, x0: np.ndarray, u0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivative with respect to (x, u), (N, n, n + m), and its error."""
    system.dynamics(x0, u0 if u0.ndim <= x0.ndim else u0[:, 0])  # reports what is wrong with f
    x, u = (a[:, None] if a.ndim == 1 else a for a in (x0, u0))
    N = max(x.shape[1], u.shape[1])
    z = np.concatenate([np.repeat(a, N // a.shape[1], axis=1) for a in (x, u)])
    return derivative(lambda z: system.probe(z[: system.n], z[system.n :]), z)


def residual_of(system: System, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return system.dynamics(x, u) - (x if system.discrete else 0.0)


def jacobian_of_residual(system: System, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    J = jacobian(system, x, u)[0][0]
    return J - np.eye(*J.shape) if system.discrete else J


def judge(system: System, x: np.ndarray, u: np.ndarray) -> tuple[float, float, float]:
    """Return the residual of the worst row, what is allowed there, and the size of its terms.

    The terms of row i are J_ij z_j, and what f_i reaches at displaced points. The former
    allow a residual; of the latter only the rounding, as far away terms may be large. Both
    scale with the units of f_i.
    """
    residual = np.abs(residual_of(system, x, u))
    if not residual.any():
        return 0.0, 0.0, 0.0
    z = np.concatenate([x, u])
    # What is rounding beside the other components is a zero that was computed.
    negligible = np.abs(z) <= ROUNDING * np.abs(z).max()
    displaced = z[:, None] + np.diag(np.where(negligible, 1.0, 0.1 * np.abs(z)))
    values = np.abs(system.probe(displaced[: system.n], displaced[system.n :]))
    reach = np.nan_to_num(values, posinf=0.0).max(axis=1, initial=0.0)
    terms = np.abs(jacobian_of_residual(system, x, u)) @ np.abs(z)
    allowed = TOLERANCE * terms + ROUNDING * reach
    worst = np.argmax(np.where(residual > 0, residual / np.maximum(allowed, 1e-300), 0.0))
    return float(residual[worst]), float(allowed[worst]), float(max(terms[worst], reach[worst]))
