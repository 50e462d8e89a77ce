"""The paths of the time-scaling benchmark: from a file, or drawn at random."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PPoly


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
