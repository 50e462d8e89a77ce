"""Pairs (x, u) at which the state stays where it is, or moves steadily."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from statebook import _validate
from statebook.errors import EquilibriumNotFoundError
from statebook.residuals import labels_among, mapping, point, values_by_label
from statebook.systems import System, as_system, output_map, time_of
from statebook.zeros import (
    RANK,
    Problem,
    accepts,
    cleaned,
    less_singular,
    nearest,
    newton,
    noise_at,
    search,
    shortest,
    with_invariants,
)

_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Equilibrium:
    """A pair (x, u) at which the state stays where it is, or moves steadily.

    Attributes
    ----------
    x, u : array, shape (n,) and (m,)
    residual : float
        abs(f(x, u)), or abs(f(x, u) - x) in discrete time, over the size of f's terms.
    rank : int
        Rank of the problem: the number of unknowns that the equations determine.
    unknowns : int
        Number of unknowns; more than the rank means that the equilibrium is not isolated.
    free : tuple of str
        Labels of the unknowns that the equations leave free: there are equilibria beside it.
    degenerate : bool
        The derivative is singular though the equilibrium is isolated, as x^2 has it at 0, at
        least to within rounding: linearization decides nothing there.
    """

    x: np.ndarray
    u: np.ndarray
    residual: float
    rank: int
    unknowns: int
    free: tuple[str, ...] = field(default=())
    degenerate: bool = False

    def __repr__(self) -> str:
        x, u = (f"[{' '.join(f'{v + 0.0:.6g}' for v in a)}]" for a in (self.x, self.u))
        kind = "degenerate" if self.degenerate else "isolated"
        if self.free:
            kind = f"not isolated, free: {', '.join(self.free)}"
        return f"Equilibrium(x={x}, u={u}, {kind}: rank {self.rank} of {self.unknowns} unknowns)"


def find_equilibrium(
    system: Any,
    x_guess: Any,
    u_guess: Any = None,
    *,
    fixed: Sequence[str] | None = None,
    derivative: Mapping[str, float | None] | None = None,
    outputs: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    scale: Mapping[str, float] | None = None,
    tolerance: float | None = None,
    t: float | None = None,
) -> Equilibrium:
    """Find an equilibrium, or a steady motion, near a guess.

    f(x, u) = 0 in continuous time, f(x, u) = x in discrete time; with `derivative` and
    `outputs` a trim point: x_i' = d_i and y_k = y_k0 for those that are named.

    Parameters
    ----------
    system : system
        Whatever as_system takes.
    x_guess : array, shape (n,)
    u_guess : array, shape (m,), optional
        Zeros if omitted.
    fixed : sequence of str, optional
        Labels of the states and inputs that keep the guess's value. By default all inputs;
        an empty sequence leaves everything free.
    derivative : mapping of label to float or None, optional
        What x_i' (in discrete time x_next - x) is to be for states that move steadily, as a
        position in level flight does; None leaves it open. 0 for all others.
    outputs : mapping of label to float, optional
        What outputs are to be, of a python-control system.
    bounds : mapping of label to (low, high), optional
        Between which an unknown has to stay; the guess must lie between them.
    scale : mapping of label to float > 0, optional
        The unit in which the distance of a state or input from its guess is measured; by
        default abs(guess), or 1 where the guess is 0.
    tolerance : float >= 0, optional
        A residual to be content with, in the units of f; by default f's own noise.
    t : float, optional [s]
        The time, for a system that depends on it.

    Returns
    -------
    Equilibrium

    Raises
    ------
    EquilibriumNotFoundError
        The search ended at a point that is none; the message has it.
    TypeError, ValueError
        A label that the system does not have, a wrong shape, nothing left to solve for; f is
        not defined at the guess; t is missing.

    Notes
    -----
    Where there are more unknowns than equations, sum(((z - guess) / scale)^2) has a local
    minimum at the result, so that what does not enter stays at the guess. A linear or
    quadratic function of the state that f conserves, as the norm of a quaternion or the mass
    in a reaction, keeps its value where an equilibrium has it.

    Examples
    --------
    >>> import statebook as sb
    >>> find_equilibrium(sb.Pendulum(), [0.1, 0.0], fixed=["theta"]).u.round(3)
    array([9.751])
    """
    system, x, u = _named_guesses(system, x_guess, u_guess)
    t = time_of(system, x, u, t)
    labels = (*system.states, *system.inputs)
    kept = system.inputs if fixed is None else labels_among("fixed", fixed, labels)
    free = np.array([i for i, label in enumerate(labels) if label not in kept], dtype=int)
    if free.size == 0 and system.n:
        raise ValueError("fixed must leave at least one state or input to solve for")
    problem = Problem(
        system,
        np.concatenate([x, u]),
        free,
        t,
        _rates(derivative, system.states),
        _wanted(outputs, system),
        scale,
    )
    low, high = _bounds(bounds, labels, problem)
    allowed = 0.0 if tolerance is None else _validate.non_negative("tolerance", tolerance)
    system.dynamics(x, u, t)  # reports what is wrong with f at the guess
    if not np.isfinite(problem(problem.guess)).all():
        raise ValueError(f"{system.name} is not finite at the guess; move it into the domain")
    with np.errstate(all="ignore"):  # the search may go where numbers overflow
        z, accepted = search(problem, problem.guess, low, high, allowed)
        if not accepted:
            raise _not_found(problem, z)
        z = nearest(problem, less_singular(problem, z, low, high, allowed), low, high, allowed)
        z = with_invariants(problem, z, low, high, allowed)
        return _result(problem, z, labels)


def _not_found(problem: Problem, z: np.ndarray) -> EquilibriumNotFoundError:
    """Return the error of a search that ended at z."""
    n, full = problem.system.n, problem.fill(z[:, None])[:, 0]
    guess, x, u = (_validate.brief(a) for a in (problem.z0[:n], full[:n], full[n:]))
    F, terms = np.abs(problem(z)), problem.terms(z, problem.jacobian(z))
    worst = int(np.argmax(F / np.where(terms > 0, terms, 1.0)))
    return EquilibriumNotFoundError(
        f"no equilibrium found from x_guess = {guess}: the search ended at x = {x}, u = {u} with a"
        f" residual of {F[worst]:.3g} against a scale of {terms[worst]:.3g}; try another guess or"
        " leave more labels out of fixed"
    )


def _named_guesses(
    system: Any, x_guess: Any, u_guess: Any
) -> tuple[System, np.ndarray, np.ndarray]:
    """Return the system and the checked guesses, under the names that the caller knows."""
    names = ("x_guess", "u_guess")
    _validate.real_array(names[0], x_guess)
    if u_guess is not None:
        _validate.real_array(names[1], u_guess)
    system = as_system(system, x_guess, u_guess, names=names)
    return system, *point(system, x_guess, u_guess, batch=False, names=names)


def _rates(derivative: Any, states: Sequence[str]) -> dict[str, float | None]:
    """Return the wanted derivatives by label; None leaves one open."""
    wanted = mapping("derivative", derivative, states, "1.0")
    open_ones = labels_among("derivative", [k for k, v in wanted.items() if v is None], states)
    given = {k: v for k, v in wanted.items() if v is not None}
    return {**values_by_label("derivative", given, states), **dict.fromkeys(open_ones)}


def _wanted(outputs: Any, system: System) -> dict[str, float]:
    """Return the wanted outputs by label."""
    labels, output = output_map(system)
    if outputs and output is None:
        raise ValueError(
            f"outputs were given, but {system.name} has none of its own; fix its states (fixed=)"
        )
    return values_by_label("outputs", outputs, labels)


def _bounds(bounds: Any, labels: Sequence[str], problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of the unknowns."""
    low, high = (np.full(problem.z0.size, v) for v in (-np.inf, np.inf))
    bounds = mapping("bounds", bounds, labels, "(0.0, 1.0)")
    for label in labels_among("bounds", tuple(bounds), labels):
        try:
            pair = np.array(bounds[label], dtype=float).reshape(2)
        except (TypeError, ValueError):
            raise TypeError(
                f"bounds[{label!r}] must be (low, high), got {bounds[label]!r}"
            ) from None
        j = labels.index(label)
        low[j], high[j] = pair
        if not low[j] <= problem.z0[j] <= high[j]:
            raise ValueError(
                f"the guess of {label} must lie within bounds[{label!r}] ="
                f" ({pair[0]:g}, {pair[1]:g}), got {problem.z0[j]:g}"
            )
    return low[problem.free], high[problem.free]


def _result(problem: Problem, z: np.ndarray, labels: Sequence[str]) -> Equilibrium:
    """Return the equilibrium at an accepted zero, with its rank."""
    z = cleaned(problem, z)
    F, J = np.abs(problem(z)), problem.jacobian(z)
    terms = problem.terms(z, J)
    residual = float(np.max(F / np.where(terms > 0, terms, 1.0), initial=0.0))
    # A singular value that changes by itself within the noise of the zero is none.
    infinite = np.full(z.size, np.inf)
    blur = np.abs(shortest(problem, J, noise_at(problem, z) / 8, z, -infinite, infinite))
    size = np.maximum(problem.s, np.abs(z))
    blur = np.clip(np.nan_to_num(blur), 4 * _EPS * size, 1e-3 * size)
    change = np.nan_to_num(problem.jacobian(z + blur) - J) * problem.s
    scaled = J * problem.s
    rows = np.maximum(np.abs(scaled), np.abs(change)).max(axis=1, initial=0.0)
    rows = np.where(rows > 0, rows, 1.0)[:, None]
    columns = np.abs(scaled / rows).max(axis=0, initial=0.0)
    columns = np.where(columns > 1e-12, columns, 1.0)
    scaled, change = scaled / rows / columns, change / rows / columns
    U, values, V = np.linalg.svd(scaled)
    k = values.size
    blurred = 2 * np.abs(np.einsum("ik,ij,kj->k", U[:, :k], change, V[:k]))
    kept = values > np.maximum(RANK * values.max(initial=0.0), blurred)
    null = V[[i for i in range(z.size) if i >= k or not kept[i]]]
    degenerate, free = False, np.zeros(z.size, dtype=bool)
    for v in null / columns:
        v = v / np.linalg.norm(v)
        moved = z + 1e-3 * v * problem.s
        end = newton(problem, moved, -infinite, infinite, 60)
        path = (end - z) / problem.s / 1e-3 if accepts(problem, end, 0.0) else 0.0 * v
        degenerate |= bool(np.linalg.norm(path - v) > 0.3)
        free |= np.abs(path) > 0.01
    full = problem.fill(z[:, None])[:, 0]
    n = problem.system.n
    return Equilibrium(
        full[:n],
        full[n:],
        residual,
        int(np.count_nonzero(kept)),
        z.size,
        tuple(labels[problem.free[j]] for j in np.flatnonzero(free)),
        degenerate,
    )
