"""Critical sample times against closed forms and fine scans: no window is stepped over."""

import control
import numpy as np
import pytest
import scipy

import statebook as sb


def spring(omega, zeta):
    return np.array([[0.0, 1.0], [-(omega**2), -2 * zeta * omega]]), np.array([[0.0], [1.0]])


def radius(A, B, K, h):
    Ad, Bd = sb.discretize_many(A, B, h)
    return np.abs(np.linalg.eigvals(Ad - Bd @ np.atleast_2d(K))).max()


def scanned(A, B, K, end, number=20_000):
    """Sample times of growth among multiples of end / number, by powers of one exponential."""
    n, m = B.shape
    step = scipy.linalg.expm(np.block([[A, B], [np.zeros((m, n + m))]]) * (end / number))
    power, loops = np.eye(n + m), []
    for _ in range(number):
        power = power @ step
        loops.append(power[:n, :n] - power[:n, n:] @ K)
    grows = np.abs(np.linalg.eigvals(np.array(loops))).max(axis=1) > 1 + 1e-9
    return (1 + np.flatnonzero(grows)) * end / number


def test_a_window_of_growth_near_half_a_period():
    A, B, K = [[0, 1], [-100, -0.2]], [[0], [1]], [[0, 0.5]]
    found = sb.critical_sample_time(A, B, K)
    assert found == pytest.approx(0.305222101, abs=1e-9)
    assert radius(A, B, K, found) == pytest.approx(1, abs=1e-12)
    assert radius(A, B, K, 0.31) > 1 > radius(A, B, K, 0.3132)


@pytest.mark.parametrize("omega", [1e-6, 10.0, 1e6])
@pytest.mark.parametrize("gain", [0.4002, 0.41, 0.5, 1.0, 5.0])
def test_windows_however_narrow(omega, gain):
    """The loop reaches -1 where det(I + M) = 0; below a gain of about 0.4 it never does."""
    zeta = 0.01
    A, B = spring(omega, zeta)
    K = np.array([[0.0, gain * omega / 10]])
    found = sb.critical_sample_time(A, B, K)

    def at_minus_one(h):
        Ad, Bd = sb.discretize_many(A, B, h)
        return np.linalg.det(np.eye(2) + Ad - Bd @ K)

    times = np.linspace(0.01, 3.2, 4000) / omega
    values = np.array([at_minus_one(h) for h in times])
    lowest = times[np.argmin(values)]
    bottom = scipy.optimize.minimize_scalar(
        at_minus_one, bounds=(lowest - 2e-3 / omega, lowest + 2e-3 / omega), method="bounded",
        options={"xatol": 1e-12 / omega},
    )  # fmt: skip
    if bottom.fun > 0:
        assert found > 4 / omega
    else:
        crossing = scipy.optimize.brentq(at_minus_one, 0.5 * bottom.x, bottom.x, xtol=1e-16 / omega)
        assert found == pytest.approx(crossing, rel=1e-7 if bottom.fun > -1e-6 else 1e-9)


@pytest.mark.parametrize("seed", range(16))
def test_no_growth_before_the_first_crossing(seed):
    rng = np.random.default_rng(seed)
    if seed % 2:
        n, m = int(rng.integers(2, 5)), int(rng.integers(1, 3))
        A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
        K = np.asarray(control.lqr(A, B, np.eye(n), np.eye(m))[0])
    else:  # two springs, the second driven by the first, and any gain that is stable
        parts = [spring(rng.uniform(1, 12), 10 ** rng.uniform(-2.5, -1))[0] for _ in range(2)]
        A = scipy.linalg.block_diag(*parts)
        A[3, 0], B = 1.0, np.eye(4)[:, [1]]
        K = 0.3 * rng.normal(size=(1, 4))
        K[0, 1] = abs(K[0, 1])
    found = sb.critical_sample_time(A, B, K)
    end = 1.1 * found if 0 < found < np.inf else 20.0
    growth = scanned(A, B, K, end)
    if found == 0:
        assert np.linalg.eigvals(A - B @ K).real.max() >= 0
    elif np.isinf(found):
        assert len(growth) == 0
    else:
        assert np.all(growth > found * (1 - 1e-9)) and len(growth) > 0
        assert radius(A, B, K, found) == pytest.approx(1, abs=1e-9)


def test_a_complex_plant_is_its_real_and_imaginary_parts():
    a, k = -0.1 + 5j, 0.8
    found = sb.critical_sample_time([[a]], [[1.0]], [[k]])
    A = np.array([[a.real, -a.imag], [a.imag, a.real]])
    assert found == pytest.approx(sb.critical_sample_time(A, np.eye(2), k * np.eye(2)), rel=1e-9)
    assert abs(np.exp(a * found) - (np.exp(a * found) - 1) / a * k) == pytest.approx(1, abs=1e-12)


def test_loops_side_by_side_are_as_good_as_the_worst():
    """Their product turns so fast that a first piece must be halved, and again."""
    omegas, gains = np.linspace(0.95, 1.05, 8), np.linspace(0.6, 0.2, 8)
    plants = [spring(omega, 0.01) for omega in omegas]
    laws = [[[0.0, gain]] for gain in gains]
    each = [sb.critical_sample_time(A, B, K) for (A, B), K in zip(plants, laws, strict=True)]
    A, B, K = (scipy.linalg.block_diag(*parts) for parts in (*zip(*plants, strict=True), laws))
    assert sb.critical_sample_time(A, B, K) == pytest.approx(min(each), rel=1e-12)


def test_nearly_equal_modes_held_by_huge_gains():
    """Rounding of the loop's eigenvalues is that of the gains, here 6e3 and opposed."""
    A = scipy.linalg.block_diag(
        *[[[0, 1], [-k, 0]] for k in (5.811953883463402, 5.804792243810796)]
    )
    B = np.array(
        [[0.4219694947780549, 0.25016244798431597, -0.19644155767581964, 0.6818941030932071]]
    ).T
    K = [[3221.205176778769, 1635.9863982191964, 6086.939824996569, -836.6303587156857]]
    found = sb.critical_sample_time(A, B, K)
    assert radius(A, B, K, found) == pytest.approx(1, abs=1e-9)
    assert all(radius(A, B, K, h) < 1 for h in np.linspace(0.01, found - 1e-6, 200))
    assert radius(A, B, K, found + 1e-6) > 1


def test_where_modes_alias_the_loop_reaches_the_circle_there():
    """At half the period of an undamped mode sampling loses controllability: -1 whatever K is."""
    A = np.array([[0.0, 1.0, 0.0], [-8.0, 0.0, 1.0], [0.0, 0.0, -1.9]])
    B = np.array([[0.386], [-0.582], [0.109]])
    found = sb.critical_sample_time(A, B, [[2.55, 1.89, -1.7]])
    assert found == pytest.approx(np.pi / 8**0.5, rel=1e-13)


def test_systems_are_taken_as_stability_takes_them():
    A, B = spring(10.0, 0.01)
    K = [[0.0, 0.5]]
    expected = sb.critical_sample_time(A, B, K)
    plant = control.ss(A, B, np.eye(2), np.zeros((2, 1)))
    assert sb.critical_sample_time(plant, K=K) == expected

    def pulled(x, u):
        return [x[1], u[0] - 100 * np.sin(x[0]) - 0.2 * x[1]]

    found = sb.critical_sample_time(pulled, K=K, x0=[0.0, 0.0], u0=[0.0])
    assert found == pytest.approx(expected, rel=1e-9)
    model = sb.Oscillator(stiffness=100.0, damping=0.2)
    h = sb.critical_step(A, "rk4")
    assert sb.critical_step(plant, "rk4") == h
    assert sb.critical_step(model, "rk4") == pytest.approx(h, rel=1e-12)
    assert sb.critical_step(pulled, "rk4", [0.0, 0.0], [0.0]) == pytest.approx(h, rel=1e-9)
    distance = sb.distance_to_instability(A)
    assert sb.distance_to_instability(plant) == distance
    assert sb.distance_to_instability(pulled, [0, 0], [0]) == pytest.approx(distance, rel=1e-9)
    sampled = control.ss([[0.5]], [[1]], [[1]], [[0]], dt=0.1)
    assert sb.distance_to_instability(sampled) == 0.5


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: sb.critical_sample_time([[1.0]], K=[[1.0]]), "B is required"),
        (lambda s: sb.critical_sample_time([[1.0]], [[1.0]]), "K is required"),
        (
            lambda s: sb.critical_sample_time(control.ss(s.A, s.B, s.C, s.D), [[1.0]], [[1.0]]),
            "a system has its own",
        ),
        (lambda s: sb.critical_sample_time(s, K=[[1.0]]), "continuous time, got .* dt = 0.1"),
        (lambda s: sb.critical_step(s, "euler"), "continuous time, got .* dt = 0.1"),
        (lambda s: sb.critical_step(sb.Pendulum(), "euler"), "x0 is required"),
        (lambda s: sb.critical_step([[1.0]], "euler", [0.0]), "a matrix takes neither"),
        (lambda s: sb.distance_to_instability(s, dt=0.2), "contradicts"),
        (lambda s: sb.distance_to_instability([[1.0]], [0.0]), "a matrix takes neither"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call(control.ss([[0.5]], [[1]], [[1]], [[0]], dt=0.1))
