"""Zeros of a system's equations: reached from a guess, nearest to it, with what f conserves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy

from statebook.complex_step import search_jacobian
from statebook.invariants import invariants
from statebook.residuals import noise_of, scale_of
from statebook.systems import System, output_map

_EPS = float(np.finfo(float).eps)
RANK = 1e-8  # of a singular value, with rows and columns in units of their own
_STEPS = 200  # of Newton's method, which halves the error at a double zero


class Problem:
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


def search(
    problem: Problem, z: np.ndarray, low: np.ndarray, high: np.ndarray, allowed: float
) -> tuple[np.ndarray, bool]:
    """Return a zero of F reached from z, or the least-squares solution and False."""
    ends: list[np.ndarray] = []
    # The search ends where the gradient is small, which must not depend on the units of f.
    size = problem.terms(z, problem.jacobian(z))
    size = np.where((size > 0) & np.isfinite(size), size, 1.0)
    width = np.where(np.isfinite(high - low), high - low, 1.0)
    inside = np.clip(z, low + 1e-10 * width, np.maximum(high - 1e-10 * width, low))
    for x_scale in (problem.s, "jac"):
        end = newton(problem, z if x_scale is problem.s else inside, low, high, 20)
        if not accepts(problem, end, allowed):
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
            end = newton(problem, end, low, high, _STEPS)
        if accepts(problem, end, allowed):
            return end, True
        ends.append(end)
    return min(ends, key=lambda end: float(np.abs(problem(end) / size).max())), False


def newton(
    problem: Problem, z: np.ndarray, low: np.ndarray, high: np.ndarray, steps: int
) -> np.ndarray:
    """Return z after the shortest Newton steps, shortened where they do not help."""
    F, last, ratio = problem(z), np.inf, 0.0
    for _ in range(steps):
        if not F.any():
            break
        J = problem.jacobian(z)
        if not np.isfinite(J).all():
            break
        step = shortest(problem, J, -F, z, low, high)
        # A flat f sends the step anywhere: three times as far from 0 must do.
        step /= max(1.0, float(np.max(np.abs(step) / np.maximum(np.abs(z), 1.0))) / 2)
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


def shortest(
    problem: Problem,
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


def noise_at(problem: Problem, z: np.ndarray) -> np.ndarray:
    s = np.where(np.abs(z) > 1e-8 * problem.s, np.abs(z), problem.s)
    return noise_of(problem.batch, z, s)


def accepts(problem: Problem, z: np.ndarray, allowed: float) -> bool:
    """Whether F(z) is 0 but for noise, or a zero is within rounding of z."""
    F = problem(z)
    if not np.isfinite(F).all():
        return False
    if (np.abs(F) <= allowed).all():
        return True
    noise = np.maximum(noise_at(problem, z), allowed)
    if (np.abs(F) <= noise).all():
        return True
    J = problem.jacobian(z)
    if not np.isfinite(J).all():
        return False
    infinite = np.full(z.size, np.inf)
    step = shortest(problem, J, -F, z, -infinite, infinite)
    small = np.abs(step) <= 16 * _EPS * np.maximum(np.abs(z), problem.s)
    return bool(small.all() and (np.abs(F + J @ step) <= noise + 1e-6 * np.abs(F)).all())


def nearest(
    problem: Problem, z: np.ndarray, low: np.ndarray, high: np.ndarray, allowed: float
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
            new = newton(problem, new, low, high, 20)
            shorter = np.linalg.norm((new - guess) / s) < np.linalg.norm(away)
            if shorter and accepts(problem, new, allowed):
                break
        else:
            break
        last, z = (away, along), new
    # What does not enter stays at the guess exactly.
    idle = ~problem.jacobian(z).any(axis=0)
    kept = np.where(idle, guess, z)
    if (kept != z).any() and accepts(problem, kept, allowed):
        return kept
    return z


def less_singular(
    problem: Problem, z: np.ndarray, low: np.ndarray, high: np.ndarray, allowed: float
) -> np.ndarray:
    """Return a zero nearer to the guess where Newton's method went into a singular one.

    Where a product has to vanish, Newton's method makes all its factors small. A pull towards
    the guess that fades lets the one go that is cheapest.
    """

    start, end = (np.nan_to_num(problem.jacobian(at) * problem.s) for at in (problem.guess, z))
    tol = RANK * np.linalg.norm(start)
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
    end = newton(problem, np.clip(end, low, high), low, high, _STEPS)
    nearer = np.linalg.norm((end - problem.guess) / problem.s) < np.linalg.norm(
        (z - problem.guess) / problem.s
    )
    return end if nearer and accepts(problem, end, allowed) else z


def _tangent(J: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the part of v that J maps to 0, rows of J counting in units of their own."""
    rows = np.abs(J).max(axis=1, initial=0.0)
    _, values, V = np.linalg.svd(J / np.where(rows > 0, rows, 1.0)[:, None], full_matrices=False)
    V = V[values > RANK * values.max(initial=0.0)]
    return v - V.T @ (V @ v)


def with_invariants(
    problem: Problem, z: np.ndarray, low: np.ndarray, high: np.ndarray, allowed: float
) -> np.ndarray:
    """Return a zero near z that also keeps what f conserves, or z where there is none."""
    J = problem.jacobian(z) * problem.s
    null = scipy.linalg.null_space(J, rcond=RANK) if J.size else np.eye(z.size)
    if null.size == 0:
        return z
    z = cleaned(problem, z)
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
    kept = newton(problem, z, low, high, _STEPS)
    accepted = accepts(problem, kept, allowed)
    if accepted:
        kept = nearest(problem, kept, low, high, allowed)
    problem.extra, problem.base = None, np.zeros(0)
    return kept if accepted and accepts(problem, kept, allowed) else z


def cleaned(problem: Problem, z: np.ndarray) -> np.ndarray:
    """Return z with zeros for what is less than rounding, if that is as good."""
    J = problem.jacobian(z)
    rounding = 16 * _EPS * np.abs(J * z).sum(axis=1)
    inverse = np.linalg.pinv(J * problem.s, rcond=RANK)
    for blur in (np.abs(inverse) @ rounding, _EPS):
        clean = np.where(np.abs(z) < blur * problem.s, 0.0, z)
        if (np.abs(problem(clean)) <= np.abs(problem(z)) + rounding).all():
            z = clean
    return z
