"""Eigenvalues followed along a parameter, and where they cross the stability boundary."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.errors import EquilibriumNotFoundError
from statebook.verdict.followed import Followed, Sample
from statebook.verdict.level_sets import margin, project
from statebook.verdict.words import format_complex, sorting

_HALVINGS = 12  # of a step, before what is between its ends counts as a jump
_STEPS = 16  # at least, over all values
_BACK = 0.1  # of the way there, by which the way back may miss
_SIDES = ("outside", "on the boundary", "inside")


@dataclass(frozen=True)
class Crossing:
    """A value of a parameter at which an eigenvalue reaches or leaves the stability boundary.

    Attributes
    ----------
    value : float
        Of the parameter.
    eigenvalue : complex
        There; of a conjugate pair the one with the positive imaginary part.
    before, after : {"inside", "on the boundary", "outside"}
        Where it is on either side, in the order of the values.
    frequency : float [rad/s]
        Of the motion there: abs(Im s), in discrete time abs(angle(z)) / dt; 0 where it is no
        oscillation.
    x, u : array, shape (n,) and (m,), or None
        The equilibrium there; None of a matrix.
    """

    value: float
    eigenvalue: complex
    before: str
    after: str
    frequency: float
    x: np.ndarray | None
    u: np.ndarray | None

    def __repr__(self) -> str:
        where = format_complex(self.eigenvalue, abs(self.eigenvalue))
        return f"{self.value:.10g}: {where}, from {self.before} to {self.after}"


@dataclass(frozen=True, eq=False)
class Locus:
    """Eigenvalues along a parameter.

    Attributes
    ----------
    parameter : str
    values : array, shape (N,)
        Of the parameter.
    eigenvalues : array, shape (N, n), complex
        Column j is one eigenvalue, followed.
    x, u : array, shape (n, N) and (m, N), or None
        The equilibria; None of matrices.
    crossings : tuple of Crossing
        In the order of the values.
    dt : float, bool or None
        Timebase, as in python-control.
    """

    parameter: str
    values: np.ndarray
    eigenvalues: np.ndarray
    x: np.ndarray | None
    u: np.ndarray | None
    crossings: tuple[Crossing, ...]
    dt: float | bool | None

    def __repr__(self) -> str:
        N, n = self.eigenvalues.shape
        ends = f"{self.values[0]:.6g} to {self.values[-1]:.6g} ({N} values)"
        found = [f"{self.parameter} = {crossing}" for crossing in self.crossings]
        found = found or ["none crosses the stability boundary"]
        return "\n".join([f"{n} eigenvalues over {self.parameter} from {ends}", *found])


def eigenvalue_locus(
    model: Any,
    grid: Mapping[str, Any],
    x0: Any = None,
    u0: Any = None,
    *,
    dt: float | bool | None = None,
    t: float | None = None,
    trim: Mapping[str, Any] | None = None,
) -> Locus:
    """Follow eigenvalues along a parameter and find where they cross.

    The equilibrium follows the parameter; each eigenvalue keeps its column. Between values at
    which one changes sides of the imaginary axis (the unit circle) the crossing is found to
    about 1e-12 of the value: flutter and weave speeds, Hopf points, largest gains.

    Parameters
    ----------
    model : system, or factory
        A library model or another dataclass, whose field is the parameter; a function
        f(x, u, ...) with a keyword; a control.NonlinearIOSystem with an entry of params; or a
        factory, which returns a matrix (n, n) or any system for a value of the parameter. The
        label of an input (or of a state, which trim then leaves the inputs to hold) will do too.
    grid : mapping of str to array, shape (N,)
        The parameter and its values, at least 2, in increasing or decreasing order.
    x0, u0 : array, shape (n,) and (m,), optional
        The equilibrium at the first value, or a guess of it. Matrices have none.
    dt : float, bool or None
        Timebase of a function or of matrices: True or > 0 [s] is discrete.
    t : float, optional [s]
        The time at which a system that depends on it is frozen.
    trim : mapping, optional
        Further arguments of `find_equilibrium`, as {"fixed": ["theta"]}.

    Returns
    -------
    Locus

    Raises
    ------
    EquilibriumNotFoundError
        There is no equilibrium at a value, or it ends between two, as at a fold.
    TypeError, ValueError
        The model has no such parameter, or the values are not in order.

    Notes
    -----
    Steps are halved until eigenvalues can be told apart and the way back leads to the same
    equilibrium. Windows narrower than the steps are looked for where a margin is least.

    References
    ----------
    Kuznetsov, *Elements of Applied Bifurcation Theory*, sections 3.3 and 10.2.

    Examples
    --------
    >>> def oscillator(x, mu=0.0):
    ...     return [x[1], -x[0] + (mu - 0.25 - x[0] ** 2) * x[1]]
    >>> eigenvalue_locus(oscillator, {"mu": [0.0, 1.0]}, [0, 0])
    2 eigenvalues over mu from 0 to 1 (2 values)
    mu = 0.25: 1j, from inside to outside
    """
    if not isinstance(grid, Mapping) or len(grid) != 1:
        raise TypeError(f"grid must map one parameter to its values, got {grid!r}")
    ((name, given),) = grid.items()
    values = _validate.real_array(f"grid[{name!r}]", given, (None,))
    if len(values) < 2 or not (np.all(np.diff(values) > 0) or np.all(np.diff(values) < 0)):
        raise ValueError(f"grid[{name!r}] must hold at least 2 values in order, got {values}")
    walk = _Walk(Followed(model, (name,), x0, u0, dt, t, trim), name)
    samples = walk.along(values)
    crossings = walk.crossings(samples)
    walk.followed.warn()
    asked = [sample for sample in samples if sample.p in values]
    x, u = (
        None if asked[0].x is None else np.stack([getattr(s, a) for s in asked], 1) for a in "xu"
    )
    eigenvalues = np.stack([sample.eigenvalues for sample in asked])
    return Locus(name, values, eigenvalues, x, u, crossings, asked[0].dt)


class _Walk:
    """Samples along one parameter, each with its eigenvalues in the order of the one before."""

    def __init__(self, followed: Followed, name: str) -> None:
        self.followed, self.name, self.size = followed, name, 0.0

    def at(self, p: float, beside: Sample | None = None) -> Sample:
        try:
            return self.followed.at({self.name: p}, beside)
        except EquilibriumNotFoundError as error:
            raise EquilibriumNotFoundError(f"at {self.name} = {p:.6g}: {error}") from error

    def along(self, values: np.ndarray) -> list[Sample]:
        """Walk through the values, in shorter steps where the way is not clear."""
        first = self.at(float(values[0]))
        samples = [_in_order(first, sorting(first.eigenvalues))]
        self.size = np.abs(values).max()
        longest = abs(values[-1] - values[0]) / _STEPS
        for start, end in pairwise(values.tolist()):
            # The first and the last step are short: the slope at an end shows a dip beside it.
            near = 1e-3 * (end - start)
            ahead = [end]
            if end == values[-1]:
                ahead.append(end - near)
            if len(samples) == 1:
                ahead.append(start + near)
            shortest = min(abs(end - start), longest) / 2**_HALVINGS
            while ahead:
                last, p = samples[-1], ahead[-1]
                short = len(samples) == 1 or abs(p - last.p) <= shortest
                try:
                    new, clear = self._step(samples, p)
                except EquilibriumNotFoundError as error:
                    if short:
                        raise EquilibriumNotFoundError(
                            f"the equilibrium was followed to {self.name} = {last.p:.10g}, and not"
                            f" beyond it, as at a fold; choose values on one side of it ({error})"
                        ) from error
                    clear = False
                if short or (clear and abs(p - last.p) <= longest):
                    samples.append(new)
                    ahead.pop()
                else:
                    ahead.append((last.p + p) / 2)
        return samples

    def _step(self, samples: list[Sample], p: float) -> tuple[Sample, bool]:
        """Return the sample at p, and whether it is clear which eigenvalue is which."""
        last = samples[-1]
        new = self.at(p, last)
        if not self._is_same(samples, new):
            raise EquilibriumNotFoundError(f"the search at {p:.10g} fell onto another equilibrium")
        here, there = last.eigenvalues, new.eigenvalues
        if len(samples) == 1:
            return _in_order(new, _matched(here, there)[1]), False
        before = samples[-2]
        slope = (here - before.eigenvalues) / (last.p - before.p)
        far, order = _matched(here + slope * (p - last.p), there)
        near, closest = _matched(here, there)
        rows = np.arange(len(here))
        moved, size = near[rows, closest].sum(), 1e-9 * np.abs(here).sum()
        agree = near[rows, order].sum() <= (1 + 1e-6) * moved + size
        return _in_order(new, order), bool(agree and far[rows, order].sum() <= 0.5 * moved + size)

    def _is_same(self, samples: list[Sample], new: Sample) -> bool:
        """Whether the new equilibrium is the last one followed: ahead of it, or on the way back."""
        last = samples[-1]
        if last.x is None or new.x is None or np.array_equal(last.x, new.x):
            return True
        size = np.maximum(np.abs(last.x), np.abs(new.x)) + 1e-6
        expected, moved = last.x, np.abs((new.x - last.x) / size).max()
        if len(samples) > 1 and (before := samples[-2]).x is not None:
            share = (new.p - last.p) / (last.p - before.p)
            expected = last.x + share * (last.x - before.x)
        if np.abs((new.x - expected) / size).max() <= _BACK * moved + 1e-9:
            return True
        try:
            back = self.at(last.p, new)
        except EquilibriumNotFoundError:
            return False
        return bool(np.abs((back.x - last.x) / size).max() <= _BACK * moved + 1e-9)

    def _follower(self, known: list[Sample]) -> Callable[[float], Sample]:
        """Return the function of p that finds the sample between samples that are known.

        All eigenvalues are matched with what lies between their neighbours, so that one is not
        taken for another that rests where it passes.
        """
        samples = sorted(known, key=_place)

        def follow(p: float) -> Sample:
            at = min(max(bisect_left(samples, p, key=_place), 1), len(samples) - 1)
            a, b = samples[at - 1 : at + 1]
            sample = self.at(p, a if abs(p - a.p) < abs(p - b.p) else b)
            share = (p - a.p) / (b.p - a.p) if b.p != a.p else 0.0
            expected = a.eigenvalues + share * (b.eigenvalues - a.eigenvalues)
            sample = _in_order(sample, _matched(expected, sample.eigenvalues)[1])
            insort(samples, sample, key=_place)
            return sample

        return follow

    def crossings(self, samples: list[Sample]) -> tuple[Crossing, ...]:
        """Find where each eigenvalue changes sides."""
        samples = self._with_dips(samples)
        found: list[Crossing] = []
        for j in range(len(samples[0].eigenvalues)):
            sides = _sides(samples, j)
            runs = [list(run) for _, run in groupby(range(len(sides)), key=sides.__getitem__)]
            # One sample on the boundary, with others on both sides of it, is a passage or a touch.
            inner = range(1, len(sides) - 1)
            runs = [run for run in runs if sides[run[0]] or len(run) > 1 or run[0] not in inner]
            for one, two in pairwise(runs):
                before, after = sides[one[0]], sides[two[0]]
                if before == after:
                    continue
                at = self._located(j, samples[one[-1]], samples[two[0]], before, after)
                z = complex(project(at.eigenvalues[j], at.discrete))
                s = np.log(z) / float(at.dt or 1) if at.discrete else z
                if s.imag >= 0:  # the conjugate crosses with it
                    ends = _SIDES[1 + before], _SIDES[1 + after]
                    found.append(Crossing(at.p, z, *ends, float(s.imag), at.x, at.u))
        found.sort(key=lambda c: abs(c.value - samples[0].p))
        return tuple(c for c in found if not _hidden(c, found))

    def _located(self, j: int, a: Sample, b: Sample, before: int, after: int) -> Sample:
        """Return the sample at which eigenvalue j crosses between two others."""
        follow = self._follower([a, b])

        def inside(p: float) -> float:
            return float(margin(follow(p).eigenvalues[j], a.discrete))

        if before * after < 0:
            return follow(scipy.optimize.brentq(inside, a.p, b.p, xtol=1e-15 * self.size))
        # It rests on the boundary at one end: bisect for where it leaves.
        on, off = (a.p, b.p) if before == 0 else (b.p, a.p)
        end = on
        while abs(off - on) > 1e-12 * self.size:
            p = (on + off) / 2
            on, off = (p, off) if inside(p) == 0 else (on, p)
        return follow(end if abs(on - end) <= 1e-11 * self.size else on)

    def _with_dips(self, samples: list[Sample]) -> list[Sample]:
        """Add the samples at which an eigenvalue goes to the other side between two others."""
        first, extra = samples[0], []
        for j in range(len(first.eigenvalues)):
            sides = _sides(samples, j)
            distances = [abs(margin(s.eigenvalues[j], s.discrete)) for s in samples]
            for k in range(1, len(samples) - 1):
                a, b, c = distances[k - 1 : k + 2]
                if len({*sides[k - 1 : k + 2]}) > 1 or b >= (1 - 1e-6) * min(a, c):
                    continue
                follow = self._follower(samples[k - 1 : k + 2])
                low, high = sorted((samples[k - 1].p, samples[k + 1].p))
                lowest = scipy.optimize.minimize_scalar(
                    lambda p, j=j, side=sides[k], follow=follow: (
                        side * margin(follow(p).eigenvalues[j], first.discrete)
                    ),
                    bounds=(low, high),
                    method="bounded",
                    options={"xatol": 1e-6 * (high - low)},
                )
                if lowest.fun < 0:
                    extra.append(float(lowest.x))
        added = map(self._follower(samples), extra)
        return sorted([*samples, *added], key=lambda sample: abs(sample.p - first.p))


def _hidden(one: Crossing, all_of_them: list[Crossing]) -> bool:
    """Whether it goes inside where another one, which split from it, goes outside: at flutter."""
    return {one.before, one.after} == {"inside", "on the boundary"} and any(
        "outside" in (other.before, other.after)
        and abs(other.value - one.value) <= 1e-9 * abs(one.value)
        and abs(other.eigenvalue - one.eigenvalue) <= 1e-6 * abs(one.eigenvalue)
        for other in all_of_them
    )


def _place(sample: Sample) -> float:
    return sample.p


def _in_order(sample: Sample, order: np.ndarray) -> Sample:
    return replace(sample, eigenvalues=sample.eigenvalues[order])


def _matched(expected: np.ndarray, found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return all distances, and the order of those found that makes their sum the least."""
    distances = np.abs(expected[:, None] - found)
    return distances, scipy.optimize.linear_sum_assignment(distances)[1]


def _sides(samples: list[Sample], j: int) -> list[int]:
    return [int(np.sign(margin(s.eigenvalues[j], s.discrete))) for s in samples]
