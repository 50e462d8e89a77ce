"""The paths of the time-scaling benchmark: from a file, or drawn at random."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PPoly, make_interp_spline

import statebook as sb


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


KINDS = ("polyline", "repeats", "chord", "hermite", "degree", "straight", "blend")


def strange_path(seed: int) -> tuple[str, sb.Path, dict[str, Any]]:
    """Draw a path that is hard to time, and arguments of `time_scale`; a motion exists always.

    A tenth each has jerk limits, torque limits, limits per waypoint, speeds at its ends, pauses, a
    given duration (as a multiple of the shortest one), and limits on norms.
    """
    rng = np.random.default_rng(seed)
    kind, extra = KINDS[seed % 7], EXTRAS.get(seed % 10, "")
    calm = extra == "jerk"  # small, of less unlike sizes: beyond them its programs fail on rounding
    most = (4, 5) if calm else (8, 40)  # of joints and waypoints
    dof, count = int(rng.integers(1, most[0])), int(rng.integers(2, most[1]))
    points = rng.normal(size=(dof, count)) * 10 ** (rng.uniform(-3, 3) / (3 if calm else 1))
    if kind in ("repeats", "chord", "straight"):
        where = rng.integers(0, count, int(rng.integers(1, 4)))
        noise = 10 ** rng.uniform(-16, -6) * rng.normal(size=(dof, len(where)))
        points = np.insert(points, where, points[:, where] + noise * np.abs(points).max(), axis=1)
    if kind == "straight":
        points = np.outer(rng.normal(size=dof), rng.normal(size=points.shape[1]).cumsum())
    wrap = bool(rng.random() < 0.1)
    if kind in ("polyline", "straight"):
        path = sb.Path.through(points, kind="linear", wrap=wrap)
    elif kind == "blend":
        blend = np.ptp(points) * 10 ** rng.uniform(-6, 0)
        path = sb.Path.through(points, kind="linear", wrap=wrap, blend=blend)
    elif kind == "repeats":
        path = sb.Path.through(points, kind=("cubic", "linear")[seed % 2], wrap=wrap)
    elif kind == "chord":
        steps = np.linalg.norm(np.diff(points), axis=0)
        path = sb.Path.through(
            points, s=np.concatenate([[0], np.cumsum(steps + 1e-12 * steps.sum())]), wrap=False
        )
    elif kind == "hermite":
        s = np.cumsum(10 ** rng.uniform(-4, 1, count))
        slopes = rng.normal(size=(count, dof)) * np.abs(points).max() * 10 ** rng.uniform(-2, 2)
        path = sb.Path(CubicHermiteSpline(s, points.T, slopes))
    else:
        degree = int(rng.integers(1, 10))
        number = max(degree + 1, min(count, 15))
        points = rng.normal(size=(dof, number)) * 10 ** (rng.uniform(-3, 3) / (3 if calm else 1))
        path = sb.Path(make_interp_spline(np.linspace(0, 1, number), points.T, k=degree))
    shape = (2, dof, 2, len(path.waypoint_s)) if extra == "varying" else (2, dof, 2)
    sign = np.array([-1.0, 1.0]).reshape((2, 1) if extra == "varying" else 2)
    size = 10 ** (rng.uniform(-4, 4, shape) / (3 if calm else 1)) * sign
    given: dict[str, Any] = {"velocity": size[0], "acceleration": size[1]}
    if extra == "jerk":
        given["jerk"] = 10 ** rng.uniform(-1.5, 1.5, (dof, 2)) * [-1.0, 1.0]
    elif extra == "torque":
        dynamics = strange_dynamics(rng, dof, np.abs(points).max())
        knots = path.curve.x
        s = (knots[:-1] + np.multiply.outer(np.linspace(0, 1, 200), np.diff(knots))).ravel()
        q = path(np.minimum(s, path.s_end))
        load = np.abs(dynamics(q, 0 * q, 0 * q))
        margin = 10 ** rng.uniform(-1, 3, dof)
        given |= {"torque": load.max(axis=1) * (1 + margin), "inverse_dynamics": dynamics}
        if rng.random() < 0.5:
            del given["acceleration"]
    elif extra == "dwell":
        pauses = rng.integers(0, len(path.waypoint_s), 3)
        given["dwell"] = {int(i): 10 ** rng.uniform(-3, 3) for i in pauses}
    elif extra == "duration":
        given["duration"] = 10 ** rng.uniform(0, 2)
    elif extra == "norm":
        given |= {"acceleration_norm": 10 ** rng.uniform(-4, 4), "speed": 10 ** rng.uniform(-4, 4)}
    elif extra == "ends":
        given["ends"] = np.sort(rng.random(2))
    return f"{kind} {extra}", path, given


EXTRAS = dict(enumerate(("jerk", "torque", "varying", "dwell", "duration", "norm", "ends"), 3))


def strange_dynamics(rng: np.random.Generator, dof: int, size: float) -> Any:
    """Draw an inverse dynamics with inertia, centrifugal terms and loads of any sizes."""
    root, rates = rng.normal(size=(dof, dof)), rng.normal(size=(dof, dof, dof))
    inertia = root @ root.T + 0.1 * np.eye(dof)
    scales = 10 ** rng.uniform(-3, 3, (3, 1, 1)) * 10 ** rng.uniform(-1, 1, (3, dof, 1))

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        angle, moved = q / size, inertia @ qdd
        moved = moved * (1 + 0.5 * np.cos(angle[::-1]))
        swung = np.einsum("ijk,j...,k...->i...", rates, qd, qd) * np.sin(angle)
        a, b, c = scales if q.ndim == 2 else scales[..., 0]
        return a * moved + b * swung / size + c * np.cos(angle)

    return dynamics


def part_of(path: sb.Path, begin: float, end: float) -> sb.Path:
    """Return a path from one s to another, exactly where it was."""
    knots = path.curve.x
    inside = knots[(knots > begin) & (knots < end)]
    cuts = np.concatenate([[begin], inside, [end]])
    taylor = [path(cuts[:-1], m).T / math.factorial(m) for m in range(len(path.curve.c))]
    return sb.Path(PPoly(np.stack(taylor[::-1]), cuts))


def other_units(case: dict[str, Any]) -> Iterator[tuple[dict[str, Any], float]]:
    """Yield the same case in other units, and the factor on its duration."""
    ss, v, a = knots_of(case), np.array(case["vlim"], float), np.array(case["alim"], float)
    points, tangents = np.array(case["waypoints"], float), case.get("dwaypoints")
    tangents = None if tangents is None else np.array(tangents, dtype=float)
    for k in (1e3, 1e-3):
        scaled = None if tangents is None else tangents / k
        speeds = {"sd_start": case["sd_start"] * k, "sd_end": case["sd_end"] * k}
        yield case | speeds | {"ss": ss * k, "dwaypoints": scaled}, 1.0
    for k in (1e-4, 1e4):
        speeds = {"sd_start": case["sd_start"] * k, "sd_end": case["sd_end"] * k}
        yield case | speeds | {"vlim": v * k, "alim": a * k**2}, 1 / k
        scaled = None if tangents is None else tangents * k
        larger = {"waypoints": points * k, "dwaypoints": scaled, "vlim": v * k, "alim": a * k}
        yield case | larger, 1.0
