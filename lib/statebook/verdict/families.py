"""Equilibria side by side: stability and drift where the linear part alone is silent."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from statebook.derivatives import InexactDerivativeWarning
from statebook.linearization import linearize
from statebook.systems import System
from statebook.verdict.judgement import Judgement, judge
from statebook.verdict.level_sets import margin

# Singular values below this share of the largest are zero.
_RANK = 1e-8
# Of two components of a way along a family, this share of the other one is no motion.
_ROUNDING = 1e-10
# Lengths of the ways along a family, against the state's components, and steps back onto it.
_LENGTHS = (0.3, 0.03)
_STEPS = 40


@dataclass(frozen=True)
class Family:
    """Equilibria around an equilibrium, at its input.

    Attributes
    ----------
    dimension : int
        Of the set of equilibria.
    drifts : bool
        Its eigenvalue 0 (1 in discrete time) has Jordan blocks all along: the state drifts.
    rest : float
        Distance of all other eigenvalues from the boundary; inf if there are none.
    """

    dimension: int
    drifts: bool
    rest: float


def family_of(
    system: System, x: np.ndarray, u: np.ndarray, A: np.ndarray, judgement: Judgement
) -> Family | None:
    """Return the family that an equilibrium belongs to, if it decides about stability.

    It is continued along generic directions of the Jacobian's null space to a finite distance:
    where f vanishes there too its dimension is that of the null space. If that is the
    multiplicity of the eigenvalue 0 and all others are inside, the family is the center
    manifold, and stable, by the reduction principle. If the multiplicity is larger, at the
    distant points too, there are motions at a speed v for a time of the order of 1 / v, as the
    speeds change at a rate of v^2 only: however slow, they go a finite way.

    References
    ----------
    Carr, *Applications of Centre Manifold Theory*, chapter 2; Aulbach, *Continuous and Discrete
    Dynamics near Manifolds of Equilibria*, chapter 2.
    """
    values, tolerance = judgement.eigenvalues, judgement.tolerance
    at = _at_rest(values, tolerance, system.discrete)
    others = margin(values[~at], system.discrete)
    multiplicity, rest = int(at.sum()), float(others.min(initial=np.inf))
    scale = np.where(np.abs(x) > 1e-14, np.abs(x), 1.0)
    null, back = _null_space(A, scale, system.discrete)
    dimension = null.shape[1]
    semisimple = multiplicity == dimension
    beyond = rest <= tolerance if semisimple else rest < -tolerance
    if dimension == 0 or multiplicity < dimension or beyond:
        return None
    ways = (_continued(system, x, u, length * null, back, scale) for length in _LENGTHS)
    found = next(filter(None, ways), [])
    for there in [] if semisimple else found:
        judged = judge(there, system.discrete, check_distance=False)
        at = _at_rest(judged.eigenvalues, judged.tolerance, system.discrete)
        same = _null_space(there, scale, system.discrete)[0].shape[1] == dimension
        if at.sum() != multiplicity or not same:
            return None
    if not found:
        return None
    return Family(dimension, not semisimple, rest)


def _at_rest(values: np.ndarray, tolerance: float, discrete: bool) -> np.ndarray:
    """Which eigenvalues are 0, or 1 in discrete time."""
    size = np.abs(values).max(initial=1.0 if discrete else 0.0)
    return np.abs(values - (1.0 if discrete else 0.0)) <= max(tolerance, 1e-12 * size)


def _null_space(A: np.ndarray, scale: np.ndarray, discrete: bool) -> tuple[np.ndarray, np.ndarray]:
    """Null space of f's derivative, and its pseudo-inverse, both in units of the state."""
    G = (A - np.eye(len(A)) if discrete else A) * scale
    rows = np.abs(G).max(axis=1)
    rows = np.where(rows > 0, rows, 1.0)
    U, s, Vh = np.linalg.svd(G / rows[:, None])
    rank = int(np.sum(s > _RANK * s[0]))
    inverse = (Vh[:rank].T / s[:rank]) @ (U[:, :rank].T / rows)
    return Vh[rank:].T, scale[:, None] * inverse


def _continued(
    system: System,
    x0: np.ndarray,
    u: np.ndarray,
    ways: np.ndarray,
    back: np.ndarray,
    scale: np.ndarray,
) -> list[np.ndarray]:
    """Jacobians at equilibria some way off, both ways; none where one is missing.

    Directions are generic, since a cross of two lines has equilibria along its arms only.
    """
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(ways.shape[1] + 1, ways.shape[1]))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = []
    for direction in [*directions, *-directions]:
        try:
            x = _returned(system, x0 + scale * (ways @ direction), u, back)
            moved = (x - x0) / scale
            x = np.where(np.abs(moved) > _ROUNDING * np.abs(moved).max(), x, x0)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", InexactDerivativeWarning)
                found.append(np.asarray(linearize(system, x, u).A))
        except Exception:  # no equilibrium there, or whatever a function raises off its domain
            return []
    return found


def _returned(system: System, x: np.ndarray, u: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Return onto the family, across it: Newton's method with the derivative where it began."""
    size = np.inf
    for _ in range(_STEPS):
        step = back @ (system.dynamics(x, u) - (x if system.discrete else 0.0))
        if not np.abs(step).max() < size:
            break
        x, size = x - step, np.abs(step).max()
    return x
