"""Verdicts, modes, distances and maps against matrices whose answers are known."""

from decimal import Decimal
from fractions import Fraction

import control
import numpy as np
import pytest
import scipy
import sympy
from hypothesis import example, given, settings
from hypothesis import strategies as st

import statebook as sb
from statebook.verdict.blocks import decompose, with_comparable_couplings
from statebook.verdict.judgement import judge
from statebook.verdict.level_sets import _midpoints, boundary_distance, project
from statebook.verdict.words import sort_eigenvalues, sorting

STABLE, MARGINAL, UNSTABLE = "asymptotically stable", "marginally stable", "unstable"
UNDECIDABLE = "undecidable in double precision"


def jordan(eigenvalue, size, coupling=1.0):
    return eigenvalue * np.eye(size) + coupling * np.eye(size, k=1)


def blocks(*parts):
    return scipy.linalg.block_diag(*parts)


def companion(*coefficients):
    """Companion matrix of s^n + c_1 s^(n-1) + ... + c_n."""
    A = np.eye(len(coefficients), k=1)
    A[-1] = -np.array(coefficients[::-1])
    return A


def oscillator(omega, damping=0.0):
    return np.array([[0.0, 1.0], [-(omega**2), -2 * damping * omega]])


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def orthogonal(n, seed):
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(n, n)))[0]


def resonant(block):
    """Two equal blocks, the second driving the first."""
    return np.block([[block, np.eye(2)], [np.zeros((2, 2)), block]])


def normal50(real):
    parts = [[[real - k / 100, 1 + k], [-1 - k, real - k / 100]] for k in range(25)]
    Q = orthogonal(50, 50)
    return Q @ blocks(*parts) @ Q.T


def kahan(n, angle=1.2):
    s, c = np.sin(angle), np.cos(angle)
    return np.diag(s ** np.arange(n)) @ (np.eye(n) - c * np.triu(np.ones((n, n)), 1))


FREE_MASSES = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-1, 1, 0, 0], [1, -1, 0, 0.0]])

CONTINUOUS = {
    "scalar inside": ([[-1]], STABLE),
    "scalar on": ([[0]], MARGINAL),
    "scalar beyond": ([[1]], UNSTABLE),
    "double integrator": (jordan(0, 2), UNSTABLE),
    "triple integrator": (jordan(0, 3), UNSTABLE),
    "two decoupled integrators": (np.zeros((2, 2)), MARGINAL),
    "integrator and double integrator": (blocks([[0]], jordan(0, 2)), UNSTABLE),
    "two double integrators": (blocks(jordan(0, 2), jordan(0, 2)), UNSTABLE),
    "Jordan block inside": (jordan(-1, 3), STABLE),
    "pure oscillator": (oscillator(1), MARGINAL),
    "pure oscillator, irrational": (oscillator(3.3), MARGINAL),
    "damped oscillator": ([[0, 1], [-10, -1]], STABLE),
    "critically damped": (companion(2, 1), STABLE),
    "negatively damped": (oscillator(2, -0.01), UNSTABLE),
    "two different oscillators": (blocks(oscillator(1), oscillator(2)), MARGINAL),
    "two equal oscillators": (blocks(oscillator(1), oscillator(1)), MARGINAL),
    "resonance": (resonant(oscillator(1)), UNSTABLE),
    "companion (s^2 + 1)^2": (companion(0, 2, 0, 1), UNSTABLE),
    "companion (s^2 + 1)^3": (companion(0, 3, 0, 3, 0, 1), UNSTABLE),
    "companion (s + 1)(s^2 + 1)": (companion(1, 1, 1), MARGINAL),
    "companion (s + 1)(s + 2)(s + 3)": (companion(6, 11, 6), STABLE),
    "companion (s + 1)^3": (companion(3, 3, 1), STABLE),
    "companion s^2 (s + 1)": (companion(1, 0, 0), UNSTABLE),
    "companion (s - 1)(s^2 + 1)": (companion(-1, 1, -1), UNSTABLE),
    "integrator beside a Jordan block": (blocks(jordan(-1, 2), [[0]]), MARGINAL),
    "two integrators, one through a lag": ([[0, 1, 0], [0, -1, 1], [0, 0, 0]], UNSTABLE),
    "two integrators, paths that cancel": ([[0, 1, -1], [0, -1, 1], [0, 0, 0]], MARGINAL),
    "heat exchange": ([[-2, 1, 1], [1, -2, 1], [1, 1, -2]], MARGINAL),
    "free masses on a spring": (FREE_MASSES, UNSTABLE),
    "lag driven by an oscillator": ([[0, 1, 0], [-1, 0, 0], [1, 0, -1]], MARGINAL),
    "upper triangle of -1": (-np.triu(np.ones((6, 6))), STABLE),
    "Hilbert matrix": (-scipy.linalg.hilbert(4), STABLE),
    "normal 50 inside": (normal50(-1e-3), STABLE),
    "normal 50 on": (normal50(0), MARGINAL),
    "normal 50 beyond": (normal50(1e-3), UNSTABLE),
    "complex scalar on": ([[1j]], MARGINAL),
    "complex Jordan block on": (jordan(1j, 2), UNSTABLE),
    "complex scalar inside": ([[-1 + 1j]], STABLE),
}
DISCRETE = {
    "scalar inside": ([[0.5]], STABLE),
    "scalar at 1": ([[1]], MARGINAL),
    "scalar at -1": ([[-1]], MARGINAL),
    "scalar beyond": ([[-1.01]], UNSTABLE),
    "deadbeat": (jordan(0, 4), STABLE),
    "Euler's map of x'' = -10 x - x'": ([[1, 0.1], [-1, 0.9]], MARGINAL),
    "Jordan block of 2 at 1": (jordan(1, 2), UNSTABLE),
    "Jordan block of 2 at -1": (jordan(-1, 2), UNSTABLE),
    "Jordan block of 3 at 1": (jordan(1, 3), UNSTABLE),
    "Jordan block inside": (jordan(0.5, 4), STABLE),
    "identity": (np.eye(3), MARGINAL),
    "rotation": (rotation(0.7), MARGINAL),
    "two equal rotations": (blocks(rotation(0.7), rotation(0.7)), MARGINAL),
    "resonant rotations": (resonant(rotation(0.7)), UNSTABLE),
    "rotation drives another": (
        np.block([[rotation(0.7), np.eye(2)], [np.zeros((2, 2)), rotation(0.9)]]),
        MARGINAL,
    ),
    "cyclic shift": (np.roll(np.eye(5), 1, 0), MARGINAL),
    "companion z^4 - 1": (companion(0, 0, 0, -1), MARGINAL),
    "companion (z^2 - z + 1)^2": (companion(-2, 3, -2, 1), UNSTABLE),
    "companion (z - 1)^2": (companion(-2, 1), UNSTABLE),
    "companion (z - 1)^3": (companion(-3, 3, -1), UNSTABLE),
    "Markov chain": ([[0.5, 0.5, 0], [0.25, 0.5, 0.25], [0, 0.5, 0.5]], MARGINAL),
    "orthogonal inside": (0.99 * orthogonal(20, 1), STABLE),
    "orthogonal": (orthogonal(20, 2), MARGINAL),
    "orthogonal beyond": (1.01 * orthogonal(20, 3), UNSTABLE),
}
CASES = [
    pytest.param(np.array(A), dt, verdict, id=f"{kind}: {name}")
    for kind, cases, dt in (("continuous", CONTINUOUS, None), ("discrete", DISCRETE, 0.1))
    for name, (A, verdict) in cases.items()
]


@pytest.mark.parametrize(("A", "dt", "verdict"), CASES)
def test_known_verdicts_need_no_luck(A, dt, verdict):
    report = sb.stability(A, dt=dt)
    assert report.verdict == verdict
    assert UNDECIDABLE not in report.reason


def same_verdict_elsewhere(A, dt):
    """The matrix in other coordinates, in which nothing about stability changes."""
    n = len(A)
    rng = np.random.default_rng(n)
    units = [10.0 ** (6 * rng.integers(-1, 2, n))]
    times = [1e6] if dt is None else []
    rotations = [orthogonal(n, 0)]
    if n < 20:
        units += [10.0 ** rng.uniform(-6, 6, n), 10.0 ** rng.uniform(-3, 3, n)]
        times += [1e-9, 2 * np.pi] if dt is None else []
        rotations += [orthogonal(n, 1), orthogonal(n, 2)]
    order = rng.permutation(n)
    yield A.T
    yield A[np.ix_(order, order)]
    scaled = [A * unit[:, None] / unit for unit in units]
    rotated = [Q @ A @ Q.T for Q in rotations]
    yield from scaled
    yield from rotated
    yield from (B.T for B in scaled)
    for factor in times:
        yield from (factor * B for B in (A, scaled[-1], rotated[-1]))


@pytest.mark.parametrize(("A", "dt", "verdict"), CASES)
def test_verdict_does_not_depend_on_coordinates_or_units(A, dt, verdict):
    for B in same_verdict_elsewhere(A, dt):
        assert sb.stability(B, dt=dt).verdict == verdict


@pytest.mark.parametrize("seed", range(5))
def test_a_double_eigenvalue_is_reported_without_its_blur(seed):
    """Computed, it comes out as two, 1e-8 apart; the mean of the two is right to rounding."""
    Q = orthogonal(3, seed)
    report = sb.stability(Q @ blocks(jordan(-1, 2), [[-3]]) @ Q.T)
    assert report.eigenvalues == pytest.approx(np.array([-1, -1, -3]), abs=1e-14)
    Q = orthogonal(4, seed)
    pairs = resonant(oscillator(2.0, 0.1))
    expected = np.linalg.eigvals(oscillator(2.0, 0.1))
    found = sb.stability(Q @ pairs @ Q.T).eigenvalues
    assert found == pytest.approx(np.repeat(expected[np.argsort(-expected.imag)], 2), abs=1e-13)


def test_euler_map_on_the_circle_although_its_computed_radius_is_less():
    A = np.array([[0.0, 1.0], [-10.0, -1.0]])
    M = np.eye(2) + 0.1 * A
    assert np.abs(np.linalg.eigvals(M)).max() != 1
    report = sb.stability(M, dt=0.1)
    assert report.verdict == MARGINAL
    assert report.spectral_margin == 0


def badly_scaled_jordan_block(eigenvalue):
    units = np.array([1e6, 1e-6, 1e6])
    Q = orthogonal(3, 5)
    return Q @ (jordan(eigenvalue, 3) * units[:, None] / units) @ Q.T


SHIFT = jordan(-1.0, 50, 10.0)


@pytest.mark.parametrize(
    "A",
    [
        SHIFT,
        SHIFT.T,
        orthogonal(50, 1) @ SHIFT @ orthogonal(50, 1).T,
        -kahan(90),
        -orthogonal(90, 1) @ kahan(90) @ orthogonal(90, 1).T,
        badly_scaled_jordan_block(0.0),
        badly_scaled_jordan_block(-1.0),
        np.array([[-1.0, 1.0], [0.0, -1e-17]]),
    ],
    ids=["shift", "transposed", "rotated", "Kahan", "Kahan rotated", "J(0)", "J(-1)", "slow"],
)
def test_says_when_double_precision_cannot_decide(A):
    report = sb.stability(A)
    assert UNDECIDABLE in report.reason
    if report.verdict == STABLE:
        assert report.spectral_margin > 0


def test_a_best_guess_uses_the_mean_of_a_blurred_cluster():
    Q = orthogonal(50, 1)
    rotated = Q @ SHIFT @ Q.T
    assert np.linalg.eigvals(rotated).real.max() > 1
    report = sb.stability(rotated)
    assert report.verdict == STABLE
    assert report.eigenvalues == pytest.approx(-np.ones(50), abs=1e-9)


def test_an_instability_beyond_doubt_is_not_doubted():
    report = sb.stability(blocks(SHIFT, [[1e-3]]))
    assert report.verdict == UNSTABLE
    assert UNDECIDABLE not in report.reason


def test_decoupled_rates_do_not_disturb_each_other():
    report = sb.stability(np.diag([-1e12, -1e-6]))
    assert report.verdict == STABLE
    assert UNDECIDABLE not in report.reason


def test_nearest_points_of_the_boundary():
    assert project(np.array([0.5j, -2.0, 0.0]), discrete=True).tolist() == [1j, -1.0, 1.0]
    assert project(np.array([3.0 + 2j, -1.0]), discrete=False).tolist() == [2j, 0.0]


@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_eigenvalues_are_sorted_at_every_size(size):
    values = np.array([-2.0, -1 - 1j, -1 + 1j, 0.5])
    order = [3, 2, 1, 0]
    assert sort_eigenvalues(size * values).tolist() == (size * values[order]).tolist()
    noise = np.array([1e-12, -1e-12, 0, 0])  # does not shuffle a pair
    assert sorting(size * (values[[1, 2, 0, 3]] + noise)).tolist() == [3, 1, 0, 2]


@pytest.mark.parametrize("seed", range(10))
def test_a_jordan_block_at_minus_one_among_others_on_the_circle(seed):
    Q = orthogonal(5, seed)
    A = Q @ blocks(jordan(-1, 2), rotation(2.0), [[1.0]]) @ Q.T
    report = sb.stability(A, dt=True)
    assert report.verdict == UNSTABLE and UNDECIDABLE not in report.reason
    assert ": -1 on the unit circle (to within tolerance, " in report.reason


@pytest.mark.parametrize(("discrete", "rate"), [(False, 3.0), (True, 1.0)])
@pytest.mark.parametrize("couplings", [(1e8, 1e-5), (1e-7, 1e-7), (1e9, 1e9)])
def test_couplings_between_blocks_come_to_the_size_of_the_blocks(couplings, discrete, rate):
    A = np.diag([-1.0, -2.0, -3.0])
    A[0, 1], A[1, 2] = couplings
    B = with_comparable_couplings(A, decompose(A), discrete)
    assert np.linalg.eigvals(B) == pytest.approx(np.linalg.eigvals(A))
    sizes = B[B * (1 - np.eye(3)) != 0]
    assert len(sizes) == 2
    assert np.all((sizes > rate / 2.1) & (sizes < rate * 2.1))


def test_units_differ_by_no_more_than_a_choice_of_units_can():
    A = np.array([[-1.0, 1e-40], [0.0, -2.0]])
    B = with_comparable_couplings(A, decompose(A), discrete=False)
    assert B[0, 1] == pytest.approx(1e-16, rel=1.0)


def test_empty_system_is_stable_vacuously():
    report = sb.stability(np.zeros((0, 0)))
    assert report.verdict == STABLE
    assert report.eigenvalues.shape == (0,)
    assert report.modes == ()
    assert judge(np.zeros((0, 0)), discrete=False).participations.shape == (0, 0)
    assert sb.distance_to_instability(np.zeros((0, 0))) == np.inf


@given(
    st.lists(st.floats(-3, -0.05), min_size=1, max_size=5),
    st.sampled_from([-0.01, 0.0, 0.01]),
    st.integers(0, 10_000),
)
@example([-1.3542086695180349, -1.0], 0.0, 582)
@settings(max_examples=60, deadline=None)
def test_random_similarity_keeps_the_verdict(inside, worst, seed):
    values = np.array([*inside, worst])
    V = np.random.default_rng(seed).normal(size=(len(values), len(values)))
    V += 3 * np.sqrt(len(values)) * np.eye(len(values))
    A = V @ np.diag(values) @ np.linalg.inv(V)
    expected = {-0.01: STABLE, 0.0: MARGINAL, 0.01: UNSTABLE}[worst]
    report = sb.stability(A)
    assert report.verdict == expected
    assert report.spectral_margin == pytest.approx(-worst, abs=1e-12)


def exact_continuous_verdict(A):
    """Routh and Hurwitz on s^3 + a s^2 + b s + c, for an integer matrix, in integers."""
    minors = sum(A[i, i] * A[j, j] - A[i, j] * A[j, i] for i, j in ((0, 1), (0, 2), (1, 2)))
    a, b, c = -int(np.trace(A)), int(minors), -round(np.linalg.det(A))
    if c != 0:
        if a > 0 and c > 0 and a * b > c:
            return STABLE
        return MARGINAL if a * b == c and b > 0 and a > 0 else UNSTABLE
    if b != 0:  # s (s^2 + a s + b)
        return MARGINAL if a >= 0 and b > 0 else UNSTABLE
    defect = np.linalg.matrix_rank(A) - (a != 0)  # s^2 (s + a)
    return MARGINAL if a >= 0 and defect == 0 else UNSTABLE


def exact_discrete_verdict(A):
    """Jury's conditions for a 2 x 2 matrix, in numbers without rounding."""
    t, d = np.trace(A), A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    at_one, at_minus_one = 1 - t + d, 1 + t + d
    if at_one > 0 and at_minus_one > 0 and d < 1:
        return STABLE
    if at_one < 0 or at_minus_one < 0 or d > 1 or (d == 1 and abs(t) > 2):
        return UNSTABLE
    if d == 1 and abs(t) == 2:
        return MARGINAL if np.array_equal(A, t / 2 * np.eye(2)) else UNSTABLE
    return MARGINAL


@pytest.mark.parametrize(
    ("n", "dt", "unit", "exact"),
    [(3, None, 1, exact_continuous_verdict), (2, 0.1, 0.5, exact_discrete_verdict)],
)
def test_small_integer_matrices_against_exact_arithmetic(n, dt, unit, exact):
    rng = np.random.default_rng(n)
    seen = set()
    for k in range(120):
        A = rng.integers(-2, 3, (n, n)) * (rng.uniform(size=(n, n)) < 0.75) * unit
        seen.add(expected := exact(A))
        units, Q = 10.0 ** rng.uniform(-4, 4, n), orthogonal(n, k)
        for B in (A, A * units[:, None] / units, Q @ A @ Q.T):
            assert sb.stability(B, dt=dt).verdict == expected, A
    assert seen == {STABLE, MARGINAL, UNSTABLE}


# Equilibria and systems


def test_pendulum_by_the_indirect_method():
    pendulum = sb.Pendulum(m=2.0, L=0.5, damping=0.1)
    assert sb.stability(pendulum, x0=[-np.pi / 2, 0]).verdict == STABLE
    assert sb.stability(pendulum, x0=[np.pi / 2, 0]).verdict == UNSTABLE


def test_pendulum_held_horizontally_is_inconclusive():
    pendulum = sb.Pendulum(m=2.0, L=0.5)
    report = sb.stability(pendulum, x0=[0, 0], u0=[2.0 * 9.8 * 0.5])
    assert report.verdict == "inconclusive"
    assert "higher-order" in report.reason


@pytest.mark.parametrize(
    ("f", "n"),
    [
        (lambda x: -(x**3), 1),
        (lambda x: x**3, 1),
        (lambda x: np.array([x[1], -np.sin(x[0])]), 2),
        (lambda x: np.array([-x[0] + x[1], -(x[1] ** 2)]), 2),
        (lambda x: np.array([x[1], -x[0] - x[1] * abs(x[1])]), 2),
    ],
)
def test_nonlinear_equilibrium_on_the_boundary_is_inconclusive(f, n):
    assert sb.stability(f, x0=np.zeros(n)).verdict == "inconclusive"


def test_linear_systems_are_never_inconclusive():
    assert sb.stability(sb.Particle()).verdict == UNSTABLE
    assert sb.stability(sb.Oscillator()).verdict == MARGINAL
    assert sb.stability(control.ss([[0.0]], [[1]], [[1]], [[0]])).verdict == MARGINAL
    assert sb.stability(control.ss([[1.0]], [[1]], [[1]], [[0]], dt=0.5)).verdict == MARGINAL


def test_discrete_nonlinear_map():
    def logistic(r):
        return lambda x: r * x * (1 - x)

    for r, verdict in ((2.9, STABLE), (3.0, "inconclusive"), (3.1, UNSTABLE)):
        assert sb.stability(logistic(r), x0=[1 - 1 / r], dt=True).verdict == verdict


# Modes


def test_modes_of_a_damped_oscillator():
    omega, zeta = 3.0, 0.2
    report = sb.stability(oscillator(omega, zeta))
    for mode in report.modes:
        assert mode.damping == pytest.approx(zeta, rel=1e-12)
        assert mode.frequency == pytest.approx(omega, rel=1e-12)
        assert mode.time_constant == pytest.approx(1 / (zeta * omega), rel=1e-12)
        assert mode.participation == pytest.approx([0.5, 0.5])
    assert report.eigenvalues[0] == report.eigenvalues[1].conj()
    assert report.eigenvalues[0].imag > 0


def test_discrete_modes_are_those_of_the_sampled_system():
    A, dt = blocks(oscillator(3.0, 0.2), [[-0.4]]), 0.25
    continuous = sb.stability(A).modes
    discrete = sb.stability(scipy.linalg.expm(A * dt), dt=dt).modes

    def table(modes):
        return sorted((m.frequency, m.damping, m.time_constant) for m in modes)

    assert np.allclose(table(continuous), table(discrete), rtol=1e-9)


@pytest.mark.parametrize(
    "eigenvalues",
    [
        blocks([[-1.0]], [[-1.0]], [[-3.0]]),
        blocks([[-1.0, 1.0], [0.0, -1.0]], [[-3.0]]),
        blocks(oscillator(2.0, 0.1), oscillator(2.0, 0.1)),
    ],
)
def test_states_of_a_repeated_eigenvalue_are_those_of_its_subspace(eigenvalues):
    """Eigenvectors of a double eigenvalue are rounding's choice; the spectral projector is not."""
    rng = np.random.default_rng(2)
    n = len(eigenvalues)
    V = rng.normal(size=(n, n))
    inverse = np.linalg.inv(V)
    A = V @ eigenvalues @ inverse
    if n == 3:
        expected = [np.abs(np.diag(V[:, :2] @ inverse[:2]))] * 2 + [np.abs(V[:, 2] * inverse[2])]
    else:
        P = np.linalg.eig(oscillator(2.0, 0.1))
        v = P[0][P[0].imag > 0]
        other = eigenvalues - v.conj() * np.eye(4)
        expected = [np.abs(np.diag(V @ (other / (v - v.conj())) @ inverse))] * 4
    expected = [share / share.sum() for share in expected]
    for _ in range(3):
        noise = 1 + 4e-16 * rng.uniform(-1, 1, size=A.shape)
        shares = [mode.participation for mode in sb.stability(A * noise).modes]
        assert np.array(shares) == pytest.approx(np.array(expected), abs=1e-6)


def test_participation_tells_modes_apart_and_ignores_units():
    A = np.array([[-1.0, 1e-3, 0], [0, -5.0, 0.1], [1e-3, 0, -20.0]])
    units = np.array([1e6, 1.0, 1e-6])
    shares = np.array([mode.participation for mode in sb.stability(A).modes])
    assert np.argmax(shares, axis=1).tolist() == [0, 1, 2]
    assert shares.sum(axis=1) == pytest.approx(np.ones(3))
    scaled = sb.stability(A * units[:, None] / units).modes
    assert np.array([mode.participation for mode in scaled]) == pytest.approx(shares, abs=1e-9)


def test_report_reads_well():
    text = repr(sb.stability(sb.Oscillator(stiffness=10.0, damping=1.0)))
    assert text.splitlines()[0] == "asymptotically stable (spectral margin 0.5)"
    assert "-0.5 + 3.122j  0.1581   3.162" in text
    assert text.splitlines()[-1].endswith("p, v")
    assert "-0 " not in repr(sb.stability(np.zeros((2, 2))))
    assert "... and 38 more" in repr(sb.stability(SHIFT))
    assert "freq. [rad/s]  time const. [s]" in repr(sb.stability(np.eye(2) / 2, dt=0.1))
    assert "freq. [rad/sample]  time const. [sample]" in repr(sb.stability(np.eye(2) / 2, dt=True))


# Distance to instability


def test_distance_of_normal_matrices_is_that_of_the_spectrum():
    assert sb.distance_to_instability(normal50(-0.25)) == pytest.approx(0.25, rel=1e-12)
    assert sb.distance_to_instability(0.75 * orthogonal(20, 4), dt=1.0) == pytest.approx(0.25)
    assert sb.distance_to_instability([[0.0]], dt=True) == 1


@pytest.mark.parametrize("c", [0.1, 1.0, 30.0, 1e4])
def test_distance_of_jordan_blocks_in_closed_form(c):
    # sigma_min([[1, c], [0, 1]]) = (sqrt(c^2 + 4) - c) / 2, and no boundary point is nearer.
    expected = 2 / (np.sqrt(c**2 + 4) + c)
    assert sb.distance_to_instability(jordan(-1, 2, c)) == pytest.approx(expected, rel=1e-9)
    assert sb.distance_to_instability(jordan(0, 2, c), dt=True) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("dt", [None, 0.1])
def test_distance_is_the_global_minimum_and_is_attained(seed, dt):
    rng = np.random.default_rng(seed)
    n = 6
    A = rng.normal(size=(n, n)) + 2 * np.triu(rng.normal(size=(n, n)), 1)
    if dt is None:
        A -= (np.linalg.eigvals(A).real.max() + 0.1) * np.eye(n)
        points = 1j * np.linspace(-15, 15, 6001)
    else:
        A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
        points = np.exp(1j * np.linspace(0, 2 * np.pi, 6001))
    distance = sb.distance_to_instability(A, dt=dt)
    lowest, where = np.inf, 0j
    for point in points:
        s = np.linalg.svd(A - point * np.eye(n), compute_uv=False)[-1]
        if s < lowest:
            lowest, where = s, point
    assert distance <= lowest * (1 + 1e-12)
    assert distance == pytest.approx(lowest, rel=1e-3)
    U, s, Vh = np.linalg.svd(A - where * np.eye(n))
    moved = np.linalg.eigvals(A - s[-1] * np.outer(U[:, -1], Vh[-1]))
    assert np.abs(moved - where).min() < 1e-9


def test_distance_where_no_eigenvalue_points_to_it():
    """The valleys of sigma_min lie away from the eigenvalues' frequencies 2 and -2, angles 1, -1.

    In closed form: s1 s2 = abs(det) and s1^2 + s2^2 = sum of squares, for 2 x 2 matrices.
    """

    def lowest(A, points):
        D = A - points[:, None, None] * np.eye(2)
        det, total = np.abs(np.linalg.det(D)), (np.abs(D) ** 2).sum(axis=(1, 2))
        return (det / np.sqrt((total + np.sqrt(total**2 - 4 * det**2)) / 2)).min()

    line = np.linspace(-3, 3, 200_001)
    A = np.array([[-1 + 2j, 50], [0, -1 - 2j]])
    assert lowest(A, np.array([2j])) > 1.02 * lowest(A, 1j * line)
    assert sb.distance_to_instability(A) == pytest.approx(lowest(A, 1j * line), rel=1e-8)
    z = 0.5 * np.exp(1j)
    A = np.array([[z, 50], [0, z.conj()]])
    circle = np.exp(1j * line * np.pi / 3)
    assert lowest(A, np.array([2 * z])) > 1.02 * lowest(A, circle)
    assert sb.distance_to_instability(A, dt=0.1) == pytest.approx(lowest(A, circle), rel=1e-8)


def test_the_search_looks_between_neighbouring_crossings():
    positions = np.array([-2.0, -1.0, 1.0, 2.5])
    between = np.array([-1.5, 0.0, 1.75])
    assert _midpoints(positions, discrete=False) == pytest.approx(1j * between)
    assert _midpoints(positions[:1], discrete=False) == pytest.approx(np.array([-2j]))
    around = np.append(between, (2.5 - 2.0) / 2 + np.pi)
    assert _midpoints(positions, discrete=True) == pytest.approx(np.exp(1j * around))


def test_the_search_for_a_distance_ends_at_what_is_enough():
    """In the units of the matrix: the first value that is looked at is 4 % too large here."""
    A = 2.0**20 * np.array([[-1 + 2j, 50], [0, -1 - 2j]])
    exact = sb.distance_to_instability(A)
    first = np.linalg.svd(A - 2.0**20 * 2j * np.eye(2), compute_uv=False)[-1]
    assert first > 1.02 * exact
    close = boundary_distance(A, discrete=False, enough=0.5 * exact)
    assert close == pytest.approx(exact, rel=1e-9)
    assert exact * (1 - 1e-9) <= boundary_distance(A, discrete=False, enough=2 * exact) <= first


def test_distance_is_zero_without_asymptotic_stability():
    for A in (jordan(0, 2), oscillator(1), [[1.0]]):
        assert sb.distance_to_instability(A) == 0


def test_distance_scales_with_time():
    A = companion(6, 11, 6)
    d = sb.distance_to_instability(A)
    assert sb.distance_to_instability(1e6 * A) == pytest.approx(1e6 * d, rel=1e-9)
    assert sb.distance_to_instability(1e-9 * A) == pytest.approx(1e-9 * d, rel=1e-9)


# Maps


def test_eigenvalue_map_agrees_with_the_quadratic_formula():
    def matrices(k, c):
        A = np.zeros((*k.shape, 2, 2))
        A[..., 0, 1], A[..., 1, 0], A[..., 1, 1] = 1, -k, -c
        return A

    calls = []
    stiffness, damping = np.linspace(0.5, 5, 7), np.linspace(-1, 6, 5)
    values = sb.eigenvalue_map(lambda *p: calls.append(1) or matrices(*p), stiffness, damping)
    assert len(calls) == 1
    assert values.shape == (7, 5, 2)
    k, c = np.meshgrid(stiffness, damping, indexing="ij")
    root = np.sqrt(c**2 / 4 - k + 0j)
    assert values[..., 0] == pytest.approx(-c / 2 + root)
    assert values[..., 1] == pytest.approx(-c / 2 - root)


def test_eigenvalue_map_explains_a_wrong_shape():
    with pytest.raises(ValueError, match=r"shape \(3, n, n\), got \(2, 2, 3\)"):
        sb.eigenvalue_map(lambda k: np.array([[0 * k, 1 + 0 * k], [-k, -k]]), [1.0, 2, 3])
    grids = [1.0, 2], [1.0, 2, 3], [1.0, 2, 3, 4]
    square = sb.eigenvalue_map(lambda *p: p[2][..., None, None] * np.eye(2), *grids)
    assert square.shape == (2, 3, 4, 2) and np.all(square[..., 3, :] == 4)
    with pytest.raises(ValueError, match=r"shape \(2, 3, 4, n, n\), got \(2, 3, 4, 2, 3\)"):
        sb.eigenvalue_map(lambda *p: np.ones((2, 3, 4, 2, 3)), *grids)
    with pytest.raises(ValueError, match="at least one vector"):
        sb.eigenvalue_map(lambda: np.eye(2))
    with pytest.raises(ValueError, match="finite"):
        sb.eigenvalue_map(lambda k: k[:, None, None] * np.full((2, 2), np.nan), [1.0])


# Bad input


@pytest.mark.parametrize("function", [sb.stability, sb.distance_to_instability])
@pytest.mark.parametrize(
    ("A", "dt", "error", "message"),
    [
        (np.ones((2, 3)), None, ValueError, r"square matrix of shape \(n, n\), got \(2, 3\)"),
        (np.ones(3), None, ValueError, "square"),
        ([[np.nan]], None, ValueError, "finite"),
        ([["a"]], None, TypeError, "numbers"),
        ([[1.0]], -0.1, ValueError, "dt must be at least 0, got -0.1"),
        ([[1.0]], np.nan, ValueError, "dt"),
    ],
)
def test_bad_matrices_are_refused(function, A, dt, error, message):
    with pytest.raises(error, match=message):
        function(A, dt=dt)


def test_bad_systems_are_refused():
    continuous = control.ss([[-1.0]], [[1]], [[1]], [[0]])
    discrete = control.ss([[0.5]], [[1]], [[1]], [[0]], dt=0.1)
    for sys, dt in ((continuous, 0.1), (discrete, 0), (discrete, 0.2)):
        with pytest.raises(ValueError, match="contradicts"):
            sb.stability(sys, dt=dt)
    with pytest.raises(ValueError, match="x0 is required"):
        sb.stability(sb.Pendulum())
    with pytest.raises(sb.NotAnEquilibriumError):
        sb.stability(sb.Pendulum(), x0=[0.3, 0])
    with pytest.raises(ValueError, match="x0"):
        sb.stability(sb.Pendulum(), x0=[0.3, 0, 0])
    with pytest.raises(ValueError, match="a matrix takes neither"):
        sb.stability([[1.0]], x0=[0.0])


@pytest.mark.parametrize("sizes", [(2, 2), (3, 3), (2, 3), (2, 3, 2)])
def test_eigenvalue_map_notices_axes_in_a_wrong_order(sizes):
    """Where sizes agree the shape alone says nothing: matrix axes first, or grids exchanged."""

    def right(*p):
        A = np.zeros((*p[0].shape, 2, 2))
        A[..., 0, 1], A[..., 1, 0], A[..., 1, 1] = 1, -p[0], -p[1]
        return A

    def matrix_first(*p):
        return np.moveaxis(right(*p), (-2, -1), (0, 1))

    grids = [np.arange(1.0, 1 + size) for size in sizes]
    assert sb.eigenvalue_map(right, *grids).shape == (*sizes, 2)
    with pytest.raises(ValueError, match="function must return matrices of shape"):
        sb.eigenvalue_map(matrix_first, *grids)
    if sizes[0] == sizes[1]:
        with pytest.raises(ValueError, match="function must return matrices of shape"):
            sb.eigenvalue_map(lambda *p: right(*p).swapaxes(0, 1), *grids)
    known = right(*np.meshgrid(*grids, indexing="ij"))  # a table is taken at its word
    assert sb.eigenvalue_map(lambda *p: known, *grids).shape == (*sizes, 2)


class Frame:
    """What a data frame offers."""

    def __init__(self, rows):
        self.rows = rows

    def to_numpy(self):
        return np.array(self.rows)


@pytest.mark.parametrize(
    "as_given",
    [
        scipy.sparse.csr_array,
        scipy.sparse.coo_matrix,
        Frame,
        sympy.Matrix,
        lambda rows: np.array(rows, dtype=np.float32),
        lambda rows: [[Fraction(x) for x in row] for row in rows],
        lambda rows: np.array([[Decimal(x) for x in row] for row in rows]),
        lambda rows: np.ma.masked_array(np.array(rows), mask=False),
    ],
)
def test_matrices_of_any_library_are_matrices(as_given):
    A, B, K = [[0.0, 1.0], [-2.0, -3.0]], [[0.0], [1.0]], [[1.0, 2.0]]
    assert sb.stability(as_given(A)).eigenvalues == pytest.approx(np.array([-1, -2]))
    assert sb.distance_to_instability(as_given(A)) == pytest.approx(sb.distance_to_instability(A))
    assert sb.critical_step(as_given(A), "euler") == pytest.approx(1.0)
    expected = sb.critical_sample_time(A, B, K)
    assert sb.critical_sample_time(*map(as_given, (A, B, K))) == pytest.approx(expected)


def test_numbers_are_taken_as_they_were_written():
    """As floats -0.1 and its thrice make no 0.3; constants that vanish are 0."""
    A = [[Decimal("0.1"), 1], [0, Decimal("0.1") + Decimal("0.2") - Decimal("0.3")]]
    report = sb.stability(A, dt=True)
    assert report.verdict == "asymptotically stable" and report.tolerance == 0
    root = sympy.sqrt(2)
    report = sb.stability(sympy.Matrix([[(1 + root) ** 2 - 3 - 2 * root]]))
    assert "0 on the imaginary axis (exactly)" in report.reason
    # Without inputs a plant that is stable stays so, however seldom it is sampled.
    assert sb.critical_sample_time([[-1.0]], np.zeros((1, 0)), np.zeros((0, 1))) == np.inf


def test_what_is_missing_or_no_number_is_refused():
    A = np.ma.masked_array([[-1.0, 0.0], [5.0, -2.0]], mask=[[0, 0], [1, 0]])
    for call in (sb.stability, sb.distance_to_instability):
        with pytest.raises(ValueError, match="no masked entries"):
            call(A)
    for entry in ("-1", None, sympy.Symbol("k"), object()):
        with pytest.raises(TypeError, match="array of numbers"):
            sb.critical_sample_time([[-1.0]], [[1.0]], [[entry]])
    with pytest.raises(ValueError, match=r"beyond 1\.8e308"):
        sb.critical_sample_time([[-1.0]], [[1.0]], [[10**400]])
    with pytest.raises(ValueError, match="finite"):
        sb.stability([[Decimal("nan")]])


def test_a_mode_that_rests_is_not_damped():
    still, decaying = sb.stability([[0.0, 0.0], [0.0, -2.0]]).modes
    assert (still.damping, still.frequency, still.time_constant) == (0, 0, np.inf)
    assert (decaying.damping, decaying.frequency, decaying.time_constant) == (1, 2, 0.5)


@pytest.mark.parametrize("size", [1e-310, 1e-200, 1e200, 1e300])
def test_sizes_near_the_ends_of_double_precision(size):
    """Whatever the unit: squares of entries overflow or vanish, the verdict does not."""
    swing = size * np.array([[0.0, 1.0], [-1.0, 0.0]])
    assert sb.stability(swing).verdict == "marginally stable"
    assert sb.stability(swing).eigenvalues[0].imag == pytest.approx(size, rel=1e-9)
    damped = size * np.array([[0.0, 1.0], [-1.0, -1.0]])
    assert sb.stability(damped).spectral_margin == pytest.approx(size / 2, rel=1e-9)
    distance = sb.distance_to_instability([[0.0, 1.0], [-1.0, -1.0]])
    assert sb.distance_to_instability(damped) == pytest.approx(size * distance, rel=1e-9)
    assert sb.critical_step(damped, "euler") == pytest.approx(1.0 / size, rel=1e-9)


def test_a_defective_eigenvalue_beside_a_shared_one():
    """Semisimple eigenvalues at a point in two blocks, a Jordan block there in a third."""
    A = np.array([[1.0, 0, 0, 0, 0, 0], [0, 0, 1, 1, 1, -2], [1, 0, 0, 0, 0, -1],
                  [-1, -1, 2, 2, 1, -3], [0, 0, 0, 0, 1, -2], [0, 0, 0, 0, 0, -1]])  # fmt: skip
    report = sb.stability(A, dt=True)
    assert report.verdict == sb.stability(A, dt=True, exact=True).verdict == "unstable"


def test_a_map_of_no_function_is_refused():
    with pytest.raises(TypeError, match="function must be callable, got ndarray"):
        sb.eigenvalue_map(np.eye(2), [1.0])
