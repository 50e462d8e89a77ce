"""The library beside its peers: one job, both in one run, each with its accuracy.

    pip install ".[benchmark]"
    pytest benchmarks/test_peers.py --benchmark-json=_build/peers.json
    python benchmarks/page.py _build/peers.json      writes book/speed.md

A group holds "ours" and its peers. `accuracy` is the error of the result against an exact one;
where that of a peer is another by more than a factor of ten, the page prints no ratio. A peer that
is not installed leaves its row out.
"""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest
import scipy

import statebook as sb

g, L = 9.8, 1.3
PENDULUM = sb.Pendulum(m=1.0, L=L, g=g, damping=0.2)
CART_POLE = sb.CartPole()
TIMES = np.linspace(0.0, 10.0, 201)


def noted(benchmark: Any, accuracy: float, size: str) -> None:
    """Keep how exact a result is, and how large the job."""
    benchmark.extra_info.update(accuracy=float(accuracy), size=size)


def rates(t: float, x: np.ndarray, u: np.ndarray, params: dict[str, Any]) -> list[float]:
    """Return the pendulum's rates, as python-control calls it."""
    damping = PENDULUM.damping * x[1]
    return [x[1], (u[0] - damping) / L**2 - g / L * np.cos(x[0])]


SYSTEM = control.nlsys(rates, None, inputs=1, outputs=["a", "b"], states=["a", "b"], name="plant")
UPRIGHT = np.array([[0.0, 1.0], [g / L, -PENDULUM.damping / L**2]])


# ---- linearize ----


@pytest.mark.benchmark(group="linearize, 2 states")
def test_linearize_ours(benchmark):
    found = benchmark(lambda: sb.linearize(PENDULUM, [np.pi / 2, 0.0]))
    noted(benchmark, abs(found.A - UPRIGHT).max(), "")


@pytest.mark.benchmark(group="linearize, 2 states")
def test_linearize_python_control(benchmark):
    found = benchmark(lambda: control.linearize(SYSTEM, [np.pi / 2, 0.0], [0.0]))
    noted(benchmark, abs(found.A - UPRIGHT).max(), "")


# ---- eigenvalues ----


@pytest.mark.parametrize("n", [4, 30, 200])
@pytest.mark.parametrize("whose", ["ours", "python-control", "numpy"])
def test_poles(benchmark, n, whose):
    benchmark.group = f"verdict on a matrix, {n} states"
    rng = np.random.default_rng(n)
    T = np.linalg.qr(rng.standard_normal((n, n)))[0]
    known = -np.arange(1.0, n + 1)
    A = T @ np.diag(known) @ T.T
    plant = control.ss(A, np.zeros((n, 1)), np.eye(n), 0)
    jobs = {
        "ours": lambda: sb.stability(A).eigenvalues,
        "python-control": lambda: control.poles(plant),
        "numpy": lambda: np.linalg.eigvals(A),
    }
    found = benchmark(jobs[whose])
    noted(benchmark, abs(np.sort(np.real(found))[::-1] - known).max() / n, "")


# ---- discretize ----


@pytest.mark.parametrize("whose", ["ours", "python-control"])
def test_discretize(benchmark, whose):
    benchmark.group = "discretize, zero-order hold"
    plant = control.ss([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], np.eye(2), 0)
    jobs = {
        "ours": lambda: sb.discretize(plant, 0.1),
        "python-control": lambda: control.sample_system(plant, 0.1),
    }
    found = benchmark(jobs[whose])
    noted(benchmark, abs(found.B - [[0.005], [0.1]]).max(), "")


# ---- simulate ----


def swing_exact(x0: float, times: np.ndarray) -> np.ndarray:
    """Return the angle from hanging of a frictionless pendulum let go at x0."""
    k = np.sin(x0 / 2)
    quarter = scipy.special.ellipk(k**2)
    sn = scipy.special.ellipj(quarter - np.sqrt(g / L) * times, k**2)[0]
    return 2 * np.arcsin(k * sn)


FREE = sb.Pendulum(m=1.0, L=L, g=g, damping=0.0)


def free(t: float, x: np.ndarray) -> list[float]:
    return [x[1], -g / L * np.cos(x[0])]


@pytest.mark.parametrize("whose", ["ours", "python-control", "scipy"])
def test_simulate(benchmark, whose):
    benchmark.group = "simulate a pendulum for 10 s"
    x0 = [1.0 - np.pi / 2, 0.0]
    plant = control.nlsys(lambda t, x, u, params: free(t, x), None, states=2, inputs=1, outputs=2)
    tight = {"rtol": 1e-8, "atol": 1e-10}
    span = (0.0, TIMES[-1])
    respond = control.input_output_response
    jobs = {
        "ours": lambda: sb.simulate(FREE, x0, times=TIMES, **tight).states,
        "python-control": lambda: respond(plant, TIMES, 0, x0, solve_ivp_kwargs=tight).states,
        "scipy": lambda: scipy.integrate.solve_ivp(free, span, x0, t_eval=TIMES, **tight).y,
    }
    found = benchmark(jobs[whose])
    noted(benchmark, abs(found[0] + np.pi / 2 - swing_exact(1.0, TIMES)).max(), "")


def braked(x: np.ndarray, t: float) -> np.ndarray:
    return -2 * x[1:]


@pytest.mark.parametrize("whose", ["ours", "python-control", "scipy"])
def test_simulate_under_a_policy(benchmark, whose):
    """One model, one policy, no step longer than an output interval."""
    benchmark.group = "simulate a pendulum under a policy for 10 s"
    x0, span, solve = [1.0 - np.pi / 2, 0.0], (0.0, TIMES[-1]), scipy.integrate.solve_ivp
    tight = {"rtol": 1e-8, "atol": 1e-10}
    bounded = {**tight, "max_step": TIMES[1]}

    def closed(t: float, x: np.ndarray, *rest: Any) -> np.ndarray:
        return PENDULUM.rate(x, braked(x, t))

    plant = control.nlsys(closed, None, states=2, inputs=1, outputs=2)
    respond = control.input_output_response
    jobs = {
        "ours": lambda: sb.simulate(PENDULUM, x0, braked, times=TIMES, **tight).states,
        "python-control": lambda: respond(plant, TIMES, 0, x0, solve_ivp_kwargs=bounded).states,
        "scipy": lambda: solve(closed, span, x0, t_eval=TIMES, **bounded).y,
    }
    exact = solve(closed, span, x0, t_eval=TIMES, method="DOP853", rtol=1e-13, atol=1e-13).y
    found = benchmark(jobs[whose])
    noted(benchmark, abs(found[0] - exact[0]).max(), "")


@pytest.mark.parametrize("N", [1, 10, 100, 1000])
@pytest.mark.parametrize("whose", ["ours", "scipy", "numba"])
def test_batch(benchmark, N, whose):
    benchmark.group = f"simulate {N} pendulums for 10 s"
    x0 = np.stack([np.linspace(0.2, 1.5, N) - np.pi / 2, np.zeros(N)])
    tight = {"rtol": 1e-8, "atol": 1e-10}
    span = (0.0, TIMES[-1])
    rate = free
    if whose == "numba":
        numba = pytest.importorskip("numba")

        @numba.njit
        def rate(t: float, x: np.ndarray) -> np.ndarray:
            return np.array([x[1], -g / L * np.cos(x[0])])

        rate(0.0, x0[:, 0])

    def loop() -> np.ndarray:
        solve = scipy.integrate.solve_ivp
        return np.stack([solve(rate, span, x, t_eval=TIMES, **tight).y for x in x0.T], axis=1)

    ours = whose == "ours"
    job = (lambda: sb.simulate(FREE, x0, times=TIMES, **tight).states) if ours else loop
    found = benchmark.pedantic(job, rounds=3 if N < 1000 else 1, warmup_rounds=0)
    exact = np.stack([swing_exact(angle, TIMES) for angle in x0[0] + np.pi / 2])
    noted(benchmark, abs(found[0] + np.pi / 2 - exact).max(), f"{N} starts")


# ---- pictures ----


@pytest.mark.parametrize("whose", ["ours", "python-control"])
def test_flow(benchmark, whose):
    benchmark.group = "draw a phase plane"
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    box = [-3, 3, -3, 3]
    plant = control.nlsys(lambda t, x, u, params: free(t, x), None, states=2, inputs=0, outputs=2)

    def ours() -> None:
        _, ax = plt.subplots()
        sb.plotting.flow(FREE, box[:2], box[2:], ax=ax)
        plt.close()

    def peer() -> None:
        _, ax = plt.subplots()
        control.phase_plane_plot(plant, box, 10, plot_streamlines=True, ax=ax)
        plt.close()

    benchmark.pedantic(ours if whose == "ours" else peer, rounds=3, warmup_rounds=1)
    noted(benchmark, 0.0, "")


# ---- time scaling ----


@pytest.mark.filterwarnings("ignore:tolerance")  # as near as it comes
@pytest.mark.parametrize("points", [10, 100])
@pytest.mark.parametrize("whose", ["ours", "toppra, its own grid", "toppra, 1000 points"])
def test_time_scaling(benchmark, points, whose):
    """Accuracy here is the worse of the limits exceeded and the time lost, as a share."""
    toppra = pytest.importorskip("toppra")
    constraint = pytest.importorskip("toppra.constraint")
    from time_scaling_verify import dense_violation

    benchmark.group = f"time a 7-joint spline of {points} waypoints"
    rng = np.random.default_rng(points)
    waypoints = np.cumsum(rng.uniform(-0.4, 0.4, (7, points)), axis=1)
    v, a = np.tile([-1.0, 1.0], (7, 1)), np.tile([-4.0, 4.0], (7, 1))
    s = np.linspace(0, points / 4, points)
    path = sb.Path(scipy.interpolate.CubicSpline(s, waypoints.T))
    spline = toppra.SplineInterpolator(s, waypoints.T)
    limits = [
        constraint.JointVelocityConstraint(v),
        constraint.JointAccelerationConstraint(a),
    ]

    def ours() -> Any:
        return sb.time_scale(path, v, a)

    def raw() -> Any:
        grid = None if "own" in whose else np.linspace(0, s[-1], 1001)
        return toppra.algorithm.TOPPRA(limits, spline, gridpoints=grid).compute_trajectory(0, 0)

    found = benchmark.pedantic(ours if whose == "ours" else raw, rounds=2, warmup_rounds=0)
    if found is None:
        pytest.skip("TOPP-RA finds nothing")
    if whose == "ours":
        motion = found.velocity, found.acceleration
    else:
        motion = (lambda t: found(t, 1).T), (lambda t: found(t, 2).T)
    exceeded = dense_violation(motion, found.duration, v, a)
    best = sb.time_scale(path, v, a, tolerance=1e-4).duration
    noted(benchmark, max(exceeded, found.duration / best - 1, 0.0), f"{points} waypoints")


# ---- compiled limits ----


@pytest.mark.benchmark(group="simulate 1000 pendulums for 10 s")
def test_batch_heyoka(benchmark):
    heyoka = pytest.importorskip("heyoka")
    x, v = heyoka.make_vars("x", "v")
    equations = [(x, v), (v, -g / L * heyoka.cos(x))]
    integrator = heyoka.taylor_adaptive(equations, [0.0, 0.0], tol=1e-9)
    starts = np.linspace(0.2, 1.5, 1000) - np.pi / 2

    def loop() -> np.ndarray:
        ends = []
        for start in starts:
            integrator.time = 0.0
            integrator.state[:] = [start, 0.0]
            ends.append(integrator.propagate_grid(TIMES)[5][:, 0])
        return np.array(ends)

    found = benchmark.pedantic(loop, rounds=1, warmup_rounds=0)
    exact = np.stack([swing_exact(angle, TIMES) for angle in starts + np.pi / 2])
    noted(benchmark, abs(found + np.pi / 2 - exact).max(), "1000 starts")
