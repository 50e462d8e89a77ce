"""Pairs (x, u) at which the state stays where it is, or moves steadily."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.derivatives import search_jacobian
from statebook.errors import EquilibriumNotFoundError
from statebook.invariants import invariants
from statebook.residuals import labels_among, mapping, noise_of, point, scale_of, values_by_label
from statebook.systems import System, as_system, output_map, time_of

_EPS = float(np.finfo(float).eps)
_RANK = 1e-8  # of a singular value, with rows and columns in units of their own
_STEPS = 200  # of Newton's method, which halves the error at a double zero


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


class _Problem:
    """The equations F(z) = 0 of some components z of (x, u), the unknowns."""

    def __init__(
        self,
        system: System,
        z0: np.ndarray,
        free: np.ndarray,
        t: float,
        derivative: Mapping[str, float | None],
        outputs: Mapping[str, float],
        scale: Any,
    ) -> None:
        self.system, self.z0, self.free, self.t = system, z0, free, t
        self.guess = z0[free]
        self.rows = [i for i, x in enumerate(system.states) if derivative.get(x, 0.0) is not None]
        self.rates = np.array([derivative.get(system.states[i], 0.0) for i in self.rows])
        labels, self.output = output_map(system)
        self.outputs = [labels.index(label) for label in outputs]
        self.wanted = np.array(list(outputs.values()))
        self.s = scale_of(system, z0[:, None], scale)[free, 0]
        self.extra: Any = None  # more equations, of all of z
        self.base = np.zeros(0)  # sizes of rows that count even where they vanish

    def fill(self, unknowns: np.ndarray) -> np.ndarray:
        """Return all of z, (k, N), for unknowns (p, N)."""
        z = np.repeat(self.z0[:, None], unknowns.shape[1], axis=1).astype(unknowns.dtype)
        z[self.free] = unknowns
        return z

    def batch(self, unknowns: np.ndarray) -> np.ndarray:
        """Return F, (r, N), NaN where it is undefined."""
        n, z = self.system.n, self.fill(unknowns)
        F = self.system.probe(z[:n], z[n:], self.t) - (z[:n] if self.system.discrete else 0.0)
        F = F[self.rows] - self.rates[:, None]
        if self.outputs and self.output is not None:
            y = self.output(z[:n], z[n:], self.t)[self.outputs] - self.wanted[:, None]
            F = np.concatenate([F, y])
        if self.extra is not None:
            F = np.concatenate([F, self.extra(z)])
        return F

    def __call__(self, unknowns: np.ndarray) -> np.ndarray:
        return self.batch(unknowns[:, None])[:, 0].astype(float)

    def jacobian(self, unknowns: np.ndarray) -> np.ndarray:
        """Return d F / d unknowns, (r, p), for the search: fast, and not verified."""
        return search_jacobian(self.batch, unknowns, self.s)

    def terms(self, unknowns: np.ndarray, J: np.ndarray) -> np.ndarray:
        """Return the size of what adds up in each row, which is not nothing even where it ends."""
        size = np.maximum(np.abs(unknowns), self.s)
        terms = np.abs(J) @ size + np.abs(self(unknowns))
        terms[: self.base.size] += 1e-14 * self.base
        return terms


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
    problem = _Problem(
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
        z, accepted = _search(problem, problem.guess, low, high, allowed)
        if not accepted:
            raise _not_found(problem, z)
        z = _nearest(problem, _less_singular(problem, z, low, high, allowed), low, high, allowed)
        z = _with_invariants(problem, z, low, high, allowed)
        return _result(problem, z, labels)


def _not_found(problem: _Problem, z: np.ndarray) -> EquilibriumNotFoundError:
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


def _bounds(bounds: Any, labels: Sequence[str], problem: _Problem) -> tuple[np.ndarray, np.ndarray]:
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


def _search(
    problem: _Problem, z: np.ndarray, low: np.ndarray, high: np.ndarray, allowed: float
) -> tuple[np.ndarray, bool]:
    """Return a zero of F reached from z, or the least-squares solution and False."""
    ends: list[np.ndarray] = []
    # The search ends where the gradient is small, which must not depend on the units of f.
    size = problem.terms(z, problem.jacobian(z))
    size = np.where((size > 0) & np.isfinite(size), size, 1.0)
    width = np.where(np.isfinite(high - low), high - low, 1.0)
    inside = np.clip(z, low + 1e-10 * width, np.maximum(high - 1e-10 * width, low))
    for x_scale in (problem.s, "jac"):
        end = _newton(problem, z if x_scale is problem.s else inside, low, high, 20)
        if not _accepts(problem, end, allowed):
            end = scipy.optimize.least_squares(
                lambda unknowns: problem(unknowns) / size,
                inside,
                jac=lambda unknowns: np.nan_to_num(problem.jacobian(unknowns) / size[:, None]),
                bounds=(low, np.where(high > low, high, np.nextafter(low, np.inf))),
                x_scale=x_scale,
                xtol=1e-15,
                ftol=1e-15,
                gtol=1e-15,
                max_nfev=1000,
            ).x
            end = _newton(problem, end, low, high, _STEPS)
        if _accepts(problem, end, allowed):
            return end, True
        ends.append(end)
    return min(ends, key=lambda end: float(np.abs(problem(end) / size).max())), False


def _newton(
    problem: _Problem, z: np.ndarray, low: np.ndarray, high: np.ndarray, steps: int
) -> np.ndarray:
    """Return z after the shortest Newton steps, shortened where they do not help."""
    F, last, ratio = problem(z), np.inf, 0.0
    for _ in range(steps):
        if not F.any():
            break
        J = problem.jacobian(z)
        if not np.isfinite(J).all():
            break
        step = _shortest(problem, J, -F, z, low, high)
        # A flat f sends the step anywhere: three times as far from 0 must do.
        step /= max(1.0, float((np.abs(step) / np.maximum(np.abs(z), 1.0)).max()) / 2)
        length = float(np.linalg.norm(step / problem.s))
        rows = problem.terms(z, J)
        weight = 1 / np.where(rows > 0, rows, 1.0)
        # At a multiple zero the steps fall by a steady factor: go where they end.
        before, ratio = ratio, length / last if last > 0 else 0.0
        steady = 0.3 < ratio < 0.95 and abs(ratio - before) < 0.1
        factors = [1.0, 0.5, 0.25, 1 / 16, 1 / 64, 1 / 1024]
        for factor in [1 / (1 - ratio), *factors] if steady else factors:
            new = np.clip(z + factor * step, low, high)
            F_new = problem(new)
            if np.isfinite(F_new).all() and (
                np.linalg.norm(F_new * weight) < (1 - 1e-3 * factor) * np.linalg.norm(F * weight)
                or not F_new.any()
            ):
                break
        else:
            break
        moved = np.abs(new - z)
        z, F, last = new, F_new, length
        if (moved <= 0.5 * _EPS * np.abs(z)).all():
            break
    return z


def _shortest(
    problem: _Problem,
    J: np.ndarray,
    change: np.ndarray,
    z: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> np.ndarray:
    """Return the shortest step, in units of s, that changes F by `change` and keeps bounds."""
    scaled = J * problem.s
    for _ in range(2):
        rows = np.abs(scaled).max(axis=1, initial=0.0)
        rows[: problem.base.size] += 1e-14 * problem.base
        rows = np.where(rows > 0, rows, 1.0)
        step = np.linalg.lstsq(scaled / rows[:, None], change / rows, rcond=1e-11)[0]
        out = ((z <= low) & (step < 0)) | ((z >= high) & (step > 0))
        if not out.any():
            break
        scaled = np.where(out, 0.0, scaled)
    return step * problem.s


def _noise(problem: _Problem, z: np.ndarray) -> np.ndarray:
    s = np.where(np.abs(z) > 1e-8 * problem.s, np.abs(z), problem.s)
    return noise_of(problem.batch, z, s)


def _accepts(problem: _Problem, z: np.ndarray, allowed: float) -> bool:
    """Whether F(z) is 0 but for noise, or a zero is within rounding of z."""
    F = problem(z)
    if not np.isfinite(F).all():
        return False
    if (np.abs(F) <= allowed).all():
        return True
    noise = np.maximum(_noise(problem, z), allowed)
    if (np.abs(F) <= noise).all():
        return True
    J = problem.jacobian(z)
    if not np.isfinite(J).all():
        return False
    infinite = np.full(z.size, np.inf)
    step = _shortest(problem, J, -F, z, -infinite, infinite)
    small = np.abs(step) <= 16 * _EPS * np.maximum(np.abs(z), problem.s)
    return bool(small.all() and (np.abs(F + J @ step) <= noise + 1e-6 * np.abs(F)).all())


def _nearest(
    problem: _Problem, z: np.ndarray, low: np.ndarray, high: np.ndarray, allowed: float
) -> np.ndarray:
    """Return the zero beside z that is nearest to the guess, in units of s.

    Loop invariant: z is an accepted zero, and no farther from the guess than before.
    """
    s, guess = problem.s, problem.guess
    last: tuple[np.ndarray, np.ndarray] | None = None
    pace = 1.0
    for _ in range(_STEPS):
        J = problem.jacobian(z)
        away = (z - guess) / s
        along = _tangent(J * s, away)
        if np.linalg.norm(along) <= 1e-10 * np.linalg.norm(away):
            break
        if last is not None:  # the step length of Barzilai and Borwein
            moved, turned = away - last[0], along - last[1]
            pace = float(np.clip(moved @ moved / max(moved @ turned, 1e-300), 0.05, 20.0))
        for factor in (1.0, 0.25, 1 / 16, 1 / 64):
            new = np.clip(z - factor * pace * along * s, low, high)
            if not np.isfinite(problem(new)).all():
                continue
            new = _newton(problem, new, low, high, 20)
            shorter = np.linalg.norm((new - guess) / s) < np.linalg.norm(away)
            if shorter and _accepts(problem, new, allowed):
                break
        else:
            break
        last, z = (away, along), new
    # What does not enter stays at the guess exactly.
    idle = ~problem.jacobian(z).any(axis=0)
    kept = np.where(idle, guess, z)
    if (kept != z).any() and _accepts(problem, kept, allowed):
        return kept
    return z


def _less_singular(
    problem: _Problem, z: np.ndarray, low: np.ndarray, high: np.ndarray, allowed: float
) -> np.ndarray:
    """Return a zero nearer to the guess where Newton's method went into a singular one.

    Where a product has to vanish, Newton's method makes all its factors small. A pull towards
    the guess that fades lets the one go that is cheapest.
    """

    start, end = (np.nan_to_num(problem.jacobian(at) * problem.s) for at in (problem.guess, z))
    tol = _RANK * np.linalg.norm(start)
    if np.linalg.matrix_rank(end, tol=tol) >= np.linalg.matrix_rank(start, tol=tol):
        return z
    size = problem.terms(problem.guess, problem.jacobian(problem.guess))
    size = np.where((size > 0) & np.isfinite(size), size, 1.0)
    end = problem.guess
    for pull in 10.0 ** np.arange(1.0, -6.5, -0.5):
        weights = pull * np.eye(z.size)

        def pulled(w: np.ndarray, weights: np.ndarray = weights) -> np.ndarray:
            return np.concatenate([problem(problem.guess + w * problem.s) / size, weights @ w])

        start = (end - problem.guess) / problem.s
        end = problem.guess + problem.s * scipy.optimize.least_squares(pulled, start).x
    end = _newton(problem, np.clip(end, low, high), low, high, _STEPS)
    nearer = np.linalg.norm((end - problem.guess) / problem.s) < np.linalg.norm(
        (z - problem.guess) / problem.s
    )
    return end if nearer and _accepts(problem, end, allowed) else z


def _tangent(J: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the part of v that J maps to 0, rows of J counting in units of their own."""
    rows = np.abs(J).max(axis=1, initial=0.0)
    _, values, V = np.linalg.svd(J / np.where(rows > 0, rows, 1.0)[:, None], full_matrices=False)
    V = V[values > _RANK * values.max(initial=0.0)]
    return v - V.T @ (V @ v)


def _with_invariants(
    problem: _Problem, z: np.ndarray, low: np.ndarray, high: np.ndarray, allowed: float
) -> np.ndarray:
    """Return a zero near z that also keeps what f conserves, or z where there is none."""
    J = problem.jacobian(z) * problem.s
    null = scipy.linalg.null_space(J, rcond=_RANK) if J.size else np.eye(z.size)
    if null.size == 0:
        return z
    z = _cleaned(problem, z)
    system = problem.system
    found = invariants(
        lambda x, u: system.probe(x, u, problem.t) - (x if system.discrete else 0.0),
        problem.z0,
        system.n,
        [j for j in problem.free if j >= system.n],
        system.discrete,
    )
    if found is None:
        return z
    # Only what the zeros beside z can differ in may be kept.
    slopes = found.gradient(problem.fill(z[:, None])[:, 0])[:, problem.free] * problem.s
    U, values, _ = np.linalg.svd(slopes @ null)
    rank = int(np.count_nonzero(values > 1e-6 * max(values.max(initial=0.0), 1e-3)))
    if rank == 0:
        return z
    weights = U[:, :rank].T
    target = weights @ found(problem.z0[:, None])
    problem.base = np.nan_to_num(problem.terms(problem.guess, problem.jacobian(problem.guess)))
    problem.extra = lambda full: weights @ found(full) - target
    kept = _newton(problem, z, low, high, _STEPS)
    accepted = _accepts(problem, kept, allowed)
    if accepted:
        kept = _nearest(problem, kept, low, high, allowed)
    problem.extra, problem.base = None, np.zeros(0)
    return kept if accepted and _accepts(problem, kept, allowed) else z


def _cleaned(problem: _Problem, z: np.ndarray) -> np.ndarray:
    """Return z with zeros for what is less than rounding, if that is as good."""
    clean = np.where(np.abs(z) < _EPS * problem.s, 0.0, z)
    return clean if (np.abs(problem(clean)) <= np.abs(problem(z))).all() else z


def _result(problem: _Problem, z: np.ndarray, labels: Sequence[str]) -> Equilibrium:
    """Return the equilibrium at an accepted zero, with its rank."""
    z = _cleaned(problem, z)
    F, J = np.abs(problem(z)), problem.jacobian(z)
    terms = problem.terms(z, J)
    residual = float((F / np.where(terms > 0, terms, 1.0)).max(initial=0.0))
    # A singular value that changes by itself within the noise of the zero is none.
    infinite = np.full(z.size, np.inf)
    blur = np.abs(_shortest(problem, J, _noise(problem, z) / 8, z, -infinite, infinite))
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
    kept = values > np.maximum(_RANK * values.max(initial=0.0), blurred)
    null = V[[i for i in range(z.size) if i >= k or not kept[i]]]
    degenerate, free = False, np.zeros(z.size, dtype=bool)
    for v in null / columns:
        v = v / np.linalg.norm(v)
        moved = z + 1e-3 * v * problem.s
        end = _newton(problem, moved, -infinite, infinite, 60)
        path = (end - z) / problem.s / 1e-3 if _accepts(problem, end, 0.0) else 0.0 * v
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
