"""Critical steps against closed forms, and against the one-step matrix on both sides."""

import numpy as np
import pytest
import scipy
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import statebook as sb

RUNGE_KUTTA = ["euler", "midpoint", "heun", "rk4", "dopri5", "backward_euler", "implicit_midpoint"]
A_STABLE = ["backward_euler", "implicit_midpoint"]
ALL = [*RUNGE_KUTTA, "semi_implicit_euler"]
PURE = np.array([[0.0, 1.0], [-1.0, 0.0]])
DAMPED = np.array([[0.0, 1.0], [-10.0, -1.0]])
UNSTABLE = np.array([[0.0, 1.0], [1.0, 0.0]])
DOUBLE_INTEGRATOR = np.array([[0.0, 1.0], [0.0, 0.0]])


def oscillator(omega, zeta):
    return np.array([[0.0, 1.0], [-(omega**2), -2 * zeta * omega]])


def radius(A, h, method):
    """Spectral radius of a step, or of each of several."""
    return np.abs(np.linalg.eigvals(sb.amplification_matrix(A, h, method))).max(axis=-1)


@pytest.mark.parametrize(
    ("A", "method", "expected"),
    [
        (DAMPED, "euler", 0.1),
        (PURE, "euler", 0.0),
        (PURE, "midpoint", 0.0),
        (PURE, "heun", 0.0),
        (PURE, "rk4", 2 * np.sqrt(2)),
        (PURE, "semi_implicit_euler", 2.0),
        (PURE, "implicit_midpoint", np.inf),
        (PURE, "backward_euler", np.inf),
        (DAMPED, "semi_implicit_euler", (np.sqrt(41) - 1) / 10),
        ([[-4.0]], "euler", 0.5),
        ([[-4.0]], "heun", 0.5),
        # The real root of 24 + 12 z + 4 z^2 + z^3 = 0, which is 24 (R(z) - 1) / z.
        ([[-1.0]], "rk4", -np.roots([1, 4, 12, 24])[np.isreal(np.roots([1, 4, 12, 24]))][0].real),
        (np.diag([-1.0, -1e6]), "euler", 2e-6),
        ([[-1 + 1j]], "euler", 1.0),
    ],
)
def test_closed_forms(A, method, expected):
    found = sb.critical_step(A, method)
    assert found == pytest.approx(expected, rel=4e-15, abs=0)
    assert isinstance(found, float)


@pytest.mark.parametrize("method", ALL)
def test_unstable_systems_have_no_safe_step(method):
    """Small steps follow the growth, even where large ones of backward Euler hide it."""
    assert sb.critical_step(UNSTABLE, method) == 0
    assert sb.critical_step(DOUBLE_INTEGRATOR, method) == 0
    assert sb.critical_step(oscillator(1.0, -1e-6), method) == 0
    assert radius([[1.0]], 3.0, "backward_euler") < 1


@pytest.mark.parametrize("method", ALL)
def test_nothing_moves_nothing_grows(method):
    assert sb.critical_step(np.zeros((4, 4)), method) == np.inf
    assert sb.critical_step(np.zeros((0, 0)), method) == np.inf


@pytest.mark.parametrize("method", A_STABLE)
def test_a_stable_methods_have_no_limit(method):
    for A in (DAMPED, PURE, -np.eye(3), np.diag([-1.0, 0.0]), np.array([[-1e8, 1], [0, -1e-8]])):
        assert sb.critical_step(A, method) == np.inf


def test_semi_implicit_euler_at_its_limit_is_not_bounded():
    """The critical step is a supremum: at h = 2 the one-step matrix has a Jordan block at -1."""
    M = sb.amplification_matrix(PURE, 2.0, "semi_implicit_euler")
    assert sb.stability(M, dt=2.0).verdict == "unstable"
    assert sb.stability(M @ M @ M, dt=2.0).verdict == "unstable"


@pytest.mark.parametrize("method", ["euler", "heun", "rk4", "dopri5"])
@given(
    st.floats(0.01, 1.5),
    st.floats(-3, 3),
)
@settings(max_examples=30, deadline=None)
def test_growth_begins_exactly_at_the_critical_step(method, zeta, log_omega):
    # At critical damping the comparison blurs: NumPy finds a double eigenvalue to 1e-8 only.
    assume(abs(zeta - 1) > 1e-2)
    A = oscillator(10**log_omega, zeta)
    h = sb.critical_step(A, method)
    assert radius(A, h, method) == pytest.approx(1, abs=1e-11)
    assert radius(A, 1.001 * h, method) > 1
    assert np.all(radius(A, np.linspace(0.01, 0.999, 50) * h, method) < 1)


@pytest.mark.parametrize("method", ["euler", "heun", "rk4", "dopri5"])
def test_a_double_eigenvalue_costs_no_digits(method):
    """Critical damping: -omega twice, which eigvals finds as -omega +- 1e-8 omega."""
    expected = sb.critical_step([[-1.0]], method)
    Q = np.linalg.qr(np.random.default_rng(0).normal(size=(2, 2)))[0]
    for omega in (3.0, 10.0, 1e5):
        A = oscillator(omega, 1.0)
        assert omega * sb.critical_step(A, method) == pytest.approx(expected, rel=1e-13)
        rotated = Q @ oscillator(1.0, 1.0) @ Q.T
        assert sb.critical_step(rotated, method) == pytest.approx(expected, rel=1e-13)


def test_dopri5_leaves_the_imaginary_axis_where_its_polynomial_says():
    R = sb.METHODS["dopri5"].stability_function
    first = sb.critical_step(PURE, "dopri5")
    inside = np.linspace(1e-3, 0.999, 500) * first
    if first > 0:
        assert np.all(np.abs(R(1j * inside)) <= 1 + 1e-15)
        assert abs(R(1.001j * first)) > 1
    else:
        assert abs(R(0.1j)) > 1


def test_units_of_states_and_time_do_not_matter():
    units = np.array([1e6, 1e-6])
    for method in ("euler", "rk4", "semi_implicit_euler"):
        h = sb.critical_step(DAMPED, method)
        scaled = DAMPED * units[:, None] / units
        assert sb.critical_step(scaled, method) == pytest.approx(h, rel=1e-12)
        assert sb.critical_step(1e9 * DAMPED, method) == pytest.approx(1e-9 * h, rel=1e-12)


# A method whose abs(R) touches 1 inside: R(z) = 1 + z + z^2/8, the Chebyshev polynomial
# T_2(1 + z/4), is -1 with slope 0 at z = -4 and 1 at z = -8.
CHEBYSHEV = sb.ButcherTableau("chebyshev", [[0, 0], ["1/8", 0]], [0, 1], [0, "1/8"], order=1)


@pytest.mark.parametrize("stages", [6, 9, 12])
def test_methods_of_many_stages(stages):
    """R is the exponential's series up to z^s, with coefficients down to 1/s!."""
    A = np.diag(1 / np.arange(stages, 1.0, -1), -1)
    c = [0.0, *(1 / np.arange(stages, 1.0, -1))]
    series = sb.ButcherTableau("series", A, np.eye(stages)[-1], c, order=stages)
    terms = 1 / scipy.special.factorial(np.arange(stages + 1))
    assert series.numerator == pytest.approx(terms, rel=1e-12)

    def excess(h):
        return abs(np.polynomial.polynomial.polyval(-h, terms)) - 1

    scan = np.linspace(0.01, 10, 2000)
    last = np.flatnonzero(excess(scan) > 0)[0]
    expected = scipy.optimize.brentq(excess, scan[last - 1], scan[last], xtol=1e-14)
    assert sb.critical_step([[-1.0]], series) == pytest.approx(expected, rel=1e-11)


def test_touching_the_circle_is_no_crossing():
    assert sb.critical_step([[-1.0]], CHEBYSHEV) == pytest.approx(8, rel=1e-14)
    assert sb.critical_step(np.diag([-1.0, -2.0]), CHEBYSHEV) == pytest.approx(4, rel=1e-14)


def test_touching_the_circle_with_a_jordan_block_is_the_end():
    """R(h A) - R(-h) I is R' N + R'' N^2 / 2, and at h = 4 only R' vanishes."""
    N = np.eye(3, k=1)
    assert sb.critical_step(-np.eye(2) + N[:2, :2], CHEBYSHEV) == pytest.approx(8, rel=1e-14)
    assert sb.critical_step(-np.eye(3) + N, CHEBYSHEV) == pytest.approx(4, rel=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_semi_implicit_euler_on_chains_of_masses(seed):
    """Undamped, q'' = -K q: the limit is 2 / omega_max."""
    rng = np.random.default_rng(seed)
    n = 2 + seed
    K = rng.normal(size=(n, n))
    K = K @ K.T + 0.1 * np.eye(n)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K, np.zeros((n, n))]])
    expected = 2 / np.sqrt(np.linalg.eigvalsh(K).max())
    assert sb.critical_step(A, "semi_implicit_euler") == pytest.approx(expected, rel=1e-12)


@given(st.floats(0.0, 3.0), st.floats(-2, 2))
@settings(max_examples=40, deadline=None)
def test_semi_implicit_euler_on_damped_oscillators(zeta, log_omega):
    """With damping c: det(M + I) = 4 - 2 h c - h^2 k."""
    omega = 10**log_omega
    k, c = omega**2, 2 * zeta * omega
    expected = 4 / (c + np.sqrt(c**2 + 4 * k))
    found = sb.critical_step(oscillator(omega, zeta), "semi_implicit_euler")
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_semi_implicit_euler_on_any_stable_matrix(seed):
    """Complex pairs leave the circle too: compare with a fine scan of the spectral radius."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(4, 4))
    A -= (np.linalg.eigvals(A).real.max() + 0.2) * np.eye(4)
    h = sb.critical_step(A, "semi_implicit_euler")
    scan = np.linspace(1e-3, 1.2 * min(h, 50.0), 3000)
    grows = radius(A, scan, "semi_implicit_euler") > 1 + 1e-9
    assert not np.any(grows[scan < h * (1 - 1e-6)])
    assert radius(A, h * (1 + 1e-4), "semi_implicit_euler") > 1
    assert radius(A, h, "semi_implicit_euler") == pytest.approx(1, abs=1e-9)


def test_a_narrow_window_of_growth_is_found():
    """det(M + I) = 4 + 2 h tr A + h^2 (ad + bc) has two roots, and is negative between them."""
    small = 1e-8
    A = np.array([[-1.0, 1.0], [0.0625 - small, -0.5]])
    first, last = (3 + 4 * np.sqrt(small) * np.array([-1, 1])) / (2 * (0.5625 - small))
    assert sb.critical_step(A, "semi_implicit_euler") == pytest.approx(first, rel=1e-9)
    assert radius(A, (first + last) / 2, "semi_implicit_euler") > 1
    assert radius(A, last + 1e-3, "semi_implicit_euler") < 1
    # Without the window -1 is touched only, at h = 8/3; a complex pair leaves where det M = 1.
    A[1, 0] = 0.0625
    assert sb.critical_step(A, "semi_implicit_euler") == pytest.approx(3.0, rel=1e-9)


def test_prediction_agrees_with_simulation():
    for method in ("euler", "rk4", "semi_implicit_euler"):
        h = sb.critical_step(DAMPED, method)
        for factor, bounded in ((0.97, True), (1.03, False)):
            M = sb.amplification_matrix(DAMPED, factor * h, method)
            grown = np.linalg.norm(np.linalg.matrix_power(M, 2000), 2)
            assert (grown < 10) == bounded


def test_bad_input():
    for method in ("euler", "semi_implicit_euler"):
        with pytest.raises(ValueError, match="square"):
            sb.critical_step(np.ones((2, 3)), method)
        with pytest.raises(ValueError, match="finite"):
            sb.critical_step([[np.inf]], method)
    with pytest.raises(ValueError, match="as many positions as velocities"):
        sb.critical_step(-np.eye(3), "semi_implicit_euler")
    with pytest.raises(ValueError, match="method must be one of"):
        sb.critical_step(-np.eye(2), "rk5")


def test_stiff_systems():
    """The fast mode sets the limit, however weakly it is excited."""
    A = scipy.linalg.block_diag(DAMPED, [[-1e7]])
    assert sb.critical_step(A, "euler") == pytest.approx(2e-7, rel=1e-12)
