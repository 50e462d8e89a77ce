"""Models of the literature: their published equilibria and eigenvalues.

Parameters and numbers are those of the works named with each model. A model is a plain
function as a reader would write it from the page.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

import statebook as sb


@dataclass(frozen=True)
class Published:
    """A model, a guess, and what is known of the equilibrium near it."""

    source: str
    f: Callable
    guess: tuple
    x: tuple
    eigenvalues: tuple | None = None  # any order
    u: tuple = ()
    rtol: float = 1e-9
    discrete: bool = False
    atol: float = 0.0


def fitzhugh_nagumo(x, u, a=0.7, b=0.8, tau=12.5):
    return [x[0] - x[0] ** 3 / 3 - x[1] + u[0], (x[0] + a - b * x[1]) / tau]


def lorenz(x, sigma=10.0, rho=28.0, beta=8 / 3):
    return [sigma * (x[1] - x[0]), x[0] * (rho - x[2]) - x[1], x[0] * x[1] - beta * x[2]]


LORENZ = math.sqrt(72)


def hodgkin_huxley(x, u):
    """The squid axon at 6.3 degrees, potential from rest, V and gates m, h, n (1952)."""
    V, m, h, n = x
    am = 0.1 * (25 - V) / (np.exp((25 - V) / 10) - 1)
    bm = 4 * np.exp(-V / 18)
    ah = 0.07 * np.exp(-V / 20)
    bh = 1 / (np.exp((30 - V) / 10) + 1)
    an = 0.01 * (10 - V) / (np.exp((10 - V) / 10) - 1)
    bn = 0.125 * np.exp(-V / 80)
    current = 120 * m**3 * h * (V - 115) + 36 * n**4 * (V + 12) + 0.3 * (V - 10.613)
    return [
        u[0] - current,
        am * (1 - m) - bm * m,
        ah * (1 - h) - bh * h,
        an * (1 - n) - bn * n,
    ]


def reactor(x, u):
    """A jacketed tank reactor with A -> B (Seborg, Edgar and Mellichamp, chapter 2)."""
    concentration, temperature = x
    rate = 7.2e10 * np.exp(-8750 / temperature) * concentration
    return [
        (1 - concentration) - rate,
        (350 - temperature)
        + 5e4 / (1000 * 0.239) * rate
        + 5e4 / (100 * 1000 * 0.239) * (u[0] - temperature),
    ]


def chemostat(x, mu=0.53, K=0.12, a=0.4, D=0.3, feed=4.0):
    """Monod growth: mu S / (K + S), yield a (Kuang and Smith use such forms)."""
    growth = mu * x[0] / (K + x[0])
    return [D * (feed - x[0]) - growth * x[1] / a, (growth - D) * x[1]]


def van_der_pol(x, mu=1.0):
    return [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]


def rossler(x, a=0.2, b=0.2, c=5.7):
    return [-x[1] - x[2], x[0] + a * x[1], b + x[2] * (x[0] - c)]


ROSSLER = (5.7 - math.sqrt(5.7**2 - 0.16)) / 2


def brusselator(x, a=1.0, b=3.0):
    return [a + x[0] ** 2 * x[1] - (b + 1) * x[0], b * x[0] - x[0] ** 2 * x[1]]


def predator_prey(x, r=1.6, d=0.56, b=0.6, k=125.0, a=3.2, c=50.0):
    eaten = a * x[0] * x[1] / (c + x[0])
    return [r * x[0] * (1 - x[0] / k) - eaten, b * eaten - d * x[1]]


def sir(x, beta=0.5, gamma=0.2, birth=0.02):
    return [birth - beta * x[0] * x[1] - birth * x[0], beta * x[0] * x[1] - (gamma + birth) * x[1]]


def magnetic_levitation(x, u, m=0.05, k=1e-4, g=9.81, R=1.0, L=0.01):
    gap, speed, current = x
    return [speed, g - k / m * (current / gap) ** 2, (u[0] - R * current) / L]


def furuta(x, u):
    """Quanser's rotary pendulum, arm and pendulum from upright (QUBE-Servo 2)."""
    _, alpha, va, vp = x
    mp, r, lp, g, Jr, Jp = 0.024, 0.085, 0.129, 9.81, 0.095 * 0.085**2 / 3, 0.024 * 0.129**2 / 3
    half = lp / 2
    sine, cosine = np.sin(alpha), np.cos(alpha)
    a = Jr + mp * (r**2 + half**2 * sine**2)
    b = mp * half * r * cosine
    force = u[0] - 2 * mp * half**2 * sine * cosine * va * vp + mp * half * r * sine * vp**2
    other = mp * half**2 * sine * cosine * va**2 + mp * half * g * sine
    d = a * Jp - b**2
    return [va, vp, (Jp * force + b * other) / d, (b * force + a * other) / d]


def furuta_unstable():
    mp, r, lp, g, Jr, Jp = 0.024, 0.085, 0.129, 9.81, 0.095 * 0.085**2 / 3, 0.024 * 0.129**2 / 3
    half = lp / 2
    d = (Jr + mp * r**2) * Jp - (mp * half * r) ** 2
    return math.sqrt((Jr + mp * r**2) * mp * half * g / d)


def vehicle(x, u, m=1573.0, Iz=2873.0, lf=1.1, lr=1.58, C=80000.0, V=30.0):
    """The lateral bicycle model (Rajamani, Vehicle Dynamics and Control, section 2.3)."""
    _, vy, _, yaw_rate = x
    front = 2 * C * (u[0] - np.arctan((vy + lf * yaw_rate) / V))
    rear = 2 * C * -np.arctan((vy - lr * yaw_rate) / V)
    return [vy, (front + rear) / m - V * yaw_rate, yaw_rate, (lf * front - lr * rear) / Iz]


def vehicle_eigenvalues(m=1573.0, Iz=2873.0, lf=1.1, lr=1.58, C=80000.0, V=30.0):
    A = np.array(
        [
            [-4 * C / (m * V), -V - 2 * C * (lf - lr) / (m * V)],
            [-2 * C * (lf - lr) / (Iz * V), -2 * C * (lf**2 + lr**2) / (Iz * V)],
        ]
    )
    return (0, 0, *np.linalg.eigvals(A))


def dc_motor(x, u, J=0.01, b=0.1, K=0.01, R=1.0, L=0.5):
    """The motor of the Control Tutorials of the University of Michigan."""
    return [(K * x[1] - b * x[0]) / J, (u[0] - R * x[1] - K * x[0]) / L]


def ball_and_beam(x, u, m=0.11, R=0.015, g=9.8, J=9.99e-6):
    """The ball and beam of the same tutorials; u is the angular acceleration."""
    r, vr, angle, va = x
    return [vr, m * (r * va**2 - g * np.sin(angle)) / (J / R**2 + m), va, u[0]]


def suspension(x, u):
    """A quarter of a bus, also of the tutorials; states of body and wheel."""
    m1, m2, k1, k2, b1, b2 = 2500.0, 320.0, 80000.0, 500000.0, 350.0, 15020.0
    x1, v1, x2, v2 = x
    strut = k1 * (x1 - x2) + b1 * (v1 - v2) - u[0]
    return [v1, -strut / m1, v2, (strut - k2 * x2 - b2 * v2) / m2]


def duffing(x, delta=0.3):
    return [x[1], x[0] - x[0] ** 3 - delta * x[1]]


def chua(x, alpha=15.6, beta=28.0, m0=-8 / 7, m1=-5 / 7):
    """Chua's circuit: a resistor of three straight pieces."""
    h = m1 * x[0] + 0.5 * (m0 - m1) * (abs(x[0] + 1) - abs(x[0] - 1))
    return [alpha * (x[1] - x[0] - h), x[0] - x[1] + x[2], -beta * x[1]]


def selkov(x, a=0.08, b=0.6):
    return [-x[0] + a * x[1] + x[0] ** 2 * x[1], b - a * x[1] - x[0] ** 2 * x[1]]


def logistic_map(x):
    """The logistic map at r = 2.8."""
    return 2.8 * x * (1 - x)


def henon(x, a=1.4, b=0.3):
    return [1 - a * x[0] ** 2 + x[1], b * x[0]]


HENON = (math.sqrt(6.09) - 0.7) / 2.8


def quadruple_tank(x, u):
    """Johansson, IEEE Trans. Control Syst. Technol. 8 (2000) 456, minimum phase, in cm and V."""
    A, a = (28.0, 32.0, 28.0, 32.0), (0.071, 0.057, 0.071, 0.057)
    k, gamma = (3.33, 3.35), (0.70, 0.60)
    out = [ai * np.sqrt(2 * 981 * h) for ai, h in zip(a, x, strict=True)]
    return [
        (-out[0] + out[2] + gamma[0] * k[0] * u[0]) / A[0],
        (-out[1] + out[3] + gamma[1] * k[1] * u[1]) / A[1],
        (-out[2] + (1 - gamma[1]) * k[1] * u[1]) / A[2],
        (-out[3] + (1 - gamma[0]) * k[0] * u[0]) / A[3],
    ]


def robertson(x):
    """Robertson's stiff reactions (Hairer and Wanner, Solving ODEs II, section IV.1)."""
    first, second, third = 0.04 * x[0], 3e7 * x[1] ** 2, 1e4 * x[1] * x[2]
    return [-first + third, first - third - second, second]


def morris_lecar(x, u):
    """Type II excitability (Rinzel and Ermentrout, 1989); mV, ms."""
    V, w = x
    m = 0.5 * (1 + np.tanh((V + 1.2) / 18))
    steady = 0.5 * (1 + np.tanh((V - 2) / 30))
    rate = 0.04 * np.cosh((V - 2) / 60)
    current = 4.4 * m * (V - 120) + 8 * w * (V + 84) + 2 * (V + 60)
    return [(u[0] - current) / 20, rate * (steady - w)]


def vtol(x, u, m=4.0, J=0.0475, r=0.25, g=9.8, c=0.05):
    """The vectored thrust aircraft (Astrom and Murray, example 3.12)."""
    angle = x[2]
    return [
        x[3],
        x[4],
        x[5],
        (u[0] * np.cos(angle) - u[1] * np.sin(angle) - c * x[3]) / m,
        (u[0] * np.sin(angle) + u[1] * np.cos(angle) - c * x[4]) / m - g,
        r * u[0] / J,
    ]


def cruise(x, u, m=1600.0, Tm=190.0, wm=420.0, beta=0.4, alpha=12.0):
    """Cruise control in fourth gear (Astrom and Murray, section 4.1)."""
    w = alpha * x[0]
    torque = Tm * (1 - beta * (w / wm - 1) ** 2)
    return [(alpha * u[0] * torque - 0.5 * 1.3 * 0.32 * 2.4 * x[0] ** 2) / m - 9.8 * 0.01]


W = (1, -1)  # signs of a complex pair


def pair(real, imag):
    return tuple(complex(real, sign * imag) for sign in W)


MODELS = [
    Published(
        "E. Lorenz, J. Atmos. Sci. 20 (1963) 130: C+ and its pair",
        lorenz,
        (8.0, 8.0, 26.0),
        (LORENZ, LORENZ, 27.0),
        (-13.854578, *pair(0.093956, 10.194505)),
        rtol=1e-6,
    ),
    Published(
        "the same: the origin",
        lorenz,
        (0.1, 0.1, 0.2),
        (0, 0, 0),
        (-8 / 3, (-11 + math.sqrt(1201)) / 2, (-11 - math.sqrt(1201)) / 2),
    ),
    Published(
        "O. Roessler, Phys. Lett. A 57 (1976) 397",
        rossler,
        (0.0, -0.1, 0.1),
        (ROSSLER, -5 * ROSSLER, 5 * ROSSLER),
        (-5.686972, *pair(0.097001, 0.995193)),
        rtol=1e-5,
    ),
    Published(
        "B. van der Pol, Phil. Mag. 2 (1926) 978",
        van_der_pol,
        (0.4, 0.3),
        (0, 0),
        pair(0.5, math.sqrt(0.75)),
    ),
    Published(
        "the Brusselator, Prigogine and Lefever (1968)",
        brusselator,
        (1.3, 2.0),
        (1, 3),
        pair(0.5, math.sqrt(0.75)),
    ),
    Published(
        "Astrom and Murray, Feedback Systems, section 4.7: hares and lynxes (20.6, 29.5)",
        predator_prey,
        (20.0, 30.0),
        (20.5882, 29.4810),
        rtol=1e-5,
    ),
    Published(
        "endemic state of an SIR model with births (Anderson and May)",
        sir,
        (0.5, 0.1),
        (0.44, 0.02 * (1 / 0.22 - 1 / 0.5)),
    ),
    Published(
        "Hodgkin and Huxley, J. Physiol. 117 (1952) 500: rest",
        hodgkin_huxley,
        (0.5, 0.1, 0.6, 0.3),
        (0.0, 0.05293, 0.59612, 0.31768),
        u=(0.0,),
        rtol=2e-3,
        atol=4e-3,  # they round the leak's potential so that rest is at 0
    ),
    Published(
        "R. FitzHugh, Biophys. J. 1 (1961) 445: rest at (-1.1994, -0.6243)",
        fitzhugh_nagumo,
        (-1.0, -0.5),
        (-1.19941, -0.62426),
        u=(0.0,),
        rtol=1e-5,
    ),
    Published(
        "Seborg, Edgar and Mellichamp: reactor at 0.5 mol/l and 350 K",
        reactor,
        (0.5, 349.0),
        (0.5, 350.0),
        u=(300.0,),
        rtol=2e-3,
    ),
    Published(
        "Monod's chemostat",
        chemostat,
        (0.5, 1.0),
        (0.12 * 0.3 / 0.23, 0.4 * (4 - 0.12 * 0.3 / 0.23)),
    ),
    Published(
        "magnetic levitation, as in Khalil, exercise 1.18",
        magnetic_levitation,
        (0.012, 0.0, 0.7),
        (0.01, 0, math.sqrt(0.05 * 9.81 / 1e-4) * 0.01),
        (-100, math.sqrt(2 * 9.81 / 0.01), -math.sqrt(2 * 9.81 / 0.01)),
        u=(math.sqrt(0.05 * 9.81 / 1e-4) * 0.01,),
    ),
    Published(
        "K. Furuta et al. (1992), parameters of Quanser's QUBE-Servo 2",
        furuta,
        (0.2, 0.1, 0.0, 0.1),
        (0.2, 0, 0, 0),
        (0, 0, furuta_unstable(), -furuta_unstable()),
        u=(0.0,),
    ),
    Published(
        "Rajamani, Vehicle Dynamics and Control, table 2-1 at 30 m/s",
        vehicle,
        (1.0, 0.1, 0.2, 0.1),
        (1.0, 0, 0.2, 0),
        vehicle_eigenvalues(),
        u=(0.0,),
    ),
    Published(
        "Control Tutorials for MATLAB and Simulink: DC motor, poles -9.9975 and -2.0025",
        dc_motor,
        (0.0, 0.5),
        (0.1 / 1.001 / 1.0, 1.0 / 1.001),
        (-9.997502, -2.002498),
        u=(1.0,),
        rtol=1e-6,
    ),
    Published(
        "the same: ball and beam, four integrators",
        ball_and_beam,
        (0.3, 0.1, 0.1, 0.1),
        (0.3, 0, 0, 0),
        (0, 0, 0, 0),
        u=(0.0,),
    ),
    Published(
        "the same: bus suspension, poles -23.9758 +- 35.1869i and -0.1098 +- 5.2504i",
        suspension,
        (0.1, 0.0, 0.1, 0.0),
        (0, 0, 0, 0),
        (*pair(-23.9758, 35.1869), *pair(-0.1098, 5.2504)),
        u=(0.0,),
        rtol=1e-4,
    ),
    Published(
        "G. Duffing's oscillator, Guckenheimer and Holmes, section 2.2",
        duffing,
        (0.8, 0.1),
        (1, 0),
        tuple(np.roots([1, 0.3, 2])),
    ),
    Published("the same: the saddle", duffing, (0.1, -0.1), (0, 0), tuple(np.roots([1, 0.3, -1]))),
    Published(
        "L. Chua: the outer equilibria at +-(1.5, 0, -1.5)",
        chua,
        (2.0, 0.1, -1.4),
        (1.5, 0, -1.5),
        tuple(np.roots([1, 15.6 * 2 / 7 + 1, 15.6 * (2 / 7 - 1) + 28, 15.6 * 2 / 7 * 28])),
    ),
    Published(
        "E. Sel'kov, Eur. J. Biochem. 4 (1968) 79 (Strogatz, section 7.3)",
        selkov,
        (0.5, 1.0),
        (0.6, 0.6 / 0.44),
        tuple(np.roots([1, -(-1 + 2 * 0.36 / 0.44 - 0.44), 0.44])),
    ),
    Published(
        "R. May, Nature 261 (1976) 459: logistic map",
        logistic_map,
        (0.5,),
        (1.8 / 2.8,),
        (-0.8,),
        discrete=True,
    ),
    Published(
        "M. Henon, Commun. Math. Phys. 50 (1976) 69",
        henon,
        (0.6, 0.2),
        (HENON, 0.3 * HENON),
        tuple(-1.4 * HENON + sign * math.sqrt((1.4 * HENON) ** 2 + 0.3) for sign in W),
        discrete=True,
    ),
    Published(
        "K. Johansson's quadruple tank: 12.4, 12.7, 1.8, 1.4 cm; T = 62, 90, 23, 30 s",
        quadruple_tank,
        (10.0, 10.0, 2.0, 2.0),
        (12.2630, 12.7832, 1.6339, 1.4090),
        (-1 / 62.3, -1 / 90.5, -1 / 22.8, -1 / 30.1),
        u=(3.0, 3.0),
        rtol=1e-2,
    ),
    Published("H. Robertson (1966): all mass in C", robertson, (0.3, 0.1, 0.6), (0, 0, 1), None),
    Published(
        "C. Morris and H. Lecar, Biophys. J. 35 (1981) 193: rest near (-60.9, 0.0149)",
        morris_lecar,
        (-50.0, 0.1),
        (-60.855, 0.01491),
        u=(0.0,),
        rtol=1e-3,
    ),
    Published(
        "Astrom and Murray: vectored thrust aircraft in hover",
        vtol,
        (1.0, 2.0, 0.1, 0.1, 0.1, 0.1),
        (1.0, 2.0, 0, 0, 0, 0),
        (0, 0, 0, 0, -0.0125, -0.0125),
        u=(0.0, 39.2),
    ),
    Published(
        "Astrom and Murray, section 6.4: 20 m/s at throttle 0.1687, pole -0.0101",
        cruise,
        (25.0,),
        (20.0,),
        (-0.0101,),
        u=(0.1687,),
        rtol=2e-2,
    ),
]


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.f.__name__)
@pytest.mark.filterwarnings("ignore::statebook.InexactDerivativeWarning")
def test_published_equilibrium_and_eigenvalues(model):
    u = model.u or None
    system = sb.as_system(model.f, model.guess, u, dt=True if model.discrete else None)
    found = sb.find_equilibrium(system, model.guess, u)
    size = max(np.abs(model.x).max(), 1e-3)
    np.testing.assert_allclose(
        found.x, model.x, rtol=model.rtol, atol=max(model.atol, 1e-3 * model.rtol * size)
    )
    if model.eigenvalues is not None:
        report = sb.stability(system, found.x, u)
        expected = np.array(model.eigenvalues, dtype=complex)
        left = list(report.eigenvalues)
        for value in expected:  # the nearest of those that are left
            nearest = min(left, key=lambda z, value=value: abs(z - value))
            left.remove(nearest)
            assert abs(nearest - value) <= 10 * model.rtol * np.abs(expected).max() + 1e-12


def pendulum_chain(links, rng):
    """Return f of a chain of point masses on massless rods, and its matrices.

    T = sum_i m_i |v_i|^2 / 2 with v_i = sum_{j <= i} l_j (cos a_j, sin a_j) a_j'; angles from
    the hanging position.
    """
    m, length = rng.uniform(0.3, 3, links), rng.uniform(0.2, 2, links)
    below = np.array([[m[max(i, j) :].sum() for j in range(links)] for i in range(links)])
    M0, G = below * np.outer(length, length), 9.81 * np.diag(below) * length

    def f(x):
        angle, rate = x[:links], x[links:]
        apart = angle[:, None] - angle[None, :]
        M = M0 * np.cos(apart)
        force = -(M0 * np.sin(apart)) @ rate**2 - G * np.sin(angle)
        return np.concatenate([rate, np.linalg.solve(M, force)])

    return f, M0, G


@pytest.mark.parametrize("links", range(2, 9))
def test_chains_of_pendulums_are_smooth(links):
    rng = np.random.default_rng(links)
    for _ in range(1 if links > 4 else 2):
        f, M0, G = pendulum_chain(links, rng)
        up = rng.integers(0, 2, links)
        x0 = np.concatenate([np.pi * up, np.zeros(links)])
        linear = sb.linearize(f, x0)
        sign = np.where(up, -1.0, 1.0)
        lower = -np.linalg.solve(M0 * np.outer(sign, sign), np.diag(G * sign))
        size = np.abs(lower).max()
        np.testing.assert_allclose(linear.A[links:, :links], lower, rtol=1e-9, atol=1e-12 * size)
        np.testing.assert_array_equal(linear.A[:links, links:], np.eye(links))
        away = rng.normal(size=2 * links)
        A, _ = sb.jacobians(f, away)
        step = 1e-30j
        exact = np.stack([f(away + step * e).imag / 1e-30 for e in np.eye(2 * links)], axis=1)
        np.testing.assert_allclose(A, exact, rtol=1e-12, atol=1e-13 * np.abs(exact).max())
