"""What a solver knows between the ends of its steps, and the samples taken from it."""

import bisect
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

_MOST = 2**28  # bytes of steps that are kept


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
        flat = flat.T if isinstance(self.curve, scipy.interpolate.PPoly) else flat
        return unflatten(flat, self.shape, self.by_rows).reshape(*self.shape, *np.shape(t))

    def slopes(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the time derivatives at times (T,), and the lengths of the steps there."""
        curve = self.curve
        polynomial = isinstance(curve, scipy.interpolate.PPoly)
        ends = curve.x if polynomial else curve.ts
        k = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, len(ends) - 2)
        lengths = np.diff(ends)[k]
        if polynomial:
            flat = curve.derivative()(t).T
        else:
            steps = zip(t, 1e-3 * lengths, (curve.interpolants[i] for i in k), strict=True)
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
        self.shown = times  # what the trajectory calls them
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

    def end_at(self, t: float) -> None:
        """End the run at a time within the last step."""
        count = int(np.searchsorted(self.times, t))
        self.state, self.time = self.at(t), t
        self.times = self.shown = np.append(self.times[:count], t)
        self.settle()
        before = np.concatenate(self.samples, axis=-1)[..., :count]
        self.samples, self.taken = [before, self.state[..., None]], count + 1

    def settle(self) -> DenseOutput | None:
        """Take the samples within the steps; return the dense output of the run, if it has one."""
        if not self._pieces:
            return None
        ends = np.array([self._pieces[0].t_old, *self._ends])
        if self._by_rows and hasattr(self._pieces[0], "Q"):  # a polynomial, in shares of its step
            Q = np.array([p.Q for p in self._pieces])
            Q /= np.diff(ends)[:, None, None] ** np.arange(Q.shape[2])
            c = np.stack([*Q.transpose(2, 0, 1)[::-1], [p.y_old for p in self._pieces]])
            curve: Any = scipy.interpolate.PPoly(c, ends)
        else:
            curve = scipy.integrate.OdeSolution(ends, self._pieces)
        dense = DenseOutput(curve, self.state.shape, self._by_rows)
        upto = int(np.searchsorted(self.times, ends[-1], side="right"))
        if upto > self.taken:
            self.samples.append(dense(self.times[self.taken : upto]))
            self.taken = upto
        return replace(dense, curve=None) if self._dropped else dense
