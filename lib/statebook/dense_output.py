"""What a solver knows between the ends of its steps, and the samples taken from it."""

from __future__ import annotations

import bisect
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy

_MOST = 2**28  # bytes of steps that are kept


class StepPolynomial(NamedTuple):
    """The states of a step: y_old + s sum_j Q_j (s / h)^j, s the time since its start."""

    t_old: float
    t: float
    y_old: np.ndarray
    Q: np.ndarray  # (degree, size)

    def __call__(self, t: Any) -> np.ndarray:
        """Return the flat states at times: (size,) or (size, T)."""
        since = np.asarray(t - self.t_old)[..., None]
        share = since / (self.t - self.t_old)
        value = 0.0 * since
        for row in self.Q[::-1]:
            value = value * share + row
        return (value * since + self.y_old).T


class StepPolynomials(NamedTuple):
    """The polynomials of the steps of a run."""

    ts: np.ndarray  # ends of the steps, (S + 1,)
    y_old: np.ndarray  # (S, size)
    Q: np.ndarray  # (S, degree, size)

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Return the flat states (size, T) at times (T,)."""
        k, lengths = step_at(t, self.ts)
        since = (t - self.ts[k])[:, None]
        value = self._sum(k, since / lengths[:, None], np.ones(self.Q.shape[1]))
        return (value * since + self.y_old[k]).T

    def slopes(self, t: np.ndarray) -> np.ndarray:
        """Return the flat time derivatives (size, T) at times (T,)."""
        k, lengths = step_at(t, self.ts)
        share = ((t - self.ts[k]) / lengths)[:, None]
        return self._sum(k, share, np.arange(1.0, self.Q.shape[1] + 1)).T

    def _sum(self, k: np.ndarray, share: np.ndarray, weights: np.ndarray) -> np.ndarray:
        value = 0.0 * share
        for j in range(len(weights))[::-1]:
            value = value * share + weights[j] * self.Q[k, j]
        return value


def step_at(t: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the steps that times are in, and their lengths."""
    k = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, len(ends) - 2)
    return k, np.diff(ends)[k]


@dataclass(frozen=True, eq=False)
class DenseOutput:
    """A solver's own interpolation of a run; its curve is None if it was too large to keep."""

    curve: Any
    shape: tuple[int, ...]
    by_rows: bool

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Return the states (n, ...) or (n, N, ...) at times of any shape."""
        if self.curve is None:
            raise ValueError(
                "the states between the samples of so large a batch were not kept: ask for the "
                'times wanted in simulate (times=), or for at(t, "linear")'
            )
        flat = self.curve(np.ravel(t))
        return unflatten(flat, self.shape, self.by_rows).reshape(*self.shape, *np.shape(t))

    def slopes(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the time derivatives at times (T,), and the lengths of the steps there."""
        k, lengths = step_at(t, self.curve.ts)
        if isinstance(self.curve, StepPolynomials):
            flat = self.curve.slopes(t)
        else:
            steps = zip(t, 1e-3 * lengths, (self.curve.interpolants[i] for i in k), strict=True)
            flat = np.stack([(p(s + d) - p(s - d)) / (2 * d) for s, d, p in steps], axis=-1)
        return unflatten(flat, self.shape, self.by_rows), lengths


def unflatten(flat: np.ndarray, shape: tuple[int, ...], by_rows: bool) -> np.ndarray:
    """Bring flat states (size, ...) to (n, ...) or (n, N, ...)."""
    if by_rows or len(shape) == 1:
        return flat.reshape(*shape, *flat.shape[1:])
    return flat.reshape(*shape[::-1], *flat.shape[1:]).swapaxes(0, 1)


class Steps:
    """A run so far: its last state, the samples taken, the dense output of its steps.

    Parameters
    ----------
    x : array, shape (n,) or (n, N)
        The state at the first time.
    times : array, shape (T,)
        Where samples are wanted.
    by_rows : bool
        Whether the solver holds a batch row by row, not one trajectory after another.
    all_kept : bool
        Whether the steps are kept however many they are.
    """

    def __init__(
        self, x: np.ndarray, times: np.ndarray, *, by_rows: bool = True, all_kept: bool = False
    ) -> None:
        self.state, self.time, self.times = x, float(times[0]), times
        self.samples, self.taken = [x[..., None]], 1
        self._by_rows, self._all_kept = by_rows, all_kept
        self._pieces: list[Any] = []
        self._ends: list[float] = []
        self._bytes, self._dropped = 0, False

    def advance(self, t: float, x: np.ndarray) -> None:
        """Take a step that ends in a state; if a sample is wanted there, that is it."""
        self.time, self.state = t, x
        if self.taken < len(self.times) and t == self.times[self.taken]:
            self.samples.append(x[..., None])
            self.taken += 1

    def add(self, piece: Any, y: np.ndarray) -> None:
        """Take a step: its dense output, and the flat state at its end."""
        self.time, self.state = piece.t, unflatten(y, self.state.shape, self._by_rows)
        if piece.t == piece.t_old:  # LSODA at a singularity
            return
        self._pieces.append(piece)
        self._ends.append(piece.t)
        self._bytes += 6 * y.nbytes + 500
        if self._bytes > _MOST and not self._all_kept:
            self.settle()
            self._pieces, self._ends = self._pieces[-1:], self._ends[-1:]
            self._bytes, self._dropped = 0, True

    def at(self, t: float) -> np.ndarray:
        """The state at a time within the steps so far."""
        k = min(bisect.bisect_left(self._ends, t), len(self._ends) - 1)
        return unflatten(self._pieces[k](t), self.state.shape, self._by_rows)

    def times_between(self, start: float, end: float) -> list[float]:
        """The times wanted between two times."""
        first, last = np.searchsorted(self.times, start, "right"), np.searchsorted(self.times, end)
        return self.times[first:last].tolist()

    def end_at(self, t: float) -> None:
        """End the run at a time within the last step."""
        count = int(np.searchsorted(self.times, t))
        self.state, self.time = self.at(t), t
        self.times = np.append(self.times[:count], t)
        self.settle()
        before = np.concatenate(self.samples, axis=-1)[..., :count]
        self.samples, self.taken = [before, self.state[..., None]], count + 1

    def settle(self) -> DenseOutput | None:
        """Take the samples within the steps; return the dense output of the run, if it has one."""
        if not self._pieces:
            return None
        ends = [self._pieces[0].t_old, *self._ends]
        if isinstance(self._pieces[0], StepPolynomial):
            y_old, Q = (np.array([getattr(p, a) for p in self._pieces]) for a in ("y_old", "Q"))
            curve: Any = StepPolynomials(np.array(ends), y_old, Q)
        else:
            curve = scipy.integrate.OdeSolution(ends, self._pieces)
        dense = DenseOutput(curve, self.state.shape, self._by_rows)
        upto = int(np.searchsorted(self.times, ends[-1], side="right"))
        if upto > self.taken:
            self.samples.append(dense(self.times[self.taken : upto]))
            self.taken = upto
        return replace(dense, curve=None) if self._dropped else dense
