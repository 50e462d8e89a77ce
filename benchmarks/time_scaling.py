"""Time scaling beside raw TOPP-RA: limits kept, distance to the optimum, time.

    python benchmarks/time_scaling.py              120 random paths of its own
    python benchmarks/time_scaling.py CASES.json   the paths of a file

A file holds a list of cases: name, path ("cubic_spline", "cubic_hermite", "linear"), waypoints
(N, dof), ss (N,) or null, bc_type, dwaypoints, vlim and alim (dof, 2), sd_start, sd_end and T_ref,
the optimal duration or null. Limits are verified by code that shares nothing with the library:
roots of derivatives in every interval, and 200,000 instants. Times are CPU times. Raw TOPP-RA knows
no corners: on a polyline its short durations and huge violations come from driving through them.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import multiprocessing
import time
import tracemalloc
import warnings
from collections.abc import Callable
from pathlib import Path as File
from typing import Any

import numpy as np
from scipy.interpolate import PPoly
from time_scaling_cases import (
    curve_of,
    knots_of,
    other_units,
    part_of,
    random_cases,
    strange_path,
)
from time_scaling_verify import SAMPLES, dense_violation, sampled_violation, verify

import statebook as sb

REPEATS = 3
PATIENCE = 200  # seconds for one strange path
JOINTS = (1, 3, 7, 15, 30)
RAW_GRIDS = (None, 100, 1000)
HEADER = (
    f"{'case':26}{'dof':>4}{'violation':>11}{'gap %':>9}{'claimed':>9}{'ms':>8}{'units':>9}"
    + "".join(f" | {name:>9}{'gap %':>9}{'ms':>7}" for name in ("raw auto", "raw 100", "raw 1000"))
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
    """Refine until the duration stops changing, or the work is too much."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # as near as it comes
        return scale(case, curve, 1e-5).duration


def pendulum(load: float) -> str:
    """Drive a pendulum up under a torque limit; beyond its static load momentum is needed."""
    heavy = 1.3 * 0.7 * 9.81

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return 1.3 * 0.7**2 * qdd + heavy * np.cos(q)

    path = sb.Path.through([[-np.pi / 2, np.pi / 2]])
    timed = sb.time_scale(path, torque=heavy / load, inverse_dynamics=dynamics)
    t = np.linspace(0, timed.duration, SAMPLES)
    used = dynamics(timed.position(t), timed.velocity(t), timed.acceleration(t))
    return f"{timed.duration:.4f} s, violation {np.abs(used).max() / (heavy / load) - 1:.1e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="?", help="file of cases; random paths without it")
    parser.add_argument("--count", type=int, default=120, help="number of random paths")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--fuzz", type=int, default=0, help="number of strange paths instead")
    parser.add_argument("--growth", action="store_true", help="growth with the size instead")
    arguments = parser.parse_args()
    if arguments.fuzz or arguments.growth:
        warnings.simplefilter("ignore")
        if arguments.growth:
            growth()
        return fuzz(arguments.fuzz, arguments.seed)
    warnings.simplefilter("error")
    logging.disable(logging.CRITICAL)
    if arguments.cases:
        cases = json.loads(File(arguments.cases).read_text())
    else:
        cases = random_cases(arguments.count, arguments.seed)
    for load in (0.5, 0.98, 1.11):
        print(f"pendulum, static load {load:.0%} of the torque limit: {pendulum(load)}")
    print(HEADER)
    rows = [row for case in cases if (row := compare(case)) is not None]
    return summarize(np.array(rows), len(cases))


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

    change = max(
        abs(scale(other, curve_of(other)).duration / (factor * timed.duration) - 1)
        for other, factor in other_units(case)
    )
    row = [verify(timed, curve, case), gap(timed.duration), elapsed, change, 100 * timed.gap]
    line = f"{case['name'][:25]:26}{curve.c.shape[2]:4}{row[0]:11.1e}{row[1]:9.4f}{row[4]:9.4f}"
    line += f"{row[2]:8.1f}"
    line += f"{change:9.0e}"
    for grid in RAW_GRIDS:
        elapsed, duration, violation = run_raw(case, curve, grid)
        row += [violation, gap(duration), elapsed]
        line += f" | {violation:9.1e}{gap(duration):9.3f}{elapsed:7.1f}"
    print(line, flush=True)
    return row


def summarize(rows: np.ndarray, count: int) -> None:
    """Print the criteria: limits kept, nearness to the optimum, time."""
    violation, gap, elapsed, change, claimed = rows[:, :5].T
    print(f"\nsolved {len(rows)} of {count}; largest violation {violation.max():.1e}")
    print(f"largest change of the duration in other units: {change.max():.1e}")
    shares = [f"{(gap <= g).mean():.1%} within {g:g} %" for g in (0.1, 0.5, 1.0)]
    print(
        f"claimed gap: median {np.median(claimed):.4f} %, largest {claimed.max():.4f} %; ", end=""
    )
    print(f"largest gap above the claimed one: {(gap - claimed).max():.1e} %")
    print(
        f"gap: median {np.median(gap):.4f} %, 95 % {np.quantile(gap, 0.95):.4f} %, "
        f"largest {gap.max():.4f} %, smallest ",
        end="",
    )
    print(f"{gap.min():.1e} %; {', '.join(shares)}")
    for i, grid in enumerate(RAW_GRIDS):
        raw = rows[:, 3 * i + 5 : 3 * i + 8]
        found = np.isfinite(raw[:, 0])
        print(
            f"raw toppra, {'automatic grid' if grid is None else f'{grid} intervals'}: "
            f"solved {found.sum()}, violation median {np.median(raw[found, 0]):.1%}, largest "
            f"{raw[found, 0].max():.1%}, gap median {np.median(raw[found, 1]):.3f} %"
        )
    for name, column in (("automatic grid", 7), ("1000 intervals", 13)):
        raw = rows[:, column]
        ran = np.isfinite(raw)
        print(
            f"time: median {np.median(elapsed):.1f} ms; raw with {name} "
            f"{np.median(raw[ran]):.1f} ms: ratio of medians "
            f"{np.median(elapsed) / np.median(raw[ran]):.2f}, median ratio "
            f"{np.median(elapsed[ran] / raw[ran]):.2f}"
        )


def try_strange(seed: int) -> tuple[str, float, float, float, bool]:
    """Time a strange path: its name, a violation, the library's own audit, seconds, warned."""
    name, path, given = strange_path(seed)
    begin = time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ends, factor = given.pop("ends", None), given.pop("duration", None)
        timed = sb.time_scale(path, **given)
        if ends is not None and timed.duration > 0:  # a part of it, at the speeds it has there
            s, speed, _ = timed.progress(ends * timed.duration)
            given |= {"start_speed": speed[0], "end_speed": speed[1]}
            path = part_of(path, *s)
            timed = sb.time_scale(path, **given)
            kept = [timed.progress(t)[1] for t in (0.0, timed.duration)]
            assert np.allclose(kept, speed[:2], rtol=1e-6, atol=0.0), f"ends {kept}"
        if factor is not None:
            given["duration"] = factor * timed.duration
            timed = sb.time_scale(path, **given)
            assert math.isclose(timed.duration, given["duration"], rel_tol=1e-9), "duration"
    seconds = time.process_time() - begin
    missed = any("tolerance" in str(one.message) for one in caught)
    assert timed.gap <= 1e-3 or missed or factor, f"gap {timed.gap} without a word"
    assert np.all(np.diff(timed.times) > 0), "times"
    audit = max(use.use for use in timed.audit()) - 1
    return name, sampled_violation(timed, given), audit, seconds, missed


def fuzz(count: int, seed: int) -> None:
    """Time strange paths; print crashes, violations, false refusals, and what takes long."""
    processes = multiprocessing.get_context("spawn")
    pool = processes.Pool(1)
    failures, warned, worst, audited, slowest = 0, 0, -math.inf, -math.inf, (0.0, "")
    for number in range(seed, seed + count):
        try:
            work = pool.apply_async(try_strange, (number,))
            name, violation, audit, seconds, missed = work.get(PATIENCE)
            if violation > 1e-9 or audit > 1e-9:
                raise ValueError(f"{name} exceeds a limit by {violation:.2g} ({audit:.2g})")
        except Exception as error:  # whatever it is, it is a failure: all are feasible
            failures += 1
            what = f"{strange_path(number)[0]}: {type(error).__name__}: {error}"
            print(f"{number} {what}", flush=True)
            if isinstance(error, multiprocessing.TimeoutError):
                pool.terminate()
                pool = processes.Pool(1)
            continue
        worst, audited = max(worst, violation), max(audited, audit)
        slowest = max(slowest, (seconds, f"{number} {name}"))
        warned += missed
    pool.terminate()
    print(
        f"{count} strange paths from {seed}: {failures} failures, largest violation {worst:.1e}, "
        f"by the library's audit {audited:.1e}; {warned} warnings of a tolerance; slowest "
        f"{slowest[0]:.1f} s, {slowest[1]}",
        flush=True,
    )


def growth() -> None:
    """Print time, memory and gap over numbers of waypoints and of joints, beside raw TOPP-RA."""
    sizes = [(6, 10), (6, 100), (6, 1000), *((n, 20) for n in JOINTS), (30, 1000), (6, 10_000)]
    for joints, points in sizes:
        waypoints = np.random.default_rng(0).normal(size=(joints, points))
        path = sb.Path.through(waypoints)
        begin = time.process_time()
        timed = sb.time_scale(path, 1.0, 1.0)
        elapsed = time.process_time() - begin
        bound = np.tile([-1.0, 1.0], (joints, 1))
        case = {"path": "given", "vlim": bound, "alim": bound, "sd_start": 0.0, "sd_end": 0.0}
        raw, found, _ = run_raw(case, path.curve, 1000)
        print(
            f"{joints} joints, {points} waypoints: {elapsed:.2f} s, gap {timed.gap:.1e}; raw with "
            f"1000 intervals {raw / 1e3:.3f} s ({'solved' if found > 0 else 'not solved'})",
            flush=True,
        )
        tracemalloc.start()
        sb.time_scale(path, 1.0, 1.0)
        print(f"    at most {tracemalloc.get_traced_memory()[1] / 1e6:.0f} MB", flush=True)
        tracemalloc.stop()


if __name__ == "__main__":
    main()
