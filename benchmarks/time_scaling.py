"""Time scaling beside raw TOPP-RA: limits kept, distance to the optimum, time.

    python benchmarks/time_scaling.py              120 random paths of its own
    python benchmarks/time_scaling.py CASES.json   the paths of a file

A file holds a list of cases: name, path ("cubic_spline", "cubic_hermite", "linear"), waypoints
(N, dof), ss (N,) or null, bc_type, dwaypoints, vlim and alim (dof, 2), sd_start, sd_end and T_ref,
the optimal duration or null. Limits are verified here, by code that shares nothing with the
library: roots of derivatives in every interval, and 200,000 instants.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import time
import warnings
from collections.abc import Callable
from pathlib import Path as File
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyroots, polyval
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PPoly

import statebook as sb

SAMPLES = 200_000
REPEATS = 3
RAW_GRIDS = (None, 100, 1000)
HEADER = f"{'case':26}{'dof':>4}{'violation':>11}{'gap %':>9}{'ms':>8}" + "".join(
    f" | {name:>9}{'gap %':>9}{'ms':>7}" for name in ("raw auto", "raw 100", "raw 1000")
)


def curve_of(case: dict[str, Any]) -> PPoly:
    """Build the path of a case, from SciPy alone."""
    points = np.array(case["waypoints"], dtype=float)
    s = knots_of(case)
    if case["path"] == "linear" or (len(points) == 2 and case.get("bc_type") == "not-a-knot"):
        slopes = np.diff(points, axis=0) / np.diff(s)[:, None]
        return PPoly(np.stack([slopes, points[:-1]]), s)
    if case["path"] == "cubic_hermite":
        spline = CubicHermiteSpline(s, points, np.array(case["dwaypoints"], dtype=float))
    else:
        spline = CubicSpline(s, points, bc_type=case.get("bc_type") or "not-a-knot")
    return PPoly(spline.c, spline.x)


def knots_of(case: dict[str, Any]) -> np.ndarray:
    """Return s at the waypoints, by default uniform on [0, 1]."""
    ss = case.get("ss")
    return np.linspace(0, 1, len(case["waypoints"])) if ss is None else np.array(ss, dtype=float)


def random_cases(count: int, seed: int) -> list[dict[str, Any]]:
    """Draw paths of 1-7 joints over seven orders of magnitude in size, speed and s."""
    rng = np.random.default_rng(seed)
    cases = []
    for i in range(count):
        dof, points = i % 7 + 1, int(rng.integers(2, 13))
        size, rate = 10 ** rng.uniform(-4, 3), 10 ** rng.uniform(-2, 2)
        waypoints = size * rng.normal(size=(points, dof))
        s = np.cumsum(rng.uniform(0.3, 1.0, points)) * 10 ** rng.uniform(-3, 3)
        upper = rng.uniform(0.5, 2.0, (2, dof))
        lower = -upper if i % 3 else -rng.uniform(0.5, 2.0, (2, dof))
        v, a = size * rate * 10 ** rng.uniform(-1, 2), size * rate**2
        kind = ("cubic_spline", "cubic_spline", "cubic_spline", "cubic_hermite", "linear")[i % 5]
        cases.append(
            {
                "name": f"random {i}",
                "path": kind,
                "waypoints": waypoints,
                "dwaypoints": rng.normal(size=(points, dof)) * size / np.ptp(s) * points,
                "ss": s,
                "bc_type": ("not-a-knot", "clamped", "natural")[i % 3],
                "vlim": v * np.stack([lower[0], upper[0]], axis=1),
                "alim": a * np.stack([lower[1], upper[1]], axis=1),
                "sd_start": 0.0,
                "sd_end": 0.0,
                "T_ref": None,
            }
        )
    return cases


def excess(values: np.ndarray, bounds: np.ndarray) -> float:
    """Return the largest relative violation of (dof, 2) bounds by values (dof, M)."""
    return float(np.maximum(values / bounds[:, 1:], values / bounds[:, :1]).max() - 1)


def exact_violation(timed: sb.TimedPath, curve: PPoly, v: np.ndarray, a: np.ndarray) -> float:
    """Evaluate velocity and acceleration at their extrema: the roots of their derivatives.

    Between gridpoints s'' is linear and s'^2 quadratic in s, found again from two points and
    tried on others; so q'' and q'^2 are polynomials of s, and q' is extreme where q'' vanishes.
    """
    t0, t1 = timed.times[:-1], timed.times[1:]
    use = t1 > t0
    t0, t1, h, s0 = t0[use], t1[use], np.diff(timed.s)[use], timed.s[:-1][use]
    x0, x1 = timed.sdot[:-1][use] ** 2, timed.sdot[1:][use] ** 2
    start, middle = timed.progress(t0)[2], (t0 + t1) / 2
    s, _, rate = timed.progress(middle)
    slant = (rate - start) / (s - s0)  # s'' is linear in s
    u = [start, slant * h]  # powers of z = (s - s0) / h
    x = [x0, 2 * h * start, slant * h**2]
    assert np.all(np.abs(x[0] + x[1] + x[2] - x1) < 1e-9 * np.maximum(x0, x1))
    s, speed, _ = timed.progress(t0 + 0.3 * (t1 - t0))
    z = (s - s0) / h
    assert np.all(np.abs(x[0] + z * (x[1] + z * x[2]) - speed**2) < 1e-9 * np.maximum(x0, x1))
    slope = [curve(s0, k + 1).T * h ** (k + 1) / math.factorial(k) for k in range(len(curve.c) - 1)]
    acceleration = [m / h**2 for m in product(derivative(slope), x)]
    for k, m in enumerate(product(slope, u)):
        if k == len(acceleration):
            acceleration.append(np.zeros_like(m))
        acceleration[k] = acceleration[k] + m / h
    square = [m / h**2 for m in product(product(slope, slope), x)]
    square = product(product(slope, slope), x)
    worst = -1.0
    for j in range(len(v)):
        q2, q1 = (
            np.array([np.broadcast_to(m[j], h.shape) for m in p]) for p in (acceleration, slope)
        )
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


def timed_run(function: Callable[[], Any]) -> tuple[float, Any]:
    """Return the best CPU time of a few runs in milliseconds, and the result."""
    best, result = math.inf, None
    for _ in range(REPEATS):
        start = time.process_time()
        result = function()
        best = min(best, 1e3 * (time.process_time() - start))
    return best, result


def run_raw(case: dict[str, Any], curve: PPoly, grid: int | None) -> tuple[float, float, float]:
    """Run TOPP-RA as it comes: time, duration and violation, NaN where it finds nothing."""
    from toppra import SplineInterpolator
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint
    from toppra.interpolator import AbstractGeometricPath

    class Curve(AbstractGeometricPath):
        dof = curve.c.shape[2]
        path_interval = curve.x[[0, -1]]

        def __init__(self) -> None:
            self.curves = [curve, curve.derivative(), curve.derivative(2)]

        def __call__(self, s: Any, order: int = 0) -> np.ndarray:
            return self.curves[order](s)

    v, a = np.array(case["vlim"], float), np.array(case["alim"], float)

    def run() -> Any:
        if case["path"] == "cubic_spline":
            points = np.array(case["waypoints"], float)
            path = SplineInterpolator(knots_of(case), points, case["bc_type"])
        else:
            path = Curve()
        gridpoints = None if grid is None else np.linspace(*path.path_interval, grid + 1)
        limits = [JointVelocityConstraint(v), JointAccelerationConstraint(a)]
        solver = TOPPRA(limits, path, gridpoints=gridpoints)
        return solver.compute_trajectory(case["sd_start"], case["sd_end"])

    try:
        elapsed, found = timed_run(run)
    except Exception:  # of whatever kind: it has no result then
        return math.nan, math.nan, math.nan
    if found is None:
        return elapsed, math.nan, math.nan
    motion = (lambda t: found(t, 1).T), (lambda t: found(t, 2).T)
    return elapsed, found.duration, dense_violation(motion, found.duration, v, a)


def scale(case: dict[str, Any], curve: PPoly, tolerance: float = 1e-3) -> sb.TimedPath:
    """Run the library on a case."""
    return sb.time_scale(
        sb.Path(curve),
        case["vlim"],
        case["alim"],
        start_speed=case["sd_start"],
        end_speed=case["sd_end"],
        tolerance=tolerance,
    )


def converged_duration(case: dict[str, Any], curve: PPoly) -> float:
    """Refine until the duration stops changing."""
    durations = [scale(case, curve, tolerance).duration for tolerance in (1e-4, 1e-5)]
    return durations[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="?", help="file of cases; random paths without it")
    parser.add_argument("--count", type=int, default=120, help="number of random paths")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    warnings.simplefilter("error")
    logging.disable(logging.CRITICAL)
    if arguments.cases:
        cases = json.loads(File(arguments.cases).read_text())
    else:
        cases = random_cases(arguments.count, arguments.seed)
    print(HEADER)
    rows = [row for case in cases if (row := compare(case)) is not None]
    summarize(np.array(rows), len(cases))


def compare(case: dict[str, Any]) -> list[float] | None:
    """Run one case and print its line: violation, gap in per cent, milliseconds."""
    curve = curve_of(case)
    try:
        elapsed, timed = timed_run(lambda: scale(case, curve))
    except ValueError as error:
        print(f"{case['name'][:25]:26}{error}")
        return None
    reference = case.get("T_ref") or converged_duration(case, curve)

    def gap(duration: float) -> float:
        return 100 * (duration / reference - 1) if reference else 0.0

    row = [verify(timed, curve, case), gap(timed.duration), elapsed]
    line = f"{case['name'][:25]:26}{curve.c.shape[2]:4}{row[0]:11.1e}{row[1]:9.4f}{row[2]:8.1f}"
    for grid in RAW_GRIDS:
        elapsed, duration, violation = run_raw(case, curve, grid)
        row += [violation, gap(duration), elapsed]
        line += f" | {violation:9.1e}{gap(duration):9.3f}{elapsed:7.1f}"
    print(line, flush=True)
    return row


def summarize(rows: np.ndarray, count: int) -> None:
    """Print the criteria: limits kept, nearness to the optimum, time."""
    violation, gap, elapsed = rows[:, :3].T
    print(f"\nsolved {len(rows)} of {count}; largest violation {violation.max():.1e}")
    shares = [f"{(gap <= g).mean():.1%} within {g:g} %" for g in (0.1, 0.5, 1.0)]
    print(f"gap: median {np.median(gap):.4f} %, largest {gap.max():.4f} %, smallest ", end="")
    print(f"{gap.min():.1e} %; {', '.join(shares)}")
    for i, grid in enumerate(RAW_GRIDS):
        raw = rows[:, 3 * i + 3 : 3 * i + 6]
        found = np.isfinite(raw[:, 0])
        print(
            f"raw toppra, {'automatic grid' if grid is None else f'{grid} intervals'}: "
            f"solved {found.sum()}, violation median {np.median(raw[found, 0]):.1%}, largest "
            f"{raw[found, 0].max():.1%}, gap median {np.median(raw[found, 1]):.3f} %"
        )
    raw = rows[:, 5]
    ran = np.isfinite(raw)
    print(
        f"time: median {np.median(elapsed):.1f} ms; raw with automatic grid "
        f"{np.median(raw[ran]):.1f} ms: ratio of medians "
        f"{np.median(elapsed) / np.median(raw[ran]):.2f}, median ratio "
        f"{np.median(elapsed[ran] / raw[ran]):.2f}"
    )


if __name__ == "__main__":
    main()
