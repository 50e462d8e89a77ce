"""A caller's inverse dynamics: its shape found out, its form checked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import scipy

from statebook.probes import takes_batches
from statebook.timescale.bounds import read_bounds
from statebook.timescale.curves import fit
from statebook.timescale.friction import DRAG_LOSS, friction_form, reversals
from statebook.timescale.limits import TorqueLimit, blocked
from statebook.timescale.path import Path
from statebook.timescale.pieces import apart

_SAMPLES = 5
_CALLS = 8  # at one place, which show whether the function repeats itself
_FORM = 1e-7  # part of the motion's torques by which the form may be missed
_DEGREE = 7  # in s, of the polynomials that stand for the torques
_FIT = 1e-7  # part of their largest value, or of the bounds, by which they may be missed
_NOISE = 1e-4  # part of the bounds that the function's noise may reach
_JUMP = 1e-2  # part of the bounds that is left beside a jump
_LARGEST_MARGIN = 2e-3  # part of the bounds that may be left to errors
_CELLS = 16  # pieces of the path, at least, in which torques are looked at
_PROBES = np.array([0.0371, 0.2113, 0.3719, 0.5471, 0.6817, 0.8353, 0.9581])  # in each of these
_ROUNDS = 12
_SAFETY = 2.0  # on the errors that were seen


def torque_limit(path: Path, torque: Any, inverse_dynamics: Any) -> TorqueLimit:
    """Check an inverse dynamics along a path and make a limit of it.

    Parameters
    ----------
    path : Path
    torque : number or array, shape (rows,) or (rows, 2)
        Bounds; an infinite one is none, and they need not enclose 0.
    inverse_dynamics : callable
        (q, qd, qdd) -> (rows,), and (rows, N) for a batch if it can.

    Raises
    ------
    TypeError, ValueError
        It is no function of this kind: not affine in qdd, not quadratic in qd, not finite.
    """
    if not callable(inverse_dynamics):
        raise TypeError(
            "inverse_dynamics must be a function (q, qd, qdd) -> torques where torque is given, "
            f"got {inverse_dynamics!r}"
        )
    s = np.linspace(path.s_start, path.s_end, _SAMPLES + 2)[1:-1]
    q, slope = path(s), path(s, 1)
    rows, noise = _rows(inverse_dynamics, q)
    dynamics = _vectorized(inverse_dynamics, q, slope, rows, noise)
    given = read_bounds("torque", torque, rows, path, around_zero=False)
    _check_form(dynamics, q, slope, noise)
    friction = friction_form(dynamics, q, slope, noise)
    lower, upper, along, loss = given
    loss += DRAG_LOSS if friction[1] else 0.0
    bounds = TorqueLimit("torque", lower, upper, dynamics, None, friction, along=along, loss=loss)
    return fitted_torques(bounds, path, _FIT)


def fitted_torques(limit: TorqueLimit, path: Path, tolerance: float) -> TorqueLimit:
    """Return the limit with polynomials in s for its torques, and room for their error.

    Between the nodes of the polynomials the torques of one motion are looked at beside them; where
    they miss, the pieces are made shorter.

    Raises
    ------
    InfeasiblePathError
        A torque jumps along the path, or changes too fast.
    ValueError
        The function is noise.
    """
    assert limit.dynamics is not None
    forms = _Forms(limit, path)
    knots, even = path.curve.x, np.linspace(path.s_start, path.s_end, _CELLS + 1)
    turns = reversals(path)  # friction jumps there, or bends
    cells = np.sort(np.concatenate([knots, apart(np.concatenate([even, turns]), knots)]))
    for _ in range(_ROUNDS):
        found = fit(forms, cells, _DEGREE, tolerance, (0,), stall=_NOISE, floor=1.0)
        knots = found.curve.x
        error = found.error[0].reshape(len(knots) - 1, 5, -1).sum(axis=1)
        ends = np.stack([cells[:-1], cells[1:]])
        probes = (ends[0] + np.multiply.outer(_PROBES, ends[1] - ends[0])).ravel()
        near = found.curve(probes).reshape(len(probes), 5, -1).sum(axis=1)
        missed = np.abs(near - forms.sum(probes))
        piece = np.clip(np.searchsorted(knots, probes, side="right") - 1, 0, len(knots) - 2)
        unforeseen = (missed > 10 * tolerance + _SAFETY * error[piece]).any(axis=1)
        np.maximum.at(error, piece, missed)
        worst = int(error.max(axis=1).argmax())
        width = knots[worst + 1] - knots[worst]
        if error.max() > _JUMP and width < 1e-5 * (knots[-1] - knots[0]):
            row = int(error[worst].argmax())
            why = "jumps there, or changes too fast; make it smooth, or time the path in two parts"
            raise blocked(f"torque of row {row}", float(knots[worst]), why)
        bad = np.unique(piece[unforeseen])
        if not len(bad):
            break
        middle = (knots[bad] + knots[bad + 1]) / 2
        cells = np.unique(np.concatenate([cells, knots[bad], knots[bad + 1], middle]))
    margin = _SAFETY * float(error.max())
    if margin > _LARGEST_MARGIN:
        raise ValueError(
            "inverse_dynamics must be smooth along the path: polynomials miss its torques by "
            f"{error.max():.2g} of their bounds everywhere, which is noise; smooth them first"
        )
    return replace(limit, fitted=forms.unscaled(found.curve), margin=margin)


class _Forms:
    """The terms of the torques along a path, in parts of the bounds, as functions of s.

    At s'' = rate and s' = speed, values of about the largest motion in a piece of the path, they
    are a s'', b s'^2, c, k and d s', five groups of columns (M, 5 R).
    """

    def __init__(self, limit: TorqueLimit, path: Path) -> None:
        assert limit.dynamics is not None
        self.dynamics, self.path, self.scale = limit.dynamics, path, limit.scale
        self.dry, self.viscous = limit.friction
        self.knots = path.curve.x
        widths = np.diff(self.knots)
        s = (self.knots[:-1] + np.multiply.outer(_PROBES, widths)).ravel()
        slope, bend = (
            np.abs(path(s, k)).max(axis=0).reshape(-1, len(widths)).max(axis=0) for k in (1, 2)
        )
        slope = np.where(slope > 0, slope, slope.max())
        turn = np.maximum(bend, slope**2 / np.dot(slope, widths))
        few = path.s_start + (path.s_end - path.s_start) * np.linspace(0.05, 0.95, _SAMPLES)
        self.rate, self.speed = 1 / slope, 1 / np.sqrt(turn)
        parts = np.abs(self(few)).reshape(_SAMPLES, 5, -1).max(axis=2)
        inertia = max(float(np.median(parts[:, 0])), 1e-300)
        self.rate = self.rate / inertia
        self.speed = self.speed / np.sqrt(max(inertia, parts[:, 1].max()))

    def _piece(self, s: np.ndarray) -> np.ndarray:
        """Return the pieces of the path that hold s (M,)."""
        return np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, len(self.knots) - 2)

    def _torques(self, s: np.ndarray, speed: float, rate: float) -> np.ndarray:
        """Return the torques in parts of the bounds, (M, R), at parts of the largest motion."""
        slope, piece = self.path(s, 1), self._piece(s)
        speeds = speed * self.speed[piece]
        qdd = slope * (rate * self.rate[piece]) + self.path(s, 2) * speeds**2
        return np.asarray(self.dynamics(self.path(s), slope * speeds, qdd).T / self.scale)

    def __call__(self, s: np.ndarray) -> np.ndarray:
        c = self._torques(s, 0.0, 0.0)
        a = self._torques(s, 0.0, 1.0) - c
        k = d = np.zeros_like(c)
        b = self._torques(s, 1.0, 0.0) - c
        if self.dry or self.viscous:  # moving(n) = k + n d speed + n^2 b speed^2
            one, two = b, self._torques(s, 2.0, 0.0) - c
            half = self._torques(s, 0.5, 0.0) - c if self.viscous else one
            b = (two - 3 * one + 2 * half) / 1.5 if self.viscous else (two - one) / 3
            d = two - one - 3 * b if self.viscous else d
            k = one - d - b if self.dry else k
        return np.concatenate([a, b, c, k, d], axis=1)

    def sum(self, s: np.ndarray) -> np.ndarray:
        """Return the torques with all terms at once, (M, R)."""
        return self._torques(s, 1.0, 1.0)

    def unscaled(self, curve: Any) -> Any:
        """Return a fitted curve with columns in the units of a, b, c, k and d."""
        piece = self._piece((curve.x[1:] + curve.x[:-1]) / 2)
        one, rate, speed = np.ones(len(piece)), 1 / self.rate[piece], 1 / self.speed[piece]
        units = np.stack([rate, speed**2, one, one, speed], axis=1)
        columns = (units[:, :, None] * self.scale).reshape(len(piece), -1)
        return scipy.interpolate.PPoly(curve.c * columns, curve.x)


def _rows(function: Callable[..., Any], q: np.ndarray) -> tuple[int, float]:
    """Return the number of rows of the function's values, and their relative noise."""
    still = np.zeros_like(q[:, 0])
    args = q[:, 0], still, still
    values = [
        np.array(function(*(a.copy() for a in args)), ndmin=int(len(q) == 1)) for _ in range(_CALLS)
    ]
    value, *_ = values
    if value.ndim != 1 or value.dtype.kind not in "iuf":
        raise ValueError(
            "inverse_dynamics must return a real vector (rows,) for q, qd, qdd of shape (dof,); "
            f"got shape {value.shape} of {value.dtype}"
        )
    size = max(float(np.abs(value).max(initial=0.0)), 1e-300)
    noise = float(np.ptp(values, axis=0).max(initial=0.0)) / size
    if noise > _JUMP:
        raise ValueError(
            "inverse_dynamics must depend on its arguments alone: calls at the same q, at rest, "
            f"differ by {noise:.2g} of the torque, which is noise; smooth it first"
        )
    rounding = np.finfo(value.dtype).eps if value.dtype.kind == "f" else 0.0
    return len(value), max(3 * noise, float(rounding))


def _vectorized(
    function: Callable[..., Any], q: np.ndarray, slope: np.ndarray, rows: int, noise: float
) -> Callable[..., Any]:
    """Return the function for batches: itself if its batches agree with its single values."""

    rtol = max(1e-9, 10 * noise)
    batched = takes_batches(function, q, slope, slope[::-1], alone=function, rtol=rtol)

    def torques(*motion: np.ndarray) -> np.ndarray:
        if batched:
            values = np.array(function(*motion), dtype=float)
        else:  # Copied at once: it may be the function's own buffer.
            columns = zip(*(part.T for part in motion), strict=True)
            values = np.array([np.array(function(*c), dtype=float) for c in columns]).T
        values = values.reshape(rows, motion[0].shape[1])
        bad = ~np.isfinite(values).all(axis=0)
        if bad.any():
            at = motion[0][:, int(np.argmax(bad))]
            raise ValueError(
                f"inverse_dynamics must return finite torques; it does not at q = {at}"
            )
        return values

    return torques


def _check_form(
    dynamics: Callable[..., Any], q: np.ndarray, slope: np.ndarray, noise: float
) -> None:
    """Refuse what is not affine in qdd with a matrix free of qd."""
    size = np.abs(q).max() + np.abs(slope).max()
    still = np.zeros_like(q)
    static = dynamics(q, still, still)
    rounding = max(1e-12, 10 * noise) * np.abs(static).max() + 1e-300
    direction = slope / max(np.abs(slope).max(), 1e-300) + 0.1 * np.cos(np.arange(q.size)).reshape(
        q.shape
    )
    for scale in size * np.array([1e-3, 1.0, 1e3]):
        v = scale * direction
        forward = dynamics(q, v, still) - static
        once, both = dynamics(q, still, v) - static, dynamics(q, v, v) - static
        twice = dynamics(q, still, 2 * v) - static
        tolerance = max(_FORM, 10 * noise) * (np.abs(once).max() + np.abs(forward).max()) + rounding
        if max(np.abs(twice - 2 * once).max(), np.abs(both - once - forward).max()) > tolerance:
            raise ValueError("inverse_dynamics must be affine in qdd, with a matrix free of qd")
