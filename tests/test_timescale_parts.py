"""The parts that time scaling is made of."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

import statebook as sb
from statebook.timescale import bernstein
from statebook.timescale.grid import lay_grid
from statebook.timescale.profile import Profile, travel_time


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 6, 10])
def test_bernstein_coefficients_reproduce_and_bound(degree: int) -> None:
    rng = np.random.default_rng(degree)
    power = rng.normal(size=degree + 1)
    values = np.polynomial.polynomial.polyval(bernstein.nodes(degree), power)
    coefficients = bernstein.from_values(degree) @ values
    z = np.linspace(0, 1, 101)
    exact = np.polynomial.polynomial.polyval(z, power)
    assert coefficients.min() - 1e-12 <= exact.min()
    assert exact.max() <= coefficients.max() + 1e-12
    assert coefficients[[0, -1]] == pytest.approx(exact[[0, -1]], abs=1e-10)


@pytest.mark.parametrize("degree", [1, 3, 6])
def test_maxima_are_those_of_the_roots_of_the_derivative(degree: int) -> None:
    rng = np.random.default_rng(degree)
    power = rng.normal(size=(degree + 1, 50, 4))
    values = np.polynomial.polynomial.polyval(bernstein.nodes(degree), power)
    coefficients = bernstein.along(bernstein.from_values(degree), np.moveaxis(values, -1, 0))
    value, member, z = bernstein.maxima(coefficients)
    for row in range(4):
        best = -np.inf
        for n in range(50):
            p = np.polynomial.Polynomial(power[:, n, row])
            roots = p.deriv().roots()
            inside = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0) & (roots.real < 1)]
            best = max(best, p(np.concatenate([[0, 1], inside])).max())
        assert value[row] == pytest.approx(best, rel=1e-9)
        reached = np.polynomial.Polynomial(power[:, member[row], row])(z[row])
        assert reached == pytest.approx(best, rel=1e-9)


def test_maxima_count_only_where_the_sign_is_positive() -> None:
    # The largest value of (z - 1/4)^2 is 9/16 at 1; where z < 1/4 it is 1/16 at 0.
    square = bernstein.from_values(2) @ (bernstein.nodes(2) - 0.25) ** 2
    sign = bernstein.from_values(1) @ (0.25 - bernstein.nodes(1))
    value, _, z = bernstein.maxima(square[:, None, None], sign[:, None, None])
    assert value[0] == pytest.approx(1 / 16) and z[0] == 0
    value, _, _ = bernstein.maxima(square[:, None, None], -np.ones((1, 1, 1)))
    assert value[0] == -np.inf


@pytest.mark.parametrize("bulge", [-3.0, -1e-12, 0.0, 1e-12, 0.8])
@pytest.mark.parametrize("ends", [(0.0, 2.0), (1.5, 0.0), (1.0, 1.0), (0.3, 4.0)])
def test_travel_time_is_the_integral_of_ds_over_speed(
    bulge: float, ends: tuple[float, float]
) -> None:
    x0, x1 = ends
    h = 0.7

    def slowness(y: float) -> float:  # z = y^2 (3 - 2 y) takes away the root at a standstill
        z = y * y * (3 - 2 * y)
        return h * 6 * y * (1 - y) / np.sqrt(x0 * (1 - z) + x1 * z - bulge * z * (1 - z))

    expected, _ = quad(slowness, 0, 1, epsabs=1e-13, epsrel=1e-12)
    found = travel_time(*(np.array([v]) for v in (h, x0, x1, bulge)))
    assert found[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("curvature", [-0.9, 0.0, 0.9])
def test_the_profile_in_time_solves_its_differential_equation(curvature: float) -> None:
    grid, _, _ = lay_grid(sb.Path.through([[0.0, 1.0]]), 0.0, 0.0, 3)
    profile = Profile(
        grid,
        np.array([0.0, 2.0, 1.0]),
        np.array([2.0, 1.0, 0.0]),
        np.array([2.0, -1.0, -1.0]),
        np.full(3, curvature),
        np.zeros((2, 3, 2)),
    )
    t = np.linspace(0, profile.duration, 4001)
    i, ds, speed, rate = profile.locate(t)
    s = grid.s[i] + ds
    assert (s[0], s[-1]) == pytest.approx((0, 1), abs=1e-12)
    same = np.append(False, np.append(i[2:] == i[:-2], False))
    assert np.gradient(s, t)[same] == pytest.approx(speed[same], abs=1e-5)
    assert np.gradient(speed, t)[same] == pytest.approx(rate[same], abs=1e-4)
    # s'^2 in time is the quadratic in s of each interval.
    z = ds / grid.h[i]
    x = profile.x0[i] * (1 - z) + profile.x1[i] * z - profile.bulge[i] * z * (1 - z)
    assert speed**2 == pytest.approx(x, abs=1e-12)
    for interval in range(3):
        half = profile.time_at(interval, 0.5)
        assert profile.locate(np.array([half]))[1][0] == pytest.approx(grid.h[interval] / 2)


def test_sections_begin_and_end_where_the_motion_must_stop() -> None:
    corner = sb.Path.through([[0, 1, 1, 1], [0, 0, 0, 1]], kind="linear")
    grid, stops, skipped = lay_grid(corner, 0.5, 0.0, 10)
    assert [(part.start, part.end) for part in grid.sections] == [(0.25, 0.0), (0.0, 0.0)]
    assert stops == (pytest.approx(2 / 3),)
    assert skipped == ((pytest.approx(1 / 3), pytest.approx(2 / 3)),)
    pauses = sb.Path.through([[0, 1, 1, 2, 2, 2, 3, 3]], kind="linear", s=np.arange(8))
    assert lay_grid(pauses, 0.0, 0.0, 10)[2] == ((1.0, 2.0), (3.0, 5.0), (6.0, 7.0))
    clamped = sb.Path.through([[0, 1, 0, 2]], bc_type="clamped")
    grid, stops, _ = lay_grid(clamped, 0.0, 0.0, 10)
    assert (grid.sections[0].start, grid.sections[-1].end) == (None, None)
    assert stops == ()
    assert np.sum(grid.h) == pytest.approx(1.0)


def test_an_audit_prints_as_a_table() -> None:
    pytest.importorskip("toppra")
    report = sb.time_scale(sb.Path.through([[0.0, 1.0], [0.0, 0.5]]), 1.0, 2.0).audit()
    lines = repr(report).splitlines()
    assert lines[0].split() == ["limit", "row", "use", "time", "s"]
    assert lines[1].split()[:3] == ["velocity", "0", "1.0000"]
    assert lines[4].split()[:3] == ["acceleration", "1", "0.5000"]
    assert {u.exact for u in report} == {True}


def test_the_rate_on_intervals_so_short_that_the_speeds_at_both_ends_are_one_number() -> None:
    grid, _, _ = lay_grid(sb.Path.through([[0.0, 1.0]]), 0.0, 0.0, 2)
    tiny, one = np.array([3e-18, -3e-18]), np.ones(2)
    profile = Profile(grid, one, one, tiny, 0 * one, np.zeros((2, 2, 2)))
    assert profile.u(np.zeros(1))[0] == pytest.approx(tiny, rel=1e-12)
    assert profile.slower(2.0).u(np.zeros(1))[0] == pytest.approx(tiny / 4, rel=1e-12)
