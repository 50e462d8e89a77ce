"""Derivatives that are exact to rounding, or known not to be.

The complex step d f / d z_j = Im f(z + i h e_j) / h has no cancellation, but fails in
silence where f is not analytic: it halves the derivative of ``x |x|`` and finds zero for a
rounded x. So it has to agree with differences: of every column alone at a few points, and of
many points along random directions, in which no column may be much weaker than the noise.
Where they disagree, a ladder of steps finds the scale of f's own at which differences settle,
and what they are worth there; that decides.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import numpy as np

from statebook.errors import KinkError
from statebook.ladder import Ladder, descend, romberg

_COMPLEX_STEP = 1e-40  # relative to the scale of a variable
_RADIUS = 0.019318516525781  # of the first differences: no multiple of anybody's period
_RADII = _RADIUS * np.array([1.0, 0.5, 0.25])
_FAR = 0.31066017177982  # where f is looked at once more: a staircase is flat nearby
_ALONE = 64  # points, up to which every column is checked alone
_TRUSTED = 1e-6  # relative error up to which differences are evidence
_EPS = float(np.finfo(float).eps)

Evaluate = Callable[[np.ndarray], np.ndarray]


class InexactDerivativeWarning(UserWarning):
    """A derivative had to be taken by differences; the message gives its error."""


def step_scale(z: np.ndarray) -> np.ndarray:
    """Return the size of a variation of z: its own size, and 1 where it is zero."""
    size = np.abs(z)
    return np.where(size > 1e-14, size, 1.0)


def derivative(
    f: Evaluate,
    z: np.ndarray,
    columns: Sequence[int] | None = None,
    *,
    scale: np.ndarray | None = None,
    labels: Sequence[str] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
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

    Returns
    -------
    J : array, shape (N, n, c)
    error : array, shape (N, n, c)
        Estimated absolute error; 0 where the complex step is exact to rounding.

    Raises
    ------
    KinkError
        f has no derivative at one of the points.

    References
    ----------
    W. Squire and G. Trapp, SIAM Review 40 (1998), 110-112 (complex step).

    Examples
    --------
    >>> derivative(np.sin, np.array([[0.0]]))[0]
    array([[[1.]]])
    """
    return differentiate(f, z, columns, scale=scale, labels=labels)[:2]


def differentiate(
    f: Evaluate,
    z: np.ndarray,
    columns: Sequence[int] | None = None,
    *,
    scale: np.ndarray | None = None,
    labels: Sequence[str] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what derivative does, and which entries the complex step does not vouch for."""
    with np.errstate(all="ignore"):
        return _Differentiation(f, z, columns, scale, labels).result()


def complex_step(
    f: Evaluate, z: np.ndarray, s: np.ndarray, columns: np.ndarray, step: float = _COMPLEX_STEP
) -> np.ndarray | None:
    """Return Im f(z + i h e_j) / h, (n, c, N), unchecked; None where f is real-only."""
    k, N = z.shape
    h = step * s[columns]
    # One call for all columns if they are few; large batches are faster in parts.
    width = len(columns) if N <= _ALONE else 1
    parts = []
    with warnings.catch_warnings():
        warnings.simplefilter("error", np.exceptions.ComplexWarning)
        for first in range(0, len(columns), width):
            chosen = columns[first : first + width]
            shifted = np.empty((k, len(chosen), N), dtype=complex)
            shifted[:] = z[:, None]
            shifted.imag[chosen, np.arange(len(chosen))] = h[first : first + width]
            try:
                result = f(shifted.reshape(k, -1))
            except Exception:  # whatever a function does with numbers it was not written for
                return None
            if result.dtype != complex:  # real, or too short for the step
                return None
            parts.append(result.imag.reshape(-1, len(chosen), N))
    return np.concatenate(parts, axis=1) / h if len(parts) > 1 else parts[0] / h


def search_jacobian(f: Evaluate, z: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return d f / d z at one point z (k,), fast and not verified; NaN where undefined.

    By complex step, if that agrees with differences along one direction, or by differences of
    steps of 1e-6 s.
    """
    with np.errstate(all="ignore"):
        direction = s * np.random.default_rng(z.size).uniform(0.5, 1.0, z.size)
        exact = complex_step(f, z[:, None], s[:, None], np.arange(z.size))
        if exact is not None:
            steps = np.array([2e-5, -2e-5, 1e-5, -1e-5])
            values = f(z[:, None] + direction[:, None] * steps).T.astype(float)
            J = exact[..., 0]
            slope = (values[::2] - values[1::2]) / (2 * steps[::2, None])
            found, size = (4 * slope[1] - slope[0]) / 3, np.abs(J) @ direction
            allowed = 1e-3 * size + np.abs(found - slope[1]) + 1e-9 * np.abs(values[0])
            if (np.abs(J @ direction - found) <= allowed).all():
                return J
        h = 1e-6 * np.diag(s)
        up, down = np.split(f(z[:, None] + np.concatenate([h, -h], axis=1)).astype(float), 2, axis=1)
        return (up - down) / (2e-6 * s)


class _Differentiation:
    """The derivatives of f at points z, while they are being found."""

    def __init__(
        self,
        f: Evaluate,
        z: np.ndarray,
        columns: Sequence[int] | None,
        scale: np.ndarray | None,
        labels: Sequence[str] | None,
    ) -> None:
        self.f, self.z = f, z
        self.columns = np.arange(len(z)) if columns is None else np.asarray(columns, dtype=int)
        self.s = step_scale(z) if scale is None else scale
        self.labels = labels or [f"component {j} of (x, u)" for j in range(len(z))]
        self.f0 = f(z)
        kind = self.f0.dtype
        self.eps = float(np.finfo(kind).eps) if kind.kind in "fc" else _EPS
        if kind.kind != "f" or kind != float:
            self.f0 = self.f0.astype(float)

    def result(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return J, its error and where it is inexact, each (N, n, c)."""
        n, N, c = len(self.f0), self.z.shape[1], len(self.columns)
        self.inexact = np.zeros((n, c, N), dtype=bool)
        if n * N * c == 0:
            empty = np.zeros((N, n, c))
            return empty, empty, empty.astype(bool)
        exact = complex_step(self.f, self.z, self.s, self.columns)
        J = np.zeros((n, c, N)) if exact is None else np.where(np.isfinite(exact), exact, np.nan)
        error = np.zeros((n, c, N))
        if exact is None or N <= _ALONE:
            self._check_alone(J, error, np.arange(c), np.arange(N), exact is not None)
        else:
            self._check_jointly(J, error)
        J, error, inexact = (a.transpose(2, 0, 1) for a in (J, error, self.inexact))
        return J, error, inexact

    def _check_jointly(self, J: np.ndarray, error: np.ndarray) -> None:
        """Check J of many points along random directions, and alone where that says little."""
        rng = np.random.default_rng(0)
        N, every = J.shape[2], np.arange(J.shape[1])
        d = np.zeros((len(self.z), 1))
        d[self.columns, 0] = rng.uniform(0.5, 1, every.size) * rng.choice([-1, 1], every.size)
        d = d * self.s
        radii = 0.05 * _RADII
        samples = [self.f(self.z + sign * r * d) for r in radii for sign in (1, -1)]
        up, down = (np.stack(samples[k::2], axis=1) for k in (0, 1))  # (n, 3, N)
        value, spread, even = romberg(up, down, self.f0[:, None], radii[:, None])
        shares = J * d[self.columns]
        expected = shares.sum(axis=1)
        size = np.abs(shares)
        terms = size.sum(axis=1)
        noise = 4 * self.eps * (np.maximum(np.abs(up[:, 0]), np.abs(self.f0)) + terms) / radii[-1]
        wrong = ~(np.abs(value[:, 0] - expected) <= spread[:, 0] + noise)
        wrong |= ~(spread[:, 0] <= 1e-8 * terms + noise)
        wrong |= ~(even[:, 0] <= 1e-6 * terms + 8 * noise)
        weak = ((size > 0) & (size < 1e-5 * size.max(axis=1)[:, None])).any(axis=(0, 1))
        again = wrong.any(axis=0) | weak
        # A column that seems to have no part in a row may have one that the step does not see.
        again[rng.choice(N, _ALONE // 2, replace=False)] = True
        points = np.flatnonzero(again)
        before = J[..., points].copy()
        self._check_alone(J, error, every, points, True)
        changed = ((before != J[..., points]) | (error[..., points] > 0)).any(axis=(0, 2))
        self._check_alone(J, error, every[changed], np.flatnonzero(~again), True)

    def _check_alone(
        self, J: np.ndarray, error: np.ndarray, cols: np.ndarray, points: np.ndarray, known: bool
    ) -> None:
        """Check columns of J, or find them where they are not known, one by one, in place."""
        if cols.size * points.size == 0:
            return
        chosen, z, s = self.columns[cols], self.z[:, points], self.s[:, points]
        f0, s_j = self.f0[:, None, None, points], s[chosen]
        steps = np.concatenate([_RADII, -_RADII, [_FAR] if known else []])
        shifted = np.broadcast_to(
            z[:, None, None], (len(z), cols.size, steps.size, points.size)
        ).copy()
        shifted[chosen, np.arange(cols.size)] += steps[:, None] * s_j[:, None]
        values = self.f(shifted.reshape(len(z), -1)).reshape(-1, *shifted.shape[1:])
        up, down = values[:, :, :3], values[:, :, 3:6]
        T, spread, even = (a[:, :, -1] for a in romberg(up, down, f0, _RADII[:, None]))
        here = np.ix_(range(len(J)), cols, points)
        size = np.abs(values - f0)
        change = size[:, :, :6].max(axis=2)
        if known:
            self._drop_residue(J, here, change / s_j)
        share = J[here] * s_j if known else T
        row = np.maximum(np.abs(share), change / _RADIUS).max(axis=1)[:, None]
        noise = 2 * self.eps * (np.abs(values[:, :, :6]).max(axis=2) + np.abs(f0[:, :, 0]))
        noise = noise + self.eps * np.abs(share)
        err = spread + noise / _RADII[-1]
        still = ~size.any(axis=2)  # f_i does not depend on z_j
        good = err <= np.where(known, 1e-3 * np.abs(share), 0.0) + 1e-7 * np.abs(row)
        good &= ~(even > 20 * noise / _RADII[-1])
        if known:
            good &= np.abs(T - share) <= err
            rest = np.abs(values - f0 - share[:, :, None] * steps[:, None])
            near, far = rest[:, :, :6].max(axis=2), rest[:, :, 6]
            good &= ~(far > 1e8 * np.maximum(near, noise))
            good |= still & (share == 0)
            # A slope that the rounding of z makes (of cos at pi/2) is a zero.
            bend = np.abs(up[:, :, 0] + down[:, :, 0] - 2 * f0[:, :, 0]) / _RADIUS**2
            blur = 2 * _EPS * np.abs(z[chosen]) / s_j * bend
            tiny = good & (share != 0) & (np.abs(share) <= blur)
            J[here] = np.where(tiny, 0.0, J[here])
            # Noise hides an entry: search for it, unless it is itself no more than rounding.
            hidden = good & (share != 0) & ~tiny & (err > 1e-3 * np.abs(share))
            good &= ~hidden | (np.abs(share) <= 16 * _EPS * row)
        else:
            good &= ~still.all(axis=0)  # a column without effect may be a stair's tread
            J[here] = np.where(np.abs(T) <= err, 0.0, T) / s_j
            error[here] = np.where(still, 0.0, err) / s_j
            self.inexact[here] = ~still
        for a in np.flatnonzero(~good.all(axis=(0, 2))):
            bad = np.flatnonzero(~good[:, a].all(axis=0))
            for part in np.array_split(points[bad], -(-bad.size // 256)):
                self._search(J, error, int(cols[a]), part, known)

    def _drop_residue(self, J: np.ndarray, here: tuple[np.ndarray, ...], rate: np.ndarray) -> None:
        """Put zeros for what the step leaves of a zero slope, as of x^3 at 0, in place."""
        _, cols, points = (index.ravel() for index in here)
        suspect = (J[here] != 0) & ~(np.abs(J[here]) > 1e-18 * rate)
        if suspect.any():
            z, s = self.z[:, points], self.s[:, points]
            again = complex_step(self.f, z, s, self.columns[cols], _COMPLEX_STEP * 1e-10)
            if again is not None:
                steady = np.abs(again - J[here]) <= 1e-3 * np.abs(J[here])
                J[here] = np.where(suspect & ~steady, 0.0, J[here])

    def _search(
        self, J: np.ndarray, error: np.ndarray, a: int, points: np.ndarray, known: bool
    ) -> None:
        """Find column a of J at points where the first differences did not settle, in place."""
        j = int(self.columns[a])
        z, s = self.z[:, points], self.s[j, points]

        def along(steps: np.ndarray, which: np.ndarray) -> np.ndarray:
            """Return f at z + steps e_j of some points: (Q, P) to (n, Q, P)."""
            shifted = np.repeat(z[:, None, which], len(steps), axis=1)
            shifted[j] += steps
            return self.f(shifted.reshape(len(z), -1)).reshape(-1, *steps.shape).astype(float)

        exact = J[:, a, points] if known else None
        ladder = descend(along, self.f0[:, points], z[j], s, exact, self.eps)
        self._refuse(ladder, j)
        value, err = ladder.value, ladder.error
        if exact is None:
            J[:, a, points] = np.where(np.abs(value) <= err, 0.0, value)
            error[:, a, points] = np.where(ladder.still, 0.0, err)
            return
        agree = np.abs(exact - value) <= 3 * err
        trusted = err <= _TRUSTED * np.abs(exact)
        # Where noise hides the slope, the complex step stands, with what is known of it.
        kept = np.where(np.abs(exact) <= ladder.residue, 0.0, exact)
        doubt = np.where(trusted | ladder.still | (kept != exact), 0.0, np.abs(exact - value) + err)
        J[:, a, points] = np.where(agree, kept, value)
        error[:, a, points] = np.where(agree, doubt, np.maximum(err, _EPS * np.abs(value)))
        row = np.abs(J[:, :, points] * self.s[self.columns][:, points]).max(axis=1)
        self.inexact[:, a, points] = ~agree | (doubt * s > _TRUSTED * row)

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
