"""Derivatives that are exact to rounding, or known not to be.

The complex step d f / d z_j = Im f(z + i h e_j) / h has no cancellation, but fails in
silence where f is not analytic: it halves the derivative of ``x |x|`` and finds zero for a
rounded x. So it has to agree with differences: of every column alone at a few points, and of
many points along random directions, in which no column may be much weaker than the noise.
Where they disagree, a ladder of steps finds the scale of f's own at which differences settle,
and what they are worth there; that decides.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from statebook.complex_step import ALONE, CHUNK, COMPLEX_STEP, Evaluate, complex_step, step_scale
from statebook.errors import KinkError
from statebook.ladder import Ladder, descend, romberg, slopes_jump

_RADIUS = 0.019318516525781  # of the first differences: no multiple of anybody's period
_RADII = _RADIUS * np.array([1.0, 0.5, 0.25])
_STEPS = np.concatenate([_RADII, -_RADII])
_NEAR = _RADIUS / 80 * np.array([1.0, 0.5, -1.0, -0.5])  # in all columns at once
_FAR = 0.31066017177982  # where f is looked at once more: a staircase is flat nearby
_STEPS_ALONE = np.append(_STEPS, _FAR)
_TRUSTED = 1e-6  # relative error up to which differences are evidence
_EPS = float(np.finfo(float).eps)


def _weights() -> np.ndarray:
    """Return what turns changes of f at _STEPS into differences, (4, 6).

    The slope of order 6, what it differs by from that of order 4, the jump of the slope free
    of second and fourth order, and that free of second order alone.
    """
    unit, zero = np.eye(6), np.zeros((1, 6))
    up, down, radii = unit[:3], unit[3:], _RADII[:, None]
    value, spread = romberg(up, down, radii)
    jump = slopes_jump(up, down, zero, radii)
    return np.concatenate([value, spread, (8 * jump[1:] - jump[:1]) / 7, jump[:1]])


def _joint_weights() -> np.ndarray:
    """Return what turns changes of f at _NEAR into differences, (3, 4).

    The slope of order 4, what it differs by from that of order 2, the jump of the slope.
    """
    unit, radii = np.eye(4), _NEAR[:2, None]
    second = (unit[:2] - unit[2:]) / (2 * radii)
    value = (4 * second[1:] - second[:1]) / 3
    jump = slopes_jump(unit[:2], unit[2:], np.zeros((1, 4)), radii)
    return np.concatenate([value, value - second[1:], jump])


_WEIGHTS = _weights()
_JOINT = _joint_weights()


class InexactDerivativeWarning(UserWarning):
    """A derivative had to be taken by differences; the message gives its error."""


class Derivative(NamedTuple):
    """A derivative with its evidence; J, error and inexact have shape (N, n, c).

    Attributes
    ----------
    J, error : array
        As derivative returns them.
    inexact : array of bool
        What was taken by differences, or hidden by noise from them.
    flat : array of bool, shape (N, n)
        Whether f_i bends more than it rises, so that its slope may be rounding.
    """

    J: np.ndarray
    error: np.ndarray
    inexact: np.ndarray
    flat: np.ndarray


def differentiate(
    f: Evaluate,
    z: np.ndarray,
    columns: Sequence[int] | None = None,
    *,
    scale: np.ndarray | None = None,
    labels: Sequence[str] | None = None,
    f0: np.ndarray | None = None,
) -> Derivative:
    """Differentiate f at each column of z.

    Parameters
    ----------
    f : callable
        Maps (k, N) to (n, N), column by column, and returns NaN where it is undefined.
    z : array, shape (k, N)
    columns : sequence of int, optional
        The c components of z to differentiate with respect to; all k by default.
    scale : array, shape (k, N), optional
        Over which distance f varies; by default abs(z), and 1 where z is 0. Where f varies
        over less, more evaluations find it out.
    labels : sequence of str, optional
        Names of the components of z, for messages.
    f0 : array, shape (n, N), optional
        f(z), if known.

    Returns
    -------
    Derivative
        J and its estimated absolute error, 0 where the complex step is exact to rounding, with
        the rest of the evidence.

    Raises
    ------
    KinkError
        f has no derivative at one of the points.

    References
    ----------
    W. Squire and G. Trapp, SIAM Review 40 (1998), 110-112 (complex step).

    Examples
    --------
    >>> differentiate(np.sin, np.array([[0.0]])).J
    array([[[1.]]])
    """
    s = step_scale(z) if scale is None else scale
    chosen = np.arange(len(z)) if columns is None else np.asarray(columns, dtype=int)
    names = labels or [f"component {j} of (x, u)" for j in range(len(z))]
    with np.errstate(all="ignore"):
        return _Differentiation(f, names, z, s, chosen, f(z) if f0 is None else f0).result()


class _Differentiation:
    """The derivatives of f at points z, while they are being found."""

    def __init__(self, f: Evaluate, labels: Sequence[str], *arrays: np.ndarray) -> None:
        self.f, self.labels = f, labels
        self.z, self.s, self.columns, self.f0 = arrays
        self.eps = _EPS
        self._note_precision(self.f0)

    def _note_precision(self, values: np.ndarray) -> None:
        """A function that returns float32 has no more precision than that."""
        if values.dtype == np.float32 or values.dtype == np.float16:
            self.eps = float(np.finfo(values.dtype).eps)
            self.f0 = self.f0.astype(float)

    def result(self) -> Derivative:
        n, N, c = len(self.f0), self.z.shape[1], len(self.columns)
        self.inexact = np.zeros((n, c, N), dtype=bool)
        self.flat = np.zeros((n, N), dtype=bool)
        self.error = np.zeros((n, c, N))
        self.J = np.zeros((n, c, N))
        if n * N * c:
            exact = complex_step(self.f, self.z, self.s, self.columns)
            if exact is not None:
                self.J = exact if np.isfinite(exact).all() else exact + 0 * exact  # inf to NaN
            if exact is None or N <= ALONE:
                self._check_alone(np.arange(c), np.arange(N), exact is not None)
            else:
                self._check_jointly()
        J, error, inexact = (a.transpose(2, 0, 1) for a in (self.J, self.error, self.inexact))
        return Derivative(J, error, inexact, self.flat.T)

    def _check_jointly(self) -> None:
        """Check J of many points along random directions, and alone where that says little."""
        rng = np.random.default_rng(0)
        J, N, c = self.J, self.z.shape[1], len(self.columns)
        d = np.zeros((len(self.z), 1))
        d[self.columns, 0] = rng.uniform(0.5, 1, c) * rng.choice([-1, 1], c)
        again = np.zeros(N, dtype=bool)
        for first in range(0, N, CHUNK):
            some = slice(first, first + CHUNK)
            again[some] = self._in_doubt(some, d * self.s[:, some])
        # A column that seems to have no part in a row may have one that the step does not see.
        again[rng.choice(N, ALONE // 2, replace=False)] = True
        points = np.flatnonzero(again)
        before = J[..., points].copy()
        self._check_alone(np.arange(c), points, True)
        changed = ((before != J[..., points]) | (self.error[..., points] > 0)).any(axis=(0, 2))
        if changed.any():
            self._check_alone(np.flatnonzero(changed), np.flatnonzero(~again), True)

    def _in_doubt(self, some: slice, d: np.ndarray) -> np.ndarray:
        """Return which points' J disagrees with differences along d, or has too small a share."""
        z, f0 = self.z[:, some], self.f0[:, some]
        shifted = z[:, None] + _NEAR[:, None] * d[:, None]
        change = self.f(shifted.reshape(len(z), -1)).reshape(len(f0), len(_NEAR), -1)
        change = change - f0[:, None]
        value, spread, jump = (_JOINT @ change).swapaxes(0, 1)
        size = self.J[..., some] * d[self.columns]
        expected = size.sum(axis=1)
        np.abs(size, out=size)
        terms, most = size.sum(axis=1), size.max(axis=1)
        noise = (16 * self.eps / _NEAR[1]) * (np.abs(f0) + terms)
        spread = np.abs(spread)
        right = np.abs(value - expected) <= 1e-4 * spread + noise
        right &= np.abs(jump) <= 8 * noise + 3e-4 * spread
        right &= spread <= 1e-6 * terms + noise
        size[size == 0] = np.inf
        return ~right.all(axis=0) | (size.min(axis=1) < 1e-6 * most).any(axis=0)

    def _check_alone(self, cols: np.ndarray, points: np.ndarray, known: bool) -> None:
        """Check columns of J, or find them where they are not known, one by one."""
        here: Any = ...  # much faster than all numbers
        if (len(self.J), cols.size, points.size) != self.J.shape:
            here = np.ix_(np.arange(len(self.J)), cols, points)
        chosen, z = self.columns[cols], self.z[:, points]
        f0, z_j, s_j = self.f0[:, None, points], z[chosen], self.s[chosen][:, points]
        steps = _STEPS_ALONE if known else _STEPS
        shifted = np.empty((len(z), cols.size, steps.size, points.size))
        shifted[:] = z[:, None, None]
        shifted[chosen, np.arange(cols.size)] += steps[:, None] * s_j[:, None]
        values = self.f(shifted.reshape(len(z), -1)).reshape(-1, *shifted.shape[1:])
        self._note_precision(values)
        moved = values - f0[:, :, None]
        found = (_WEIGHTS @ moved[:, :, :6]).transpose(2, 0, 1, 3)
        T, (spread, jump, bend) = found[0], np.abs(found[1:])
        size = np.abs(moved)
        change = size[:, :, :6].max(axis=2)
        if known:
            self._drop_residue(here, cols, points, 1e-18 * change / s_j)
        share = self.J[here] * s_j if known else T
        part = np.abs(share)
        rate = change.max(axis=1) / _RADIUS
        row = np.maximum(part.max(axis=1), rate)[:, None]
        rounding = (4 * self.eps / _RADII[-1]) * (np.abs(f0) + change)
        if known:
            # A slope that the rounding of z makes (of cos at pi/2) is a zero.
            even = np.abs(moved[:, :, 0] + moved[:, :, 3]) / _RADIUS**2
            tiny = part <= 2 * _EPS * np.abs(z_j) / s_j * even
            rest = np.abs(moved - share[:, :, None] * steps[:, None])

        def good_at(noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Return which differences are evidence at a level of noise, and their errors."""
            err = spread + noise
            good = jump <= 20 * noise + 3e-3 * bend + 0.03 * spread
            if not known:
                # A column without effect may be a stair's tread.
                return good & (err <= 1e-7 * row) & ~(change == 0).all(axis=0), err
            good &= err <= 1e-3 * part + 1e-7 * row
            good &= np.abs(T - share) <= 0.1 * spread + noise
            # Noise may hide an entry: look further, unless it is itself no more than rounding.
            good &= (noise <= 1e-3 * part) | (part <= 16 * _EPS * row) | tiny
            near = np.maximum(rest[:, :, :6].max(axis=2), noise)
            good &= rest[:, :, 6] <= 1e8 * near  # or it was the tread of a stair
            return good | ((share == 0) & (np.maximum(change, size[:, :, 6]) == 0)), err

        good, err = good_at(rounding)
        if not good.all():  # f may make more of rounding than its value tells
            measured = (4 / _RADII[-1]) * self._measured_noise(points)[:, None]
            good, err = good_at(np.maximum(rounding, measured))
        if known:
            self.J[here] = np.where(tiny & good, 0.0, self.J[here])
        else:
            still = change == 0
            self.J[here] = np.where(np.abs(T) <= err, 0.0, T) / s_j
            self.error[here] = np.where(still, 0.0, err) / s_j
            self.inexact[here] = ~still
        self.flat[:, points] |= part.max(axis=1) < 0.1 * rate
        if not good.all():
            full = np.zeros(self.f0.shape)
            full[:, points] = row[:, 0]
            for a in np.flatnonzero(~good.all(axis=(0, 2))):
                bad = np.flatnonzero(~good[:, a].all(axis=0))
                for some in np.array_split(points[bad], -(-bad.size // 256)):
                    self._search(int(cols[a]), some, known, full[:, some])

    def _measured_noise(self, points: np.ndarray) -> np.ndarray:
        """Return by how much f changes when all of z moves by an ulp, (n, P)."""
        z = self.z[:, points]
        ulps = np.random.default_rng(1).choice([-1, 1], (len(z), 4, 1)) * _EPS
        values = self.f((z[:, None] * (1 + ulps)).reshape(len(z), -1)).astype(float)
        moved = values.reshape(-1, 4, points.size) - self.f0[:, None, points]
        return np.nan_to_num(np.abs(moved), posinf=0.0).max(axis=1)

    def _drop_residue(
        self, here: Any, cols: np.ndarray, points: np.ndarray, floor: np.ndarray
    ) -> None:
        """Put zeros for what the step leaves of a zero slope, as of x^3 at 0."""
        J = self.J
        suspect = (J[here] != 0) & ~(np.abs(J[here]) > floor)
        if suspect.any():
            z, s = self.z[:, points], self.s[:, points]
            again = complex_step(self.f, z, s, self.columns[cols], COMPLEX_STEP * 1e-10)
            if again is not None:
                steady = np.abs(again - J[here]) <= 1e-3 * np.abs(J[here])
                J[here] = np.where(suspect & ~steady, 0.0, J[here])

    def _search(self, a: int, points: np.ndarray, known: bool, row: np.ndarray) -> None:
        """Find column a of J at points where the first differences did not settle."""
        J, error, j = self.J, self.error, int(self.columns[a])
        z, s = self.z[:, points], self.s[j, points]

        def along(steps: np.ndarray, which: np.ndarray) -> np.ndarray:
            """Return f at z + steps e_j of some points: (Q, P) to (n, Q, P)."""
            shifted = np.repeat(z[:, None, which], len(steps), axis=1)
            shifted[j] += steps
            return self.f(shifted.reshape(len(z), -1)).reshape(-1, *steps.shape).astype(float)

        exact = J[:, a, points] if known else None
        rough = self._measured_noise(points)
        f0, floor = self.f0[:, points], 1e-9 * row / s
        ladder = descend(along, f0, z[j], s, exact, self.eps, floor, rough)
        self._refuse(ladder, j)
        value, err = ladder.value, ladder.error
        if exact is None:
            J[:, a, points] = np.where(np.abs(value) <= err, 0.0, value)
            error[:, a, points] = np.where(ladder.still, 0.0, err)
            return
        apart = np.abs(exact - value)
        agree = apart <= 3 * err + 1e-14 * row / s
        trusted = err <= _TRUSTED * np.abs(exact)
        # Where noise hides the slope, the complex step stands, with what is known of it.
        rounding = np.abs(exact) <= ladder.residue
        kept = np.where(rounding, 0.0, exact)
        sure = trusted | rounding | ladder.still | ((exact == 0) & (value == 0))
        doubt = np.where(sure, 0.0, apart + err)
        J[:, a, points] = np.where(agree, kept, value)
        error[:, a, points] = np.where(agree, doubt, np.maximum(err, _EPS * np.abs(value)))
        hidden = doubt > _TRUSTED * np.maximum(row / s, ladder.rate)
        # What rounding of the row may have done is no sign of a function that is not analytic.
        self.inexact[:, a, points] = ~(apart <= 3 * err + 5e-14 * row / s) | hidden

    def _refuse(self, ladder: Ladder, j: int) -> None:
        """Raise where column j has no derivative."""
        label = self.labels[j]
        if ladder.undefined.any():
            raise KinkError(
                f"no derivative with respect to {label}: the function is undefined on at least"
                " one side of the point; move the point into the domain"
            )
        if ladder.kink.any():
            i, p = np.argwhere(ladder.kink)[0]
            below, above = ladder.sides[:, i, p]
            size = abs(above - below)
            below, above = (v if abs(v) > 1e-9 * size else 0.0 for v in (below, above))
            raise KinkError(
                f"no derivative with respect to {label}: the slope of row {i} is {below:.7g} below"
                f" the point and {above:.7g} above it, as at the edge of a saturation; to take"
                f" one side, move {label} off the edge to that side, or leave {label} out"
                " (inputs=, states=)"
            )
        if ladder.unsettled.any():
            i, p = np.argwhere(ladder.unsettled)[0]
            raise KinkError(
                f"no derivative could be determined with respect to {label}: the differences of"
                f" row {i} do not settle (error estimate {ladder.error[i, p]:.1g}); move the point"
                f" away from the discontinuity, or leave {label} out (inputs=, states=)"
            )
