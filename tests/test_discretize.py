"""Discretizations against python-control, exponentials, exact responses and closed forms."""

from itertools import pairwise

import control
import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

import statebook as sb

METHODS = ["zoh", "foh", "euler", "backward_euler", "tustin"]
NAME_IN_CONTROL = {"backward_euler": "backward_diff"}


def random_system(seed, n=4, m=2, singular=False):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    if singular:
        A[-1] = 0
    B, C, D = (rng.normal(size=shape) for shape in ((n, m), (3, n), (3, m)))
    labels = {
        "states": [f"state {i}" for i in range(n)],
        "inputs": [f"input {i}" for i in range(m)],
        "outputs": ["a", "b", "c"],
    }
    return control.ss(A, B, C, D, name=f"plant{seed}", **labels)


def matrices(sys):
    return [np.asarray(M) for M in (sys.A, sys.B, sys.C, sys.D)]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("singular", [False, True])
@pytest.mark.parametrize("n", [1, 3, 6])
def test_agrees_with_python_control(method, singular, n):
    sys = random_system(n, n=n, singular=singular)
    ours = sb.discretize(sys, 0.3, method)
    theirs = control.sample_system(sys, 0.3, NAME_IN_CONTROL.get(method, method))
    for mine, other in zip(matrices(ours), matrices(theirs), strict=True):
        assert np.abs(mine - other).max() <= 1e-12 * max(1, np.abs(other).max())


def test_prewarping_keeps_the_frequency_response_at_that_frequency():
    sys, omega, dt = random_system(1), 4.0, 0.3
    ours = sb.discretize(sys, dt, "tustin", prewarp=omega)
    assert ours(np.exp(1j * omega * dt)) == pytest.approx(sys(1j * omega), rel=1e-10)
    theirs = control.sample_system(sys, dt, "tustin", prewarp_frequency=omega)
    for mine, other in zip(matrices(ours), matrices(theirs), strict=True):
        assert mine == pytest.approx(other, abs=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_labels_name_and_timebase(method):
    sys = random_system(7)
    ours = sb.discretize(sys, 0.25, method)
    assert ours.dt == 0.25
    assert ours.name == sys.name
    for labels in ("state_labels", "input_labels", "output_labels"):
        assert getattr(ours, labels) == getattr(sys, labels)


def test_linear_models_are_taken_as_they_are():
    ours = sb.discretize(sb.Oscillator(stiffness=4.0), 0.25)
    assert ours.state_labels == ["p", "v"]
    exact = [[np.cos(0.5), np.sin(0.5) / 2], [-2 * np.sin(0.5), np.cos(0.5)]]
    assert pytest.approx(np.array(exact), abs=1e-15) == ours.A


def test_zoh_of_the_double_integrator_is_exact():
    A, B = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]]
    Ad, Bd = sb.discretize_many(A, B, 0.5)
    assert Ad.tolist() == [[1.0, 0.5], [0.0, 1.0]]
    assert Bd.tolist() == [[0.125], [0.5]]


def exact_states(A, B, inputs, dt, per_sample=400):
    """States of x' = A x + B u for an input linear between samples, by exact ramps."""
    x, states = np.zeros(len(A)), []
    for start, end in pairwise(inputs):
        states.append(x)
        slope = (end - start) / dt
        # Exact for a ramp: augment x with u and its slope.
        n, m = B.shape
        block = np.zeros((n + 2 * m, n + 2 * m))
        block[:n, :n], block[:n, n : n + m] = A, B
        block[n : n + m, n + m :] = np.eye(m)
        x = (scipy.linalg.expm(block * dt) @ np.concatenate([x, start, slope]))[:n]
    return np.array([*states, x])


def test_foh_is_exact_for_inputs_linear_between_samples():
    sys, dt = random_system(3), 0.4
    inputs = np.random.default_rng(0).normal(size=(12, 2))
    inputs[0] = 0
    A, B, C, D = matrices(sys)
    expected = exact_states(A, B, inputs, dt) @ C.T + inputs @ D.T
    sampled = sb.discretize(sys, dt, "foh")
    z, outputs = np.zeros(4), []
    for u in inputs:
        outputs.append(sampled.C @ z + sampled.D @ u)
        z = sampled.A @ z + sampled.B @ u
    assert np.array(outputs) == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("method", METHODS)
def test_steady_state_is_kept(method):
    sys = random_system(5)
    A, B, C, D = matrices(sys)
    stable = control.ss(A - 4 * np.eye(4), B, C, D)
    assert sb.discretize(stable, 0.2, method)(1.0) == pytest.approx(stable(0.0), abs=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_stacks_are_discretized_one_by_one(method):
    systems = [random_system(seed, singular=seed % 2 == 0) for seed in range(5)]
    A, B = np.array([s.A for s in systems]), np.array([s.B for s in systems])
    Ad, Bd = sb.discretize_many(A, B, 0.2, method)
    assert Ad.shape == A.shape
    assert Bd.shape == B.shape
    for k, sys in enumerate(systems):
        one = sb.discretize(sys, 0.2, method)
        assert Ad[k] == pytest.approx(one.A, abs=1e-13)
        assert Bd[k] == pytest.approx(one.B, abs=1e-13)
    for empty in sb.discretize_many(np.zeros((0, 2, 2)), np.zeros((0, 2, 1)), 0.2, method):
        assert empty.shape[0] == 0


@pytest.mark.parametrize("method", METHODS)
def test_eigenvalues_go_where_the_map_says(method):
    sys = random_system(2, n=5)
    ours = np.linalg.eigvals(sb.discretize(sys, 0.2, method).A)
    mapped = sb.map_eigenvalues(np.linalg.eigvals(sys.A), 0.2, method)
    assert np.sort_complex(ours.round(10)) == pytest.approx(np.sort_complex(mapped.round(10)))


@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(1e-3, 1))
@settings(max_examples=100, deadline=None)
def test_what_becomes_of_stability(real, imag, dt):
    """Tustin keeps it, Euler gains none, backward Euler loses none."""
    s = complex(real, imag)
    inside = {m: abs(sb.map_eigenvalues(s, dt, m)) < 1 for m in METHODS}
    if real < -1e-6:
        assert inside["zoh"] and inside["tustin"] and inside["backward_euler"]
    if real > 1e-6:
        assert not (inside["zoh"] or inside["tustin"] or inside["euler"])


def test_pole_of_the_map_is_infinite():
    assert np.isinf(sb.map_eigenvalues(2.0, 1.0, "tustin"))
    assert np.isinf(sb.map_eigenvalues([1.0], 1.0, "backward_euler"))[0]


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda s: sb.discretize(s, 0.0), ValueError, "dt must be greater than 0, got 0"),
        (lambda s: sb.discretize(s, -1), ValueError, "dt must be greater than 0"),
        (lambda s: sb.discretize(s, "a"), TypeError, "dt"),
        (lambda s: sb.discretize(s, 0.1, "rk4"), ValueError, "method must be one of"),
        (lambda s: sb.discretize(s, 0.1, prewarp=1.0), ValueError, "tustin"),
        (lambda s: sb.discretize(s, 0.1, "tustin", prewarp=-1), ValueError, "prewarp"),
        (lambda s: sb.discretize(s, 0.1, "tustin", prewarp=40.0), ValueError, "below pi/dt"),
        (lambda s: sb.discretize(sb.discretize(s, 0.1), 0.1), ValueError, "continuous time"),
        (lambda s: sb.discretize(sb.Pendulum(), 0.1), ValueError, "must be linear"),
        (lambda s: sb.discretize(control.tf([1], [1, 1]), 0.1), TypeError, "with control.ss()"),
        (
            lambda s: sb.discretize(control.frd([1.0, 0.5], [1.0, 2.0]), 0.1),
            TypeError,
            "must be fitted",
        ),
        (lambda s: sb.discretize([[1.0]], 0.1), TypeError, "system"),
        (lambda s: sb.discretize_many(np.ones((2, 3)), np.ones((2, 1)), 0.1), ValueError, "A must"),
        (lambda s: sb.discretize_many(np.eye(2), np.ones(2), 0.1), ValueError, "B must have shape"),
        (lambda s: sb.discretize_many([[np.nan]], [[1.0]], 0.1), ValueError, "finite"),
        (
            lambda s: sb.discretize_many([[10.0]], [[1.0]], 0.1, "backward_euler"),
            ValueError,
            "eigen",
        ),
        (lambda s: sb.map_eigenvalues(1.0, 0), ValueError, "dt"),
        (lambda s: sb.map_eigenvalues(np.inf, 1), ValueError, "finite"),
        (lambda s: sb.map_eigenvalues(1.0, 1, "none"), ValueError, "method"),
        (lambda s: sb.critical_sample_time([[1.0]], [[1.0]], [[1.0, 2]]), ValueError, "K must"),
        (lambda s: sb.critical_sample_time(np.eye(2), [[1.0]], [[1.0]]), ValueError, "B must"),
    ],
)
def test_bad_input(call, error, message):
    with pytest.raises(error, match=message):
        call(random_system(0))


# Sampled state feedback

DOUBLE_INTEGRATOR = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]]


@pytest.mark.parametrize("k", [0.5, 4.0, 1e5])
def test_sampled_integrator(k):
    """x_{k+1} = (1 - h k) x_k."""
    assert sb.critical_sample_time([[0.0]], [[1.0]], [[k]]) == pytest.approx(2 / k, rel=1e-12)


@pytest.mark.parametrize(("k1", "k2"), [(1.0, 2.0), (4.0, 1.0), (1.0, 0.2), (1e4, 300.0)])
def test_sampled_double_integrator_by_the_jury_criterion(k1, k2):
    expected = min(2 * k2 / k1, 2 / k2)
    found = sb.critical_sample_time(*DOUBLE_INTEGRATOR, [[k1, k2]])
    assert found == pytest.approx(expected, rel=1e-11)


def test_sampled_first_order_plants():
    """x' = a x + u: the loop is e^{ah} - (e^{ah} - 1) k / a, which is -1 at the limit."""
    assert sb.critical_sample_time([[-1.0]], [[1.0]], [[2.0]]) == pytest.approx(np.log(3))
    assert sb.critical_sample_time([[1.0]], [[1.0]], [[2.0]]) == pytest.approx(np.log(3))
    assert sb.critical_sample_time([[-1.0]], [[1.0]], [[0.5]]) == np.inf
    assert sb.critical_sample_time([[1.0]], [[1.0]], [[0.5]]) == 0
    assert sb.critical_sample_time([[0.0]], [[1.0]], [[0.0]]) == 0


def test_a_weakly_stabilized_plant_beside_a_slow_one():
    """x' = 50 x + u under a gain a little above 50, while exp(50 h) grows without bound."""
    A, B = np.diag([50.0, -1.0]), np.eye(2)
    K = np.diag([50.0 * (1 + 1e-6), 0.0])
    # (1 - (k/a - 1) (e^{a h} - 1)) reaches -1 at e^{a h} = 1 + 2 / (k/a - 1).
    expected = np.log1p(2 / 1e-6) / 50
    assert sb.critical_sample_time(A, B, K) == pytest.approx(expected, rel=1e-7)


def test_sample_time_at_which_modes_alias():
    """At h = pi an oscillator of 1 rad/s cannot be controlled: exp(h A) = -I in its states.

    Around it the loop is stable, so that no crossing gives it away.
    """
    A = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -0.7]]
    B, K = [[0.5], [0.0], [-1.0]], [[0.0, 0.25, 0.1]]

    def radius(h):
        Ad, Bd = sb.discretize_many(A, B, h)
        return np.abs(np.linalg.eigvals(Ad - Bd @ np.array(K))).max()

    assert all(radius(h) < 1 for h in [*np.linspace(0.05, 3.1, 50), 3.18])
    assert radius(np.pi) == pytest.approx(1, abs=1e-12)
    assert sb.critical_sample_time(A, B, K) == pytest.approx(np.pi, rel=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_spectral_radius_is_one_at_the_critical_sample_time(seed):
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(3, 3)), rng.normal(size=(3, 1))
    K = np.asarray(control.lqr(A, B, np.eye(3), np.eye(1))[0])
    h = sb.critical_sample_time(A, B, K)

    def radius(step):
        Ad, Bd = sb.discretize_many(A, B, step)
        return np.abs(np.linalg.eigvals(Ad - Bd @ K)).max()

    if np.isinf(h):
        assert all(radius(step) < 1 for step in np.geomspace(1e-3, 1e3, 100))
    else:
        assert radius(h) == pytest.approx(1, abs=1e-10)
        assert radius(1.0001 * h) > 1
        assert all(radius(step) < 1 for step in np.linspace(0.01, 0.9999, 100) * h)


@pytest.mark.parametrize("method", ["zoh", "foh"])
def test_overflow_is_refused(method):
    with pytest.raises(ValueError, match="dt must be shorter"):
        sb.discretize_many([[1.0]], [[1.0]], 1e4, method)
