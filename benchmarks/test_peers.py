"""The library beside its peers: one job, both in one run, each with its accuracy.

    pip install ".[benchmark,timescale]"
    python benchmarks/page.py      runs this file and writes book/speed.md

A group holds "ours" and its peers. `accuracy` is the error of the result against an exact one;
where that of a peer is another by more than a factor of ten, the page prints no ratio. A peer that
is not installed leaves its row out, and the page names it.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import control
import nbformat
import numpy as np
import pytest
import scipy
from nbformat.v4 import new_code_cell, new_notebook, new_output

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


def known_spectrum(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a matrix that is not normal, and its eigenvalues -1 to -3, evenly spread."""
    rng = np.random.default_rng(n)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    known = -np.linspace(1.0, 3.0, n)
    upper = np.triu(rng.standard_normal((n, n)), 1) / (4 * n)
    return Q @ (np.diag(known) + upper) @ Q.T, known


def away(found: np.ndarray, known: np.ndarray) -> float:
    """Return by how much the eigenvalues are off."""
    return abs(np.sort(np.real(found))[::-1] - known).max()


@pytest.mark.parametrize("n", [4, 100, 300])
@pytest.mark.parametrize("whose", ["ours", "python-control", "numpy, eig", "numpy, eigvals"])
def test_poles(benchmark, n, whose):
    benchmark.group = f"verdict on a matrix, {n:3} states"
    A, known = known_spectrum(n)
    plant = control.ss(A, np.zeros((n, 1)), np.eye(n), 0)
    jobs = {
        "ours": lambda: sb.stability(A).eigenvalues,
        "python-control": lambda: control.poles(plant),
        "numpy, eig": lambda: np.linalg.eig(A)[0],
        "numpy, eigvals": lambda: np.linalg.eigvals(A),
    }
    noted(benchmark, away(benchmark(jobs[whose]), known), "")


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
    benchmark.group = f"simulate pendulums for 10 s, N = {N}"
    if whose != "ours" and N == 1000:
        pytest.skip("a loop over 1000 takes ten times that over 100")
    x0 = np.stack([np.linspace(0.2, 1.5, N) - np.pi / 2, np.zeros(N)])
    ours = whose == "ours"
    tight = {"rtol": 1e-8 if ours or N == 1 else 1e-9, "atol": 1e-10}  # in the end as exact
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

    def draw() -> Any:
        _, ax = plt.subplots()
        if whose == "ours":
            sb.plotting.flow(FREE, box[:2], box[2:], ax=ax)
        else:
            control.phase_plane_plot(plant, box, 10, plot_streamlines=True, ax=ax)
        plt.close()
        return ax

    ax = benchmark.pedantic(draw, rounds=3, warmup_rounds=1)
    drawn = [line for lines in ax.collections for line in lines.get_segments()]
    drawn += [line.get_xydata() for line in ax.lines]
    middle = np.concatenate([(line[1:] + line[:-1]) / 2 for line in drawn]).T
    along = np.concatenate([np.diff(line, axis=0) for line in drawn]).T
    field = np.stack(free(0.0, middle))
    across = abs(along[0] * field[1] - along[1] * field[0])
    noted(benchmark, np.median(across / (np.hypot(*along) * np.hypot(*field) + 1e-300)), "")


# ---- time scaling ----


def random_path(points: int) -> tuple[np.ndarray, scipy.interpolate.CubicSpline]:
    """Return the knots and a spline of 7 joints through points at random."""
    rng = np.random.default_rng(points)
    waypoints = np.cumsum(rng.uniform(-0.4, 0.4, (7, points)), axis=1)
    s = np.linspace(0, points / 4, points)
    return s, scipy.interpolate.CubicSpline(s, waypoints.T)


V, A = np.tile([-1.0, 1.0], (7, 1)), np.tile([-4.0, 4.0], (7, 1))


def by_us(s: np.ndarray, spline: Any) -> Any:
    path = sb.Path(spline)
    return lambda: sb.time_scale(path, V, A)


def by_toppra(s: np.ndarray, spline: Any, grid: Any = None, kind: str = "ParametrizeSpline") -> Any:
    """Return the job of the package toppra, on its own grid unless there is one."""
    toppra = pytest.importorskip("toppra")
    constraint = pytest.importorskip("toppra.constraint")
    path = toppra.SplineInterpolator(s, spline(s))
    limits = [constraint.JointVelocityConstraint(V), constraint.JointAccelerationConstraint(A)]
    options = {"gridpoints": grid, "parametrizer": kind}
    return lambda: toppra.algorithm.TOPPRA(limits, path, **options).compute_trajectory(0, 0)


def by_drake(s: np.ndarray, spline: Any, grid: np.ndarray | None = None) -> Any:
    """Return the job of Drake's TOPP-RA: seven sliders, on its own grid unless there is one."""
    pytest.importorskip("pydrake", reason="Drake is not installed")
    from pydrake.multibody.optimization import CalcGridPointsOptions, Toppra
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import PrismaticJoint, SpatialInertia
    from pydrake.trajectories import PiecewisePolynomial

    plant = MultibodyPlant(0.0)
    unit = SpatialInertia.SolidCubeWithDensity(1.0, 1.0)
    for i in range(7):
        body = plant.AddRigidBody(f"link {i}", unit)
        fixed, moving = plant.world_frame(), body.body_frame()
        joint = PrismaticJoint(f"joint {i}", fixed, moving, [1.0, 0.0, 0.0])
        plant.AddJoint(joint)
    plant.Finalize()
    path = PiecewisePolynomial.CubicHermite(s, spline(s).T, spline(s, 1).T)

    def job() -> Any:
        own = Toppra.CalcGridPoints(path, CalcGridPointsOptions()) if grid is None else grid
        problem = Toppra(path, plant, own)
        problem.AddJointVelocityLimit(*V.T)
        problem.AddJointAccelerationLimit(*A.T)
        scaling = problem.SolvePathParameterization()
        return scaling and Drake(path, scaling)

    return job


class Drake:
    """What Drake found, called as toppra's trajectory is."""

    def __init__(self, path: Any, scaling: Any) -> None:
        self.path, self.scaling = path, scaling
        self.duration = scaling.end_time()

    def __call__(self, t: np.ndarray, order: int) -> np.ndarray:
        s, sdot, sddot = (self.scaling.derivative(k).vector_values(t)[0] for k in range(3))
        first = self.path.derivative(1).vector_values(s)
        if order == 1:
            return (first * sdot).T
        return (self.path.derivative(2).vector_values(s) * sdot**2 + first * sddot).T


WHO = {
    "ours": by_us,
    "toppra, its own grid": by_toppra,
    "toppra, 1000 points": lambda s, q: by_toppra(s, q, np.linspace(0, s[-1], 1001)),
    "toppra, 300 points a waypoint": lambda s, q: by_toppra(
        s, q, np.linspace(0, s[-1], 300 * len(s) + 1), "ParametrizeConstAccel"
    ),
    "Drake, its own grid": by_drake,
    "Drake, 1000 points": lambda s, q: by_drake(s, q, np.linspace(0, s[-1], 1001)),
}


@pytest.mark.filterwarnings("ignore:tolerance")  # as near as it comes
@pytest.mark.parametrize("points", [10, 100])
@pytest.mark.parametrize("whose", WHO)
def test_time_scaling(benchmark, points, whose):
    """Accuracy here is the worse of the limits exceeded and the time lost, as a share."""
    pytest.importorskip("toppra")
    s, spline = random_path(points)
    benchmark.group = f"time a 7-joint spline of {points:3} waypoints"
    found = benchmark.pedantic(WHO[whose](s, spline), rounds=2, warmup_rounds=0)
    if found is None:
        return noted(benchmark, np.inf, f"{points} waypoints")
    best = sb.time_scale(sb.Path(spline), V, A, tolerance=1e-4).duration
    error = max(exceeded(found), found.duration / best - 1, 0.0)
    noted(benchmark, error, f"{points} waypoints")


def exceeded(found: Any) -> float:
    """Return by what share a motion exceeds its limits, at 200,000 samples."""
    from time_scaling_verify import dense_violation

    motion = (lambda t: found(t, 1).T), (lambda t: found(t, 2).T)
    if hasattr(found, "velocity"):
        motion = found.velocity, found.acceleration
    return dense_violation(motion, found.duration, V, A)


# ---- notebooks ----


def written(folder: Path, cells: int, fault: str = "") -> Path:
    """Write a notebook with outputs that are right, but for a fault in the last."""
    codes = [new_code_cell(f"print({k}, 'is', {k} ** 2)") for k in range(cells)]
    for k, cell in enumerate(codes):
        cell.execution_count = k + 1
        text = f"{k} is {k**2}{fault if k == cells - 1 else ''}\n"
        cell.outputs = [new_output("stream", name="stdout", text=text)]
    path = folder / f"cells_{cells}{fault}.ipynb"
    nbformat.write(new_notebook(cells=codes), path)
    return path


TESTED = {"ours": ["--nb"], "nbval": ["--nbval", "--nbval-current-env"], "nbmake": ["--nbmake"]}


def judged(whose: str, path: Path) -> int:
    """Test a notebook; return pytest's exit code."""
    options = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:benchmark"]
    command = [sys.executable, "-m", "pytest", *options, *TESTED[whose], str(path)]
    return subprocess.run(command, cwd=path.parent, capture_output=True).returncode


@pytest.mark.parametrize("cells", [10, 300])
@pytest.mark.parametrize("whose", TESTED)
def test_notebook(benchmark, cells, whose, tmp_path):
    """Accuracy here is 1 for who does not see that a stored output is another."""
    if whose != "ours":
        pytest.importorskip(whose)
    benchmark.group = f"test a notebook of {cells:3} cells"
    right = written(tmp_path, cells)
    code = benchmark.pedantic(lambda: judged(whose, right), rounds=1, warmup_rounds=0)
    assert code == 0
    missed = judged(whose, written(tmp_path, 10, "5")) == 0
    noted(benchmark, float(missed), f"{cells} cells")


# ---- compiled limits ----


@pytest.mark.benchmark(group="simulate pendulums for 10 s, N = 1000")
def test_batch_heyoka(benchmark):
    heyoka = pytest.importorskip("heyoka")
    x, v = heyoka.make_vars("x", "v")
    equations = [(x, v), (v, -g / L * heyoka.cos(x))]
    integrator = heyoka.taylor_adaptive(equations, [0.0, 0.0], tol=1e-7)
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


# ---- growth ----


@pytest.mark.parametrize("size", [1, 10, 100, 1000, 10_000, 100_000, 1_000_000])
def test_growth_batch(benchmark, size):
    benchmark.group = "growth: pendulums simulated together for 10 s"
    x0 = np.stack([np.linspace(0.2, 1.5, size) - np.pi / 2, np.zeros(size)])
    times = TIMES[::20]
    job = lambda: sb.simulate(FREE, x0, times=times, rtol=1e-8, atol=1e-10).states  # noqa: E731
    found = benchmark.pedantic(job, rounds=1 + (size < 10_000), warmup_rounds=size < 10_000)
    exact = np.stack([swing_exact(angle, times) for angle in x0[0, ::97] + np.pi / 2])
    noted(benchmark, abs(found[0, ::97] + np.pi / 2 - exact).max(), size)


def chain(n: int) -> tuple[Any, np.ndarray]:
    """Return n/2 pendulums hanging in a row, joined by springs, and their matrix at rest."""
    half = n // 2
    springs = -2 * np.eye(half) + np.eye(half, k=1) + np.eye(half, k=-1)

    def f(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        pull = springs @ x[:half]
        return np.concatenate([x[half:], pull - np.sin(x[:half]) + u[0]])

    zero, one = np.zeros((half, half)), np.eye(half)
    return f, np.block([[zero, one], [springs - one, zero]])


@pytest.mark.parametrize("size", [4, 10, 30, 100, 300, 1000])
def test_growth_verdict(benchmark, size):
    benchmark.group = "growth: verdict on a matrix, by states"
    A, known = known_spectrum(size)
    rounds = 20 if size < 100 else 1
    found = benchmark.pedantic(lambda: sb.stability(A), rounds=rounds, warmup_rounds=size < 300)
    noted(benchmark, away(found.eigenvalues, known), size)


@pytest.mark.parametrize("size", [2, 6, 20, 60, 200, 600, 2000])
@pytest.mark.parametrize("what", ["linearize", "simulate"])
def test_growth_states(benchmark, size, what):
    benchmark.group = f"growth: {what} pendulums in a chain, by states"
    f, known = chain(size)
    x0 = np.zeros(size)
    if what == "linearize":
        job = lambda: sb.linearize(f, x0, [0.0]).A  # noqa: E731
        again = size < 600
        found = benchmark.pedantic(job, rounds=1 + again, warmup_rounds=again)
        error = abs(found - known).max()
    else:
        x0[0] = 1e-6  # so small that it is linear
        job = lambda: sb.simulate(f, x0, [0.0], duration=10.0, atol=1e-16).states  # noqa: E731
        found = benchmark.pedantic(job, rounds=2, warmup_rounds=1)[:, -1]
        error = abs(found - scipy.linalg.expm(10.0 * known) @ x0).max() / 1e-6
    noted(benchmark, error, size)


@pytest.mark.filterwarnings("ignore:tolerance")
@pytest.mark.parametrize("size", [2, 5, 20, 80, 320, 1280, 5120])
def test_growth_waypoints(benchmark, size):
    pytest.importorskip("toppra")
    benchmark.group = "growth: time a 7-joint spline, by waypoints"
    found = benchmark.pedantic(by_us(*random_path(size)), rounds=1, warmup_rounds=0)
    noted(benchmark, max(exceeded(found), found.gap, 0.0), size)


@pytest.mark.parametrize("size", [1, 10, 100, 1000])
def test_growth_cells(benchmark, size, tmp_path):
    benchmark.group = "growth: test a notebook, by cells"
    path = written(tmp_path, size)
    code = benchmark.pedantic(lambda: judged("ours", path), rounds=1, warmup_rounds=0)
    noted(benchmark, float(code != 0), size)
