"""Equilibria side by side: which are stable, along which the state drifts, and which are alone."""

import numpy as np
import pytest

import statebook as sb

DRIFTS, ALONG = "drifts along", "stable, along a family of dimension "


def cart(friction):
    return lambda x, u: [x[1], (u[0] - friction * x[1]) / 2.0]


def satellite(damping):
    """Euler's angles and rates of a rigid body of moments 1, 2 and 3."""

    def f(x):
        roll, pitch, _, p, q, r = x
        turn = q * np.sin(roll) + r * np.cos(roll)
        rates = [
            p + np.tan(pitch) * turn,
            q * np.cos(roll) - r * np.sin(roll),
            turn / np.cos(pitch),
        ]
        return np.array([*rates, -q * r, r * p, -p * q / 3]) - damping * np.array(
            [0, 0, 0, p, q, r]
        )

    return f


def quaternion(damping):
    def f(x):
        w, x_, y, z, p, q, r = x
        turn = [-x_ * p - y * q - z * r, w * p + y * r - z * q, w * q + z * p - x_ * r]
        turn.append(w * r + x_ * q - y * p)
        rates = np.array([-q * r, r * p, -p * q / 3]) - damping * np.array([p, q, r])
        return np.concatenate([np.array(turn) / 2, rates])

    return f


def quadrotor(x, u, m=0.5, inertia=0.01, g=9.81):
    """In a vertical plane; u is the thrust beyond its weight, and the torque."""
    lean, lift = x[2], u[0] / m
    climb = g * (np.cos(lean) - 1) + lift * np.cos(lean)
    return [*x[3:], -(g + lift) * np.sin(lean), climb, u[1] / inertia]


def levelled(x):
    """Thrust damps the climb; the torque levels the body and leans it against its drift."""
    return quadrotor(x, [-x[4], -0.05 * (x[2] - 0.02 * x[3]) - 0.05 * x[5]])


def epidemic(x):
    return [-0.3 * x[0] * x[1], 0.3 * x[0] * x[1] - 0.5 * x[1]]


@pytest.mark.parametrize(
    ("f", "x0", "u0", "dimension"),
    [
        (cart(0.5), [0.0, 0.0], [0.0], 1),
        (cart(0.5), [3.0, 0.0], [0.0], 1),
        (cart(0.5), [3e-9, 0.0], [0.0], 1),
        (lambda x, u: [x[1], u[0] - x[1] - x[1] ** 3], [1e4, 0.0], [0.0], 1),
        (satellite(0.3), np.zeros(6), None, 3),
        (satellite(0.3), [0.3, 0.2, 1, 0, 0, 0], None, 3),
        (quaternion(0.3), [1.0, 0, 0, 0, 0, 0, 0], None, 4),
        (levelled, np.zeros(6), None, 2),
        (levelled, [5.0, 3, 0, 0, 0, 0], None, 2),
        (sb.DubinsCar(), [1.0, 2.0, 0.3], [0.0, 0.0], 3),
        # Curved: a circle of equilibria, a reaction that keeps a sum, the end of an epidemic.
        (lambda x: x * (1 - x[0] ** 2 - x[1] ** 2), [0.6, 0.8], None, 1),
        (lambda x: [-x[0] + 2 * x[1] ** 2, x[0] - 2 * x[1] ** 2], [2.0, 1.0], None, 1),
        (epidemic, [1.0, 0.0], None, 1),
        # A dead zone, short against the unit of a state that is 0.
        (lambda x: [-max(x[0] - 0.05, 0) - min(x[0] + 0.05, 0), -x[1]], [0.0, 0.0], None, 1),
    ],
)
def test_stable_along_a_family(f, x0, u0, dimension):
    report = sb.stability(f, x0, u0)
    assert report.verdict == f"{ALONG}{dimension}"
    assert report.verdict in repr(report) and "finite distance" in report.reason


@pytest.mark.parametrize(
    ("f", "x0", "u0"),
    [
        (cart(0.0), [0.0, 0.0], [0.0]),
        (satellite(0.0), np.zeros(6), None),
        (satellite(0.0), [0.3, 0.2, 1, 0, 0, 0], None),
        (quaternion(0.0), [1.0, 0, 0, 0, 0, 0, 0], None),
        (quadrotor, np.zeros(6), [0.0, 0.0]),
        (sb.CartPole(), [0.0, -np.pi / 2, 0, 0], None),
        (lambda x: [x[1], -(x[1] ** 3)], [0.0, 0.0], None),
    ],
)
def test_a_jordan_block_along_a_family_drifts(f, x0, u0):
    report = sb.stability(f, x0, u0)
    assert report.verdict == "unstable" and DRIFTS in report.reason
    assert report.spectral_margin == 0


@pytest.mark.parametrize(
    ("f", "x0"),
    [
        (lambda x: -(x**3), [0.0]),
        (lambda x: x**3, [0.0]),
        (lambda x: [x[1], -(x[0] ** 3)], [0.0, 0.0]),
        (lambda x: [-x[0] + x[1], -(x[1] ** 2)], [0.0, 0.0]),
        # The null space has two dimensions, but the equilibria are two crossing lines.
        (lambda x: [-x[0] * x[1], -x[0] * x[1]], [0.0, 0.0]),
        # Beside the origin the drift is braked: the Jordan block is there only. It is stable.
        (lambda x: [x[1], -(x[0] ** 2) * x[1]], [0.0, 0.0]),
        # A family, and a pair on the imaginary axis of which the cubic terms decide.
        (lambda x: [0 * x[0], x[2], -x[1] - x[2] ** 3], [1.0, 0.0, 0.0]),
    ],
)
def test_without_a_family_that_decides_the_linear_part_is_silent(f, x0):
    assert sb.stability(f, x0).verdict == "inconclusive"


@pytest.mark.parametrize(
    ("friction", "verdict"), [(0.1, f"{ALONG}1"), (0.0, "unstable"), (-0.1, "unstable")]
)
def test_families_of_maps(friction, verdict):
    report = sb.stability(
        lambda x, u: [x[0] + 0.1 * x[1], (1 - friction) * x[1] + u[0]], [2.0, 0.0], [0.0], dt=0.1
    )
    assert report.verdict == verdict
    assert (DRIFTS in report.reason) == (friction == 0)


def test_the_end_of_an_epidemic_is_stable_below_the_threshold_only():
    assert sb.stability(epidemic, [1.6, 0.0]).verdict == f"{ALONG}1"
    assert sb.stability(epidemic, [1.7, 0.0]).verdict == "unstable"


def test_the_verdict_is_what_simulation_shows():
    """Pushed, the braked cart stops near, and the free one goes on however small the push."""
    push = 1e-3
    ends = [
        sb.simulate(cart(c), [0.0, push], [0.0], times=[0, 1e4]).states[0, -1] for c in (0.5, 0.0)
    ]
    assert ends[0] == pytest.approx(push * 2 / 0.5, rel=1e-4)
    assert ends[1] == pytest.approx(1e4 * push, rel=1e-4)


@pytest.mark.parametrize(("room", "verdict"), [(0.2, f"{ALONG}1"), (0.02, "inconclusive")])
def test_a_family_ends_where_the_function_does(room, verdict):
    def f(x):
        if abs(x[0] - 1) > room:
            raise ValueError("out of range")
        return [0 * x[0], -x[1]]

    assert sb.stability(f, [1.0, 0.0]).verdict == verdict


def test_linear_systems_keep_their_verdicts():
    assert sb.stability(sb.Particle()).verdict == "unstable"
    assert sb.stability(np.diag([0.0, -1.0])).verdict == "marginally stable"


def spring(x, u, t):
    """Its stiffness grows from -1 at t = 0 through 0 at t = 1."""
    return [x[1], (1 - t) * x[0] - 0.2 * x[1]]


@pytest.mark.parametrize(
    ("t", "verdict"),
    [(0.0, "unstable"), (2.0, "asymptotically stable"), (5.0, "asymptotically stable")],
)
def test_a_system_that_depends_on_the_time_is_judged_at_the_stated_one(t, verdict):
    report = sb.stability(spring, [0, 0], [0.0], t=t)
    assert report.verdict == verdict
    roots = np.roots([1, 0.2, t - 1])
    assert np.sort_complex(report.eigenvalues) == pytest.approx(np.sort_complex(roots), rel=1e-12)
    distance = sb.distance_to_instability(spring, [0, 0], [0.0], t=t)
    assert distance == pytest.approx(sb.distance_to_instability([[0, 1], [1 - t, -0.2]]), rel=1e-9)


def test_without_a_time_it_is_refused_and_a_matrix_has_none():
    for call in (sb.stability, sb.distance_to_instability):
        with pytest.raises(ValueError, match="t is required"):
            call(spring, [0, 0], [0.0])
    with pytest.raises(ValueError, match="t is required"):
        sb.critical_step(spring, "euler", [0, 0], [0.0])
    assert sb.critical_step(spring, "euler", [0, 0], [0.0], t=2.0) == pytest.approx(0.2)
    with pytest.raises(ValueError, match="a matrix takes none"):
        sb.stability([[-1.0]], t=0.0)
