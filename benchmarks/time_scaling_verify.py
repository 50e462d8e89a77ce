"""Checks of a timed path that share no code with the library."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyroots, polyval
from scipy.interpolate import PPoly

import statebook as sb

SAMPLES = 200_000


def excess(values: np.ndarray, bounds: np.ndarray) -> float:
    """Return the largest relative violation of (dof, 2) bounds by values (dof, M)."""
    return float(np.maximum(values / bounds[:, 1:], values / bounds[:, :1]).max() - 1)


def exact_violation(timed: sb.TimedPath, curve: PPoly, v: np.ndarray, a: np.ndarray) -> float:
    """Evaluate velocity and acceleration at their extrema: the roots of their derivatives.

    Between gridpoints s'' is linear and s'^2 quadratic in s, found again from two points and
    tried on others; so q'' and q'^2 are polynomials of s, and q' is extreme where q'' vanishes.
    """
    t0, t1 = timed.times[:-1], timed.times[1:]
    # From three instants inside each interval: at its ends s' may jump.
    (s, sdot, first), (sm, vm, _), (se, ve, last) = (
        timed.progress(t0 + part * (t1 - t0)) for part in (0.1, 0.5, 0.9)
    )
    knot = np.searchsorted(curve.x, sm, side="right") - 1
    start, end = timed.s[:-1], timed.s[1:]
    use = (se > s) & (t1 > t0)
    s0 = np.maximum(start, curve.x[np.clip(knot, 0, len(curve.x) - 2)])[use]
    h = np.minimum(end, curve.x[np.clip(knot + 1, 1, len(curve.x) - 1)])[use] - s0
    s, sdot, first, sm, vm, se, ve, last = (y[use] for y in (s, sdot, first, sm, vm, se, ve, last))
    slant = (last - first) / (se - s)  # s'' is linear in s
    rate = first + slant * (s0 - s)
    u = [rate, slant * h]  # powers of z = (s - s0) / h
    square = sdot**2 - 2 * rate * (s - s0) - slant * (s - s0) ** 2
    x = [np.maximum(square, 0.0), 2 * h * rate, slant * h**2]
    size = np.maximum(np.maximum(sdot, vm), ve) ** 2
    for place, speed in ((sm, vm), (se, ve)):
        z = (place - s0) / h
        assert np.all(np.abs(x[0] + z * (x[1] + z * x[2]) - speed**2) < 1e-7 * size)
    slope = [curve(s0, k + 1).T * h ** (k + 1) / math.factorial(k) for k in range(len(curve.c) - 1)]
    acceleration = [m / h**2 for m in product(derivative(slope), x)]
    for k, m in enumerate(product(slope, u)):
        if k == len(acceleration):
            acceleration.append(np.zeros_like(m))
        acceleration[k] = acceleration[k] + m / h
    square = [m / h**2 for m in product(product(slope, slope), x)]
    worst = -1.0
    for j in range(len(v)):
        q1, q2 = (np.array([m[j] for m in p]) for p in (slope, acceleration))
        near = np.abs(q2).sum(axis=0) > 0.999 * np.abs(a[j]).min()
        for n in np.flatnonzero(near):
            values = polyval(extrema(np.array(derivative(list(q2[:, n])))), q2[:, n])
            worst = max(worst, (values / a[j, 1]).max() - 1, (values / a[j, 0]).max() - 1)
        bound = sum(np.abs(m[j]) for m in square)
        for n in np.flatnonzero(bound > 0.999 * np.abs(v[j]).min() ** 2):
            z = extrema(q2[:, n])
            speed = np.sqrt(np.maximum(polyval(z, [m[n] for m in x]), 0))
            values = polyval(z, q1[:, n]) * speed / h[n]
            worst = max(worst, (values / v[j, 1]).max() - 1, (values / v[j, 0]).max() - 1)
    return float(worst)


def product(p: list, q: list) -> list:
    """Multiply polynomials given by lists of coefficients, lowest power first."""
    result = [0.0] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for k, b in enumerate(q):
            result[i + k] = result[i + k] + a * b
    return result


def derivative(p: list) -> list:
    """Differentiate a polynomial."""
    return [k * c for k, c in enumerate(p)][1:] or [0.0 * p[0]]


def extrema(p: np.ndarray) -> np.ndarray:
    """Return the real roots of a derivative within [0, 1], and both ends."""
    kept = np.flatnonzero(np.abs(p) > 1e-15 * np.abs(p).max())
    found = polyroots(p[: kept[-1] + 1]) if len(kept) and kept[-1] > 0 else np.zeros(0)
    real = found.real[np.abs(found.imag) < 1e-6]
    return np.concatenate([[0.0, 1.0], real[(real > 0) & (real < 1)]])


def dense_violation(motion: Any, duration: float, v: np.ndarray, a: np.ndarray) -> float:
    """Sample velocity and acceleration of a motion, (velocity, acceleration) functions of t."""
    t = np.linspace(0, duration, SAMPLES)
    velocity, acceleration = motion
    return max(excess(velocity(t), v), excess(acceleration(t), a))


def verify(timed: sb.TimedPath, curve: PPoly, case: dict[str, Any]) -> float:
    """Return the largest violation, after checking that the motion is one along the path."""
    v, a = np.array(case["vlim"], float), np.array(case["alim"], float)
    size = np.abs(curve(np.linspace(curve.x[0], curve.x[-1], 99))).max()
    ends = timed.position(0.0), timed.position(timed.duration)
    assert np.array_equal(ends[0], curve(curve.x[0]))
    assert np.abs(ends[1] - curve(curve.x[-1])).max() <= 1e-12 * size
    if timed.duration == 0:
        return -1.0
    t = np.linspace(0, timed.duration, SAMPLES)
    position, velocity = timed.position(t), timed.velocity(t)
    s, _, _ = timed.progress(t)
    assert np.abs(position - curve(s).T).max() <= 1e-9 * size, "it leaves the path"
    assert np.all(np.diff(s) >= 0)
    # Mean velocity and acceleration between instants cannot exceed the limits either.
    step = t[1]
    mean = np.diff(velocity) / step
    rounding = 1e-15 * np.abs(velocity).max(axis=1) / step / np.abs(a).min(axis=1)
    mean_use = np.maximum(mean / a[:, 1:], mean / a[:, :1]).max(axis=1)
    moved = np.abs(np.diff(position) - (velocity[:, 1:] + velocity[:, :-1]) * step / 2)
    curved = np.abs(a).max(axis=1, keepdims=True) * step**2
    assert np.all(moved <= curved + 1e-15 * size), "velocity is not the derivative of position"
    motion = timed.velocity, timed.acceleration
    return max(
        float((mean_use - rounding).max() - 1),
        dense_violation(motion, timed.duration, v, a),
        exact_violation(timed, curve, v, a),
    )


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_RATES = ("velocity", "acceleration", "jerk")


def sampled_violation(timed: sb.TimedPath, given: dict[str, Any]) -> float:
    """Return the largest violation of the arguments of `time_scale` at very many instants.

    In every interval of the motion the integral of each derivative is compared with the change of
    what it is the derivative of, so that a wrong one is no excuse.
    """
    pauses = given.get("dwell", {})
    rests = [timed.arrival_times[i] + pause for i, pause in pauses.items()]
    t = np.unique([*timed.times, *np.linspace(0, timed.duration, 2000), *rests])
    steps = np.diff(t)
    within = (t[:-1] + np.multiply.outer((1 + _NODES) / 2, steps)).ravel()
    lower = timed.position(t)
    size = np.abs(lower).max()
    inside: dict[str, np.ndarray] = {}
    for name in _RATES[: 2 + ("jerk" in given)]:
        inside[name] = getattr(timed, name)(within)
        every = inside[name].reshape(timed.path.dof, len(_NODES), -1)
        moved = np.einsum("k,jkn->jn", _WEIGHTS / 2, every) * steps
        largest = np.abs(every).max(axis=(1, 2))[:, None]
        off = np.abs(np.diff(lower) - moved)
        rounding = 1e-9 * size + 1e-14 * timed.duration * largest
        assert np.all(off <= rounding), f"{name} is no derivative: {(off / rounding).max():.2g}"
        lower, size = getattr(timed, name)(t), largest
    s, _, _ = timed.progress(within)
    position = timed.position(within)
    reach = 1e-9 * np.abs(position).max()
    assert np.abs(position - timed.path(s)).max() <= reach, "it leaves the path"
    assert np.all(np.diff(timed.progress(t)[0]) >= -1e-15 * np.abs(s).max()), "it goes back"
    knots = timed.path.waypoint_s
    changes = {"velocity": inside["acceleration"], "acceleration": timed.jerk(within), "jerk": 0.0}
    worst = -1.0
    for name in _RATES:
        bound = np.asarray(given.get(name, np.inf))
        if bound.ndim == 3:  # between points that are one to rounding they change by any factor
            near = s + 1e-15 * np.abs(knots).max() * np.arange(-1, 2)[:, None]
            bound = np.array([[np.interp(near, knots, side) for side in row] for row in bound])
            low, high = bound[:, 0].min(axis=1), bound[:, 1].max(axis=1)
        elif bound.ndim == 2:
            low, high = bound[:, :1], bound[:, 1:]
        else:
            continue
        # Time itself is rounded: at the next derivative times that the values change.
        blur = 2.3e-16 * timed.duration * np.abs(changes[name])
        values = inside[name]
        use = np.maximum((values + blur) / low, (values - blur) / high)
        worst = max(worst, float(use.max()) - 1)
    for name, of in (("speed", "velocity"), ("acceleration_norm", "acceleration")):
        if name in given:
            norm = np.linalg.norm(inside[of], axis=0)
            worst = max(worst, float(norm.max() / given[name]) - 1)
    if "torque" in given:
        motion = [position, *(inside[name] for name in _RATES[:2]), timed.jerk(within)]
        blur = 2.3e-16 * timed.duration * np.array([-1.0, 0.0, 1.0])
        shifted = [[q + rate * dt for q, rate in pairwise(motion)] for dt in blur]
        torques = np.min([np.abs(given["inverse_dynamics"](*values)) for values in shifted], axis=0)
        worst = max(worst, float((torques.max(axis=1) / given["torque"]).max()) - 1)
    return worst
