"""The inequalities of each interval, the refinement of grids and the parts between them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import PPoly

import statebook as sb
from statebook.timescale import solve as solving
from statebook.timescale.ceiling import ceiling
from statebook.timescale.grid import lay_grid
from statebook.timescale.limits import AccelerationLimit, Limit, VelocityLimit, kinematic_limits
from statebook.timescale.profile import Profile
from statebook.timescale.rows import stage_rows
from statebook.timescale.solve import _require_bounded, fastest, refine, solve
from statebook.timescale.torques import torque_limit

LINE = sb.Path.through([[0.0, 1.0]])
ARM = sb.PlanarArm(lengths=(0.5, 0.4), masses=(2.0, 1.0))
Z = np.linspace(0, 1, 101)
FAR = 1e6  # times the scale: no s'^2 is above it


def some_limits(kind: str, path: sb.Path) -> list[Limit]:
    """Limits of one kind, different up and down where they can be."""
    if kind == "torque":
        bounds = [[-60.0, 70.0], [-30.0, 25.0]]
        return [torque_limit(path, bounds, ARM.inverse_dynamics)]
    pairs = np.array([[-0.7, 1.0], [-1.6, 1.2]])
    chosen = {"velocity": (pairs, None, None), "acceleration": (None, pairs, None)}
    return kinematic_limits(*chosen.get(kind, (None, None, 1.3)), path)


def at_the_edge(rows, scale: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Go from rest in random directions up to the first inequality: s'^2 at the ends, which."""
    rng = np.random.default_rng(seed)
    x, w = rng.uniform(0.1, 1, len(scale)), rng.uniform(-1, 1, len(scale))
    w = np.maximum(w, -0.9 * x / rows.step)  # s'^2 stays positive
    slope = rows.w * w[:, None] + rows.x * x[:, None]
    with np.errstate(divide="ignore"):
        ratio = np.where(slope > 0, -rows.c / slope, np.inf)
    far = ratio.min(axis=1)
    return scale * far * x, scale * far * (x + rows.step * w), ratio.argmin(axis=1)


@pytest.mark.parametrize("kind", ["velocity", "acceleration", "speed", "torque"])
@pytest.mark.parametrize("seed", range(3))
def test_an_interval_at_the_edge_of_its_inequalities_is_at_its_limit(kind: str, seed: int) -> None:
    """Never beyond it in between; on a fine grid the room that is given away is small."""
    path = sb.Path.through(np.random.default_rng(seed).uniform(-1, 1, (2, 5)))
    limits = some_limits(kind, path)
    grid, _, _ = lay_grid(path, 0.0, 0.0, 400)
    count = len(grid.h)
    rng = np.random.default_rng(seed)
    curvature, scale = rng.uniform(-1, 1, count), 10 ** rng.uniform(-2, 2, count)
    rows = stage_rows(limits, grid, curvature, scale, FAR * np.stack([scale, scale]))
    x0, x1, binding = at_the_edge(rows, scale, seed)
    profile = Profile(grid, x0, x1, x1 - x0, curvature, np.zeros((2, count, 2)))
    use = limits[0].use(grid, Z, profile.u(Z), profile.x(Z))
    highest = use.max(axis=(0, 2))
    assert highest.max() <= 1 + (1e-6 if kind == "torque" else 1e-12)
    assert np.median(highest) > 0.999 and highest.min() > 0.8
    # The inequality that binds is named after the row that is used most, and its side.
    worst = use.max(axis=0).argmax(axis=1)
    named = [rows.labels[rows.which[i, k]] for i, k in enumerate(binding)]
    assert np.mean(worst == [row for _, row, _ in named]) > 0.98
    if kind == "acceleration":
        value = limits[0].values(grid, Z, profile.u(Z), profile.x(Z))
        upper = np.abs(value / limits[0].upper - 1).min(axis=0)[np.arange(count), worst]
        lower = np.abs(value / limits[0].lower - 1).min(axis=0)[np.arange(count), worst]
        sides = np.where(upper < lower, "upper", "lower")
        assert np.mean(sides == [side for _, _, side in named]) > 0.98


@pytest.mark.parametrize("kind", ["acceleration", "torque"])
@pytest.mark.parametrize("size", [1e-4, 1.0, 1e4])
def test_the_inequalities_are_balanced(kind: str, size: float) -> None:
    """Unit gradients; and a step of the second unknown does as much as one of the first."""
    path = sb.Path.through(np.random.default_rng(1).uniform(-1, 1, (2, 5)), s=size * np.arange(5))
    grid, _, _ = lay_grid(path, 0.0, 0.0, 2000)
    scale = np.full(len(grid.h), size**2)
    rows = stage_rows(
        some_limits(kind, path), grid, 0 * scale, scale, FAR * np.stack([scale, scale])
    )
    used = np.hypot(rows.w, rows.x) > 0
    assert np.hypot(rows.w, rows.x)[used] == pytest.approx(np.ones(used.sum()))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(used, (np.abs(rows.x) + np.abs(rows.c)) / np.abs(rows.w), np.inf)
    nearest = ratio.min(axis=1)
    assert np.all(nearest > 0.7) and np.all((nearest < 1.42) | (rows.step == 1))
    assert np.any(rows.step < 1) and set(np.frexp(rows.step)[0]) == {0.5}  # powers of two


def parabola() -> sb.Path:
    """p = s + s^2/2 and -2 s - s^2/4 for s from 0 to 1, in unequal joints."""
    return sb.Path(PPoly(np.array([[[0.5, -0.25]], [[1.0, -2.0]], [[0.0, 0.0]]]), [0.0, 1.0]))


@pytest.mark.parametrize(
    ("joint", "side", "bounds"),
    [
        (0, 1, [[-9, 0.5], [-9, 9]]),
        (0, -1, [[-0.5, 9], [-9, 9]]),
        (1, -1, [[-9, 9], [-0.5, 9]]),
        (1, 1, [[-9, 9], [-9, 0.5]]),
    ],
)
def test_the_bend_that_keeps_a_profile_at_its_acceleration_limit(
    joint: int, side: int, bounds: list
) -> None:
    """On p' u + p'' x = a with x = s'^2 and u = x'/2: h^2 du/ds is the bend."""
    path = parabola()
    grid, _, _ = lay_grid(path, 0.0, 0.0, 50)
    z = np.array([0.0, 0.5, 1.0])
    p1, p2 = grid.path(z, 1)[:, :, joint], grid.path(z, 2)[:, :, joint]
    a = side * 0.5
    x = np.full_like(p1, 0.4)
    u = (a - p2 * x) / p1
    # Along the motion x' = 2 u: du/ds = -(p'' (a - p'' x) / p'^2) - 2 p'' u / p', as p''' = 0.
    slope = -p2 * (a - p2 * x) / p1**2 - 2 * p2 * u / p1
    lower, upper = np.array(bounds, dtype=float).T
    limit = AccelerationLimit("acceleration", lower, upper)
    along = x + 2 * u[1] * (z - 0.5)[:, None] * grid.h
    use, bulge = limit.follow(grid, z, u, along)
    assert use == pytest.approx(np.ones(len(use)), rel=1e-9)
    assert bulge / grid.h**2 == pytest.approx(slope[1], rel=1e-3)


@pytest.mark.parametrize(
    ("joint", "bounds"), [(0, [[-9, 0.5], [-9, 9]]), (1, [[-9, 9], [-0.5, 9]])]
)
def test_the_bend_that_keeps_a_profile_at_its_velocity_limit(joint: int, bounds: list) -> None:
    """On p'^2 x = v^2: the bend is h^2/2 d^2x/ds^2."""
    grid, _, _ = lay_grid(parabola(), 0.0, 0.0, 50)
    z = np.array([0.0, 0.5, 1.0])
    p1, p2 = grid.path(z, 1)[:, :, joint], grid.path(z, 2)[:, :, joint]
    x = (0.5 / p1) ** 2
    lower, upper = np.array(bounds, dtype=float).T
    use, bulge = VelocityLimit("velocity", lower, upper).follow(grid, z, 0 * x, x)
    assert use == pytest.approx(np.ones(len(use)), rel=1e-9)
    exact = 3 * 0.5**2 * p2[1] ** 2 / p1[1] ** 4
    assert bulge / grid.h**2 == pytest.approx(exact, rel=1e-2)


def straight(intervals: int, speed: np.ndarray) -> tuple[list[Limit], Profile]:
    """A straight line under an acceleration of 1 with given s'^2 at the gridpoints."""
    grid, _, _ = lay_grid(LINE, 0.0, 0.0, intervals)
    x0, x1 = speed[:-1], speed[1:]
    s = np.linspace(0, 1, intervals + 1)
    edge = 2 * (1 - s)
    sets = np.zeros((2, intervals, 2))
    sets[1] = np.stack([edge[:-1], edge[1:]], axis=1)
    limits = kinematic_limits(None, 1.0, None, LINE)
    return limits, Profile(grid, x0, x1, x1 - x0, np.zeros(intervals), sets)


def test_the_fastest_profile_is_not_refined_and_a_slow_one_is() -> None:
    s = np.linspace(0, 1, 11)
    limits, fastest = straight(10, 2 * np.minimum(s, 1 - s))
    grid, curvature = refine(limits, fastest, fastest.steps)
    assert grid.h == pytest.approx(np.full(10, 0.1))
    assert curvature == pytest.approx(np.zeros(10))
    limits, slow = straight(10, 0.02 * np.minimum(s, 1 - s))
    grid, _ = refine(limits, slow, slow.steps)
    # Of each interval's time 99 % is lost; splitting in k divides the loss by k^2, by 4 in all.
    ends = np.sqrt(s) / np.sqrt(2)
    share = np.diff(np.where(s <= 0.5, ends, 1 - ends[::-1]))
    parts = np.ceil(np.sqrt(4 * 10 * share)).astype(int)
    assert sorted(set(parts)) == [2, 3]
    assert grid.h == pytest.approx(np.repeat(0.1 / parts, parts))
    grid, _ = refine(limits, fastest, fastest.steps, stuck=True)
    assert grid.h == pytest.approx(np.full(20, 0.05))


def test_intervals_in_which_a_bottleneck_ends_are_split() -> None:
    # Along the edge of the controllable set, below it from s = 0.5 on.
    s = np.linspace(0, 1, 11)
    limits, profile = straight(10, np.where(s <= 0.5, 2 * (1 - s), 1.5 * (1 - s)))
    grid, _ = refine(limits, profile, profile.steps)
    parts = np.histogram(grid.s + grid.h / 2, np.linspace(0, 1, 11))[0]
    assert parts.tolist() == [1, 1, 1, 1, 4, 4, 4, 3, 3, 4]


@pytest.mark.parametrize(
    ("speed", "expected"),
    [
        # Half the smaller second difference of s'^2, over the mean of the ends; at most 1.
        ([1, 0.1, 1e-3, 1e-3, 0.1, 1], [0.801 / 1.1, 0.099 / 0.101, 1, 0.099 / 0.101, 0.801 / 1.1]),
        ([0, 1, 0], [-1, -1]),
        ([0, 0.2, 0.3, 0.4], [-0.5, 0, 0]),  # 0 where they do not agree in sign
    ],
)
def test_a_bend_is_no_larger_than_the_mean_of_the_ends(
    speed: list, expected: list, monkeypatch: Any
) -> None:
    _, profile = straight(len(speed) - 1, np.array(speed, dtype=float))
    monkeypatch.setattr(solving, "_PARTS", 1)
    _, curvature = refine(kinematic_limits(None, 100.0, None, LINE), profile, profile.steps)
    assert curvature == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_refined_profiles_bend_within_bounds(seed: int) -> None:
    pytest.importorskip("toppra")
    path = sb.Path.through(np.random.default_rng(seed).uniform(-1, 1, (2, 6)))
    limits = [*some_limits("velocity", path), *some_limits("acceleration", path)]
    grid, _, _ = lay_grid(path, 0.0, 0.0, 48)
    profile = solve(limits, grid, np.zeros(len(grid.h)), ceiling(limits, grid).x)
    finer, curvature = refine(limits, profile, profile.steps)
    assert np.abs(curvature).max() <= 1 and np.ptp(curvature) > 0.05
    assert np.sum(finer.h) == pytest.approx(1.0, rel=1e-12)
    assert finer.s[1:] == pytest.approx((finer.s + finer.h)[:-1], abs=1e-12)
    # Shapes that follow a limit lose less than straight ones on the same grid.
    top = ceiling(limits, finer).x
    bent, plain = (solve(limits, finer, bend, top) for bend in (curvature, 0 * curvature))
    assert bent.duration < plain.duration < profile.duration


def test_what_no_motion_exceeds_is_what_brakes_away_in_time() -> None:
    # s'^2 = 2 a (1 - s) with the braking rate a, at the left end of each interval. Joint 0 bounds
    # braking, at 3/2; joint 1, which moves the other way, bounds the gain of speed at 5.
    path = sb.Path.through([[0.0, 2.0], [0.0, -1.0]])
    grid, _, _ = lay_grid(path, 0.0, 0.0, 10)
    limits = kinematic_limits(None, [[-3.0, np.inf], [-5.0, np.inf]], None, path)
    slower = np.minimum(3 * (1 - grid.s), 10 * grid.s)
    assert ceiling(limits, grid).x[0] == pytest.approx(slower)
    limits += kinematic_limits([1.0, 2.0], None, None, path)
    top = ceiling(limits, grid)
    assert top.x[0] == pytest.approx(np.minimum(slower, 0.25))
    # Up at 5 to 1/2, then at that speed, then down at 3/2.
    up, down = 0.25 / 10, 0.25 / 3
    assert top.duration == pytest.approx(0.5 / 5 + 0.5 / 1.5 + (1 - up - down) / 0.5, rel=1e-8)


@pytest.mark.parametrize("seed", range(12))
def test_no_motion_is_faster_than_the_bound_on_any_grid(seed: int) -> None:
    """The bound of a coarse grid lies below the fastest motion of a fine one, and near it."""
    pytest.importorskip("toppra")
    path = sb.Path.through(np.random.default_rng(seed).normal(size=(seed % 3 + 1, seed % 4 + 4)))
    limits = kinematic_limits(1.0, 2.0, None, path)
    if seed % 2 and path.dof == 2:
        limits.append(torque_limit(path, [30.0, 10.0], ARM.inverse_dynamics))
    fine, least = fastest(limits, lay_grid(path, 0.0, 0.0, 48)[0], 1e-5)
    assert 0 < 1 - least / fine.duration < 1e-5
    for intervals in (4, 20, 100):
        grid, _, _ = lay_grid(path, 0.0, 0.0, intervals)
        top = ceiling(limits, grid)
        assert top.duration <= fine.duration * (1 + 1e-9)
        i = np.searchsorted(fine.grid.s, grid.s + 1e-12, side="right") - 1
        z = (grid.s - fine.grid.s[i]) / fine.grid.h[i]
        there = fine.x0[i] * (1 - z) + fine.x1[i] * z - fine.bulge[i] * z * (1 - z)
        assert np.all(there <= top.x[0] * (1 + 1e-8) + 1e-12)
    assert top.duration > 0.98 * fine.duration


def test_a_joint_that_nothing_holds_is_reported_where_it_moves() -> None:
    path = sb.Path.through([[0, 1, 1, 1.0], [0, 0, 1, 2]], kind="linear")
    grid, _, _ = lay_grid(path, 0.0, 0.0, 9)
    with pytest.raises(ValueError, match=r"unbounded at s = 0\.333333"):
        _require_bounded(kinematic_limits(None, [1.0, np.inf], None, path), grid)


def test_a_function_for_batches_is_called_with_batches() -> None:
    pytest.importorskip("toppra")
    single = []

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        if q.ndim == 1:
            single.append(1)
        return ARM.inverse_dynamics(q, qd, qdd)

    path = sb.Path.through([[0.0, 1.0], [0.5, -0.5]])
    sb.time_scale(path, torque=80.0, inverse_dynamics=dynamics)
    assert 0 < len(single) < 20  # to find its shape and its noise, and to check its batches


def test_the_use_of_ranges_around_zero_and_of_others() -> None:
    """A row that is far from its bound has a negative use, and its place is right."""
    pytest.importorskip("toppra")

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        high = -20 - 10 * (q[:1] - 0.5) ** 2  # the largest value is -20, in the middle of the path
        return np.concatenate([high, 4 + qdd[:1], -0.7 * qdd[:1]]) + 0 * qdd[:1]

    timed = sb.time_scale(
        sb.Path.through([[0.0, 1.0]]),
        torque=[[-np.inf, -5.0], [3.0, 5.0], [-1.4, 2.8]],
        inverse_dynamics=dynamics,
    )
    assert timed.duration == pytest.approx(2.0, rel=1e-5)
    never, narrow, around = timed.audit()
    assert never.use == pytest.approx(1 - 15 / 5, rel=1e-6)
    assert never.s == pytest.approx(0.5, abs=2e-3) and never.time == pytest.approx(1.0, abs=2e-3)
    assert narrow.use == pytest.approx(1.0, rel=1e-6) and narrow.time == 0
    assert around.use == pytest.approx(0.5, rel=1e-6) and around.time == 0  # 0.7 of 1.4


def test_a_torque_that_is_never_used() -> None:
    pytest.importorskip("toppra")
    path = sb.Path.through([[0.0, 1.0]])
    timed = sb.time_scale(path, 1.0, 1.0, torque=3.0, inverse_dynamics=lambda q, qd, qdd: 0 * qdd)
    use = timed.audit().uses[-1]
    assert (use.limit, use.use, use.time, use.s) == ("torque", 0, 0, 0)


def test_a_movement_below_rounding_is_none() -> None:
    # Beside positions of 1e6 a movement of 1e-8 is rounding.
    pieces = [[[0.0], [1.0]], [[1e-8], [1e-8]], [[1e6], [1e6 + 1e-8]]]
    grid, _, skipped = lay_grid(sb.Path(PPoly(np.array(pieces), [0, 1, 2])), 0.0, 0.0, 10)
    assert skipped == ((0.0, 1.0),)
    assert grid.s[0] == 1.0 and np.sum(grid.h) == pytest.approx(1.0)


def test_torques_are_audited_on_5_points_of_each_interval() -> None:
    pytest.importorskip("toppra")
    columns = set()

    def dynamics(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        columns.add(q.size)
        return 2 * qdd

    timed = sb.time_scale(sb.Path.through([[0.0, 1.0]]), torque=1.0, inverse_dynamics=dynamics)
    columns.clear()
    timed.audit()
    assert columns == {5 * (len(timed.s) - 1)}
