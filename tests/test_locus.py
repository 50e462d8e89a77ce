"""Eigenvalues along parameters, and their crossings, against closed forms and published speeds."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import control
import numpy as np
import pytest

import statebook as sb

# The benchmark bicycle: Meijaard, Papadopoulos, Ruina and Schwab (2007), equations (A 20)-(A 24).
M = np.array([[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]])
K0 = np.array([[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]])
K2 = np.array([[0, 76.59734589573222], [0, 2.65431523794604]])
C1 = np.array([[0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]])


def bicycle(x, u, v=5.0):
    q, rate = x[:2], x[2:]
    return np.concatenate(
        [rate, np.linalg.solve(M, u - v * C1 @ rate - (9.81 * K0 + v**2 * K2) @ q)]
    )


@pytest.mark.parametrize("values", [[0, 10], [10, 0], np.linspace(0, 10, 5), [4.2, 4.3, 6, 6.1]])
def test_published_weave_and_capsize_speeds(values):
    locus = sb.eigenvalue_locus(bicycle, {"v": values}, np.zeros(4), np.zeros(2))
    weave, capsize = sorted(locus.crossings, key=lambda crossing: crossing.value)
    assert weave.value == pytest.approx(4.29238253634111, abs=1e-9)
    assert weave.frequency == pytest.approx(3.43503384866144, abs=1e-9)
    assert capsize.value == pytest.approx(6.02426201538837, abs=1e-9)
    assert capsize.eigenvalue == 0
    ways = ["outside", "inside"]
    assert [weave.before, weave.after] == (ways if values[0] < values[-1] else ways[::-1])


def test_an_eigenvalue_that_passes_one_at_rest_is_not_taken_for_it():
    def turning(x, u, v=5.0):
        return np.append(bicycle(x[:4], u, v), v * x[1])

    locus = sb.eigenvalue_locus(turning, {"v": np.linspace(0, 10, 101)}, np.zeros(5), np.zeros(2))
    assert [c.value for c in locus.crossings] == pytest.approx(
        [4.29238253634111, 6.02426201538837], abs=1e-9
    )


def normal_form(x, mu=0.0, omega=2.0):
    r2 = x[0] ** 2 + x[1] ** 2
    return [(mu - 0.3 - r2) * x[0] - omega * x[1], omega * x[0] + (mu - 0.3 - r2) * x[1]]


def test_hopf_point_of_the_normal_form():
    (hopf,) = sb.eigenvalue_locus(normal_form, {"mu": [-1, 0, 1]}, [0, 0]).crossings
    assert hopf.value == pytest.approx(0.3, abs=1e-12)
    assert hopf.eigenvalue == pytest.approx(2j, abs=1e-12)
    assert (hopf.before, hopf.after) == ("inside", "outside")


def neuron(x, u):
    """FitzHugh and Nagumo's, whose Hopf points are at v^2 = 1 - b epsilon."""
    return [x[0] - x[0] ** 3 / 3 - x[1] + u[0], 0.08 * (x[0] + 0.7 - 0.8 * x[1])]


def test_hopf_points_where_the_equilibrium_moves_with_an_input():
    locus = sb.eigenvalue_locus(neuron, {"u[0]": np.linspace(0, 2, 6)}, [-1.2, -0.6], [0])
    v = np.sqrt(1 - 0.8 * 0.08) * np.array([-1, 1])
    exact = v**3 / 3 - v + (v + 0.7) / 0.8
    assert [c.value for c in locus.crossings] == pytest.approx(exact, abs=1e-9)
    assert [c.x[0] for c in locus.crossings] == pytest.approx(v, abs=1e-9)
    assert [c.frequency for c in locus.crossings] == pytest.approx(
        [np.sqrt(0.08 - 0.064**2)] * 2, rel=1e-9
    )
    assert locus.u.tolist() == [np.linspace(0, 2, 6).tolist()]
    assert locus.x.shape == (2, 6)


def section(q, damping=0.0):
    """Two coupled oscillators whose frequencies meet at q = 1.5: flutter."""
    stiffness = np.array([[1.0, q], [-q, 4.0]])
    return np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping * np.eye(2)]])


def test_flutter_of_an_undamped_and_of_a_damped_section():
    (flutter,) = sb.eigenvalue_locus(section, {"q": np.linspace(0, 3, 8)}).crossings
    assert flutter.value == pytest.approx(1.5, abs=1e-9)
    assert (flutter.before, flutter.after) == ("on the boundary", "outside")
    # s^2 + d s + w = 0 with w = 2.5 +- j sqrt(q^2 - 1.5^2) meets the axis where Im(w)^2 = d^2 2.5.
    d = 0.2
    (late,) = sb.eigenvalue_locus(lambda q: section(q, d), {"q": [0.0, 3.0]}).crossings
    assert late.value == pytest.approx(np.sqrt(1.5**2 + d**2 * 2.5), abs=1e-9)
    assert late.frequency == pytest.approx(np.sqrt(2.5), abs=1e-9)


def test_two_crossings_between_two_values_are_found():
    def window(p):
        return np.diag([-1.0, 1e-4 - (p - 0.5037) ** 2])

    locus = sb.eigenvalue_locus(window, {"p": np.linspace(0, 1, 10)})
    assert [c.value for c in locus.crossings] == pytest.approx([0.4937, 0.5137], abs=1e-12)
    assert locus.eigenvalues.real.max() < 0


def test_differences_are_said_once():
    def real_only(x, k=1.0):
        return [float(x[1]), float(-k * x[0] - x[1])]

    with pytest.warns(sb.InexactDerivativeWarning) as caught:
        sb.eigenvalue_locus(real_only, {"k": [1.0, 4.0]}, [0, 0])
    assert len(caught) == 1


def test_columns_follow_eigenvalues_through_one_another():
    p = np.linspace(0, 1, 7)
    locus = sb.eigenvalue_locus(lambda p: np.diag([p - 2, -1 - 3 * p]), {"p": p})
    assert np.allclose(locus.eigenvalues, np.stack([-1 - 3 * p, p - 2], axis=1))
    assert locus.crossings == ()
    assert repr(locus).endswith("none crosses the stability boundary")


def test_period_doubling_of_the_logistic_map():
    (flip,) = sb.eigenvalue_locus(
        lambda x, a=1.0: a * x * (1 - x), {"a": [2.0, 3.5]}, [0.5], dt=0.5
    ).crossings
    assert (flip.value, flip.eigenvalue) == (pytest.approx(3, abs=1e-9), -1)
    assert flip.frequency == pytest.approx(2 * np.pi)


def test_a_gain_in_discrete_time_and_a_boundary_left_at_the_end():
    plant = sb.discretize(control.ss([[0, 1], [0, 0]], [[0], [1]], np.eye(2), 0), 0.1)

    def loop(k):
        return plant.A - plant.B @ [[k, 2.0]]

    # z^2 + a1 z + a0 with a0 = 1 - 0.2 + k 0.005 leaves the disc where a0 = 1.
    first, last = sb.eigenvalue_locus(loop, {"k": [0.0, 50.0]}, dt=0.1).crossings
    assert (first.value, first.eigenvalue, first.before) == (0, 1, "on the boundary")
    assert last.value == pytest.approx(40, abs=1e-9)
    assert abs(last.eigenvalue) == pytest.approx(1, abs=1e-15)


@dataclass(frozen=True)
class Spring:
    k: float = 1.0
    c: float = 0.1

    def __call__(self, x, u):
        return [x[1], u[0] - self.k * x[0] - self.c * x[1]]


def rate(t, x, u, params):
    return [x[1], u[0] - params["k"] * x[0] - params["c"] * x[1]]


ONE_SPRING = {
    "dataclass": Spring(),
    "keywords": lambda x, u, k=1.0, c=0.1: Spring(k, c)(x, u),
    "required keywords": lambda x, u, *, k, c=0.1: Spring(k, c)(x, u),
    "factory": lambda k: Spring(k),
    "class": Spring,
    "library": lambda k: sb.Oscillator(m=1.0, stiffness=k, damping=0.1),
    "nlsys": control.nlsys(rate, None, states=2, inputs=1, params={"k": 1.0, "c": 0.1}),
    "state space": lambda k: control.ss([[0, 1], [-k, -0.1]], [[0], [1]], np.eye(2), 0),
}


@pytest.mark.parametrize("kind", ONE_SPRING)
def test_every_kind_of_model_gives_the_same_locus(kind):
    k = np.array([1.0, 4.0, 9.0])
    exact = -0.05 + 1j * np.sqrt(k - 0.05**2)
    locus = sb.eigenvalue_locus(ONE_SPRING[kind], {"k": k}, [0, 0], [0])
    assert np.sort_complex(locus.eigenvalues)[:, 1] == pytest.approx(exact)
    mapped = sb.eigenvalue_map(ONE_SPRING[kind], {"k": k}, x0=[0, 0], u0=[0])
    assert mapped[:, 0] == pytest.approx(exact)


def test_map_of_a_model_over_two_parameters():
    k, c = np.array([1.0, 4.0, 9.0]), np.array([0.0, 0.2])
    values = sb.eigenvalue_map(Spring(), {"k": k, "c": c}, x0=[0, 0], u0=[0])
    assert values[..., 0] == pytest.approx(-c / 2 + 1j * np.sqrt(k[:, None] - c**2 / 4))


@pytest.mark.filterwarnings("ignore::statebook.derivatives.InexactDerivativeWarning")
def test_an_interconnected_system_knows_the_parameters_of_its_parts():
    params = {"k": 1.0, "c": 0.0}
    plant = control.nlsys(rate, states=2, inputs=["u"], outputs=2, name="p", params=params)
    whole = control.interconnect([plant], inplist=["p.u"], outlist=["p.y[0]", "p.y[1]"])
    values = sb.eigenvalue_map(whole, {"k": [4.0]}, x0=[0, 0], u0=[0])
    assert values[0] == pytest.approx([2j, -2j], abs=1e-9)


def test_a_trim_follows_a_state_and_an_input():
    pendulum = sb.Pendulum(m=1.0, L=1.0, g=9.0, damping=0.1)
    angle = np.linspace(-0.5, 0.5, 5)
    locus = sb.eigenvalue_locus(pendulum, {"theta": angle}, [-0.5, 0], trim={"fixed": ["theta"]})
    assert locus.u[0] == pytest.approx(9.0 * np.cos(angle))
    (level,) = locus.crossings  # theta'' = -g cos(theta) + u is stiff below, and not above
    assert (level.value, level.eigenvalue) == (pytest.approx(0, abs=1e-9), 0)


def test_a_fold_is_no_other_equilibrium():
    def fold(x, mu=0.0):
        return [mu + x[0] - x[0] ** 3]

    end = 2 / np.sqrt(27)
    with pytest.raises(sb.EquilibriumNotFoundError, match=r"followed to mu = 0\.384\d*, and not"):
        sb.eigenvalue_locus(fold, {"mu": [-1, 0, 1]}, [-1.3])
    locus = sb.eigenvalue_locus(fold, {"mu": [-1, 0, end - 1e-3]}, [-1.3])
    assert np.allclose(locus.eigenvalues[:, 0], 1 - 3 * locus.x[0] ** 2)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ((Spring(), {"stiffness": [1.0, 2.0]}, [0, 0], [0]), ValueError, "one of k, c, x"),
        ((lambda v: np.eye(2), {"speed": [1.0, 2.0]}), ValueError, "one of v; got 'speed'"),
        ((Spring(), {"k": [1.0, 3.0, 2.0]}, [0, 0], [0]), ValueError, "in order"),
        ((Spring(), {"k": [1.0]}, [0, 0], [0]), ValueError, "at least 2"),
        ((Spring(), {"k": [1.0, 2.0], "c": [0.0, 1.0]}, [0, 0], [0]), TypeError, "one parameter"),
        ((Spring(), [1.0, 2.0], [0, 0], [0]), TypeError, "one parameter"),
        ((3.0, {"k": [1.0, 2.0]}), TypeError, "model must be a dataclass"),
        ((control.tf([1], [1, 1]), {"k": [1.0, 2.0]}), TypeError, "got TransferFunction"),
        ((lambda p: np.ones((2, 3)), {"p": [1.0, 2.0]}), ValueError, "square"),
        ((lambda p: 1j * np.eye(2), {"p": [1.0, 2.0]}), TypeError, "real"),
        ((sb.Pendulum(), {"m": [1.0, -1.0]}, [-np.pi / 2, 0]), ValueError, "greater than 0"),
        ((sb.Pendulum(), {"m": [1.0, 2.0]}), ValueError, "x0 is required"),
    ],
)
def test_wrong_arguments_are_said(arguments, error, words):
    with pytest.raises(error, match=words):
        sb.eigenvalue_locus(*arguments)


def test_wrong_trims_are_said():
    with pytest.raises(ValueError, match="a key of trim must be one of fixed"):
        sb.eigenvalue_locus(Spring(), {"k": [1.0, 2.0]}, [0, 0], [0], trim={"fix": []})
    with pytest.raises(TypeError, match="belong to a model"):
        sb.eigenvalue_map(lambda k: k[:, None, None], [1.0], x0=[0])


def margin_of(model):
    return sb.stability(model, [0, 0], [0]).spectral_margin


def test_sweep_over_the_parameters_of_a_model():
    with ThreadPoolExecutor() as pool:
        c = [0.1, 0.2, 0.4]
        swept = sb.sweep(margin_of, {"c": c}, model=Spring(), executor=pool, progress=False)
        assert swept == pytest.approx(np.array(c) / 2)
        with pytest.raises(ValueError, match="it has k, c"):
            sb.sweep(margin_of, {"m": c}, model=Spring(), executor=pool, progress=False)


# Margins and comparisons, from a report

UPRIGHT = sb.stability(sb.Pendulum(m=1.0, L=1.0, g=9.0), [np.pi / 2, 0])


def test_margins_of_a_balanced_pendulum():
    """L = (6 s + 18) / (s^2 - 9) = 6 / (s - 3): a gain of 1/2, abs(L) = 1 at w^2 = 27."""
    margins = UPRIGHT.margins([[18.0, 6.0]])
    assert margins.stable
    assert margins.gain == (pytest.approx(0.5), np.inf)
    assert margins.crossover == pytest.approx((np.sqrt(27),))
    assert margins.phase == pytest.approx(60)
    assert margins.delay == pytest.approx(np.pi / 3 / np.sqrt(27))
    assert margins.modulus == pytest.approx(1)


def test_a_delay_as_long_as_the_margin_ends_stability():
    K = np.array([[18.0, 6.0]])
    margins = UPRIGHT.margins(K)
    plant = UPRIGHT.linearization
    for factor, stable in ((0.98, True), (1.02, False)):
        late = sb.with_input_delay(plant, factor * margins.delay, order=8)
        closed = late.A - late.B @ np.hstack([K, np.zeros((1, 8))])
        assert (np.linalg.eigvals(closed).real.max() < 0) == stable


def test_modulus_is_the_least_distance_on_a_fine_grid():
    omega = np.geomspace(1e-3, 1e3, 20001)
    lag = control.tf([40.0], [0.02, 1.0]) * control.tf([0.5, 1.0], [1.0])
    K = lag * control.tf([1.0], [0.001, 1.0])
    margins = UPRIGHT.margins(K, output="theta")
    G = UPRIGHT.linearization
    response = (K * control.ss(G.A, G.B, [[1.0, 0.0]], 0))(1j * omega)
    assert margins.modulus == pytest.approx(np.abs(1 + response).min(), rel=1e-6)


def test_margins_of_a_sampled_loop_with_a_delay_in_seconds():
    dt = 0.01
    plant = sb.discretize(sb.linearize(sb.Pendulum(g=9.0), [np.pi / 2, 0]), dt)
    margins = sb.stability(plant).margins([[18.0, 6.0]])
    assert margins.stable
    assert margins.delay == pytest.approx(np.pi / 3 / np.sqrt(27) - dt / 2, rel=0.02)


def test_a_late_sampled_loop_loses_stability_where_its_margins_say():
    plant = sb.discretize(sb.linearize(sb.Pendulum(g=9.0), [np.pi / 2, 0]), 0.05)
    late = sb.with_input_delay(plant, 0.05)
    K = control.dlqr(late, np.eye(3), [[0.1]])[0]
    margins = sb.stability(late).margins(K)
    for factor in margins.gain:
        radii = [
            np.abs(np.linalg.eigvals(late.A - share * factor * late.B @ K)).max()
            for share in (0.999, 1.001)
        ]
        assert min(radii) < 1 < max(radii)
    omega = np.linspace(1e-3, np.pi / 0.05, 200001)
    L = control.ss(late.A, late.B, K, 0, 0.05)(np.exp(0.05j * omega))
    assert margins.modulus == pytest.approx(np.abs(1 + L).min(), rel=1e-6)
    crossings = omega[:-1][np.diff(np.abs(L) > 1) != 0]
    assert margins.crossover == pytest.approx(crossings, rel=1e-4)
    phases = np.angle(-L[:-1][np.diff(np.abs(L) > 1) != 0])
    assert margins.phase == pytest.approx(np.rad2deg(np.abs(phases).min()), rel=1e-3)


def test_an_unstable_loop_has_no_margins_and_says_so():
    margins = UPRIGHT.margins([[1.0, 1.0]])
    assert not margins.stable and "not stable, so these are no margins" in repr(margins)


def test_loops_of_two_inputs_are_opened_one_at_a_time():
    def two(x, u):
        return [x[0] + u[0] + 0.5 * u[1], 2 * x[1] + u[1]]

    report = sb.stability(two, [0, 0], [0, 0])
    K = np.array([[3.0, 0.0], [0.0, 5.0]])
    # With u[0] open the rest has the poles 1 and -3; L = 3 / (s - 1): a gain of 1/3.
    assert report.margins(K, input="u[0]").gain[0] == pytest.approx(1 / 3)
    assert report.margins(K, input="u[1]").gain[0] == pytest.approx(2 / 5)
    with pytest.raises(ValueError, match=r"input must name one of u\[0\], u\[1\]"):
        report.margins(K)


@pytest.mark.parametrize(
    ("report", "arguments", "words"),
    [
        (sb.stability([[-1.0]]), {}, "a bare matrix"),
        (UPRIGHT, {"K": [[1.0]]}, r"K must have shape \(1, 2\), got \(1, 1\)"),
        (UPRIGHT, {"K": 2.0}, "output must name one of theta, omega"),
        (UPRIGHT, {"K": 2.0, "output": "phi"}, "output must be one of theta, omega"),
        (UPRIGHT, {"K": [[1.0, 2.0]], "output": "theta"}, "are on the states"),
        (UPRIGHT, {"K": control.ss([], [], [], np.eye(2)), "output": "theta"}, "one input and"),
    ],
)
def test_loops_that_are_none_are_said(report, arguments, words):
    with pytest.raises(ValueError, match=words):
        report.margins(**arguments)


def test_outputs_with_a_kink_cost_no_verdict():
    plant = control.nlsys(
        lambda t, x, u, p: [-x[0] + u[0]],
        lambda t, x, u, p: [abs(x[0])],
        states=1,
        inputs=1,
        outputs=1,
    )
    report = sb.stability(plant, [0.0], [0.0])
    assert report.verdict == "asymptotically stable" and report.linearization is None


def test_comparison_pairs_modes_and_shows_what_is_new():
    slow = sb.stability(lambda x, u: [-x[0] + u[0], -10 * x[1]], [0, 0], [0])
    fast = sb.stability(lambda x, u: [-12 * x[0] + u[0], -10.5 * x[1]], [0, 0], [0])
    pairs = [[m.eigenvalue.real for m in pair] for pair in sb.compare(slow, fast).pairs]
    assert pairs == [[-1, -12], [-10, -10.5]]  # by the states, not by size
    more = sb.compare(sb.stability([[-1.0]]), sb.stability([[-1.1, 0.0], [0.0, -5.0]]))
    assert more.pairs[1][0] is None and more.pairs[1][1].eigenvalue == -5
    assert "<table>" in more._repr_html_() and "-  " in repr(more)


def test_comparisons_of_what_cannot_be_compared_are_said():
    report = sb.stability([[-1.0]])
    with pytest.raises(TypeError, match="two reports"):
        sb.compare(report, [[-1.0]])
    with pytest.raises(ValueError, match="continuous or in discrete"):
        sb.compare(report, sb.stability([[0.5]], dt=0.1))


def test_crossovers_do_not_depend_on_the_units_of_the_states():
    rng = np.random.default_rng(3)
    A, B, C = rng.normal(size=(5, 5)), 3 * rng.normal(size=(5, 1)), rng.normal(size=(1, 5))
    unit = 10.0 ** np.array([5, -4, 0, 3, -5])
    plants = (
        control.ss(A, B, C, 0),
        control.ss(A * unit[:, None] / unit, B * unit[:, None], C / unit, 0),
    )
    found, same = (sb.stability(plant).margins(2.0).crossover for plant in plants)
    assert len(found) > 0
    assert same == pytest.approx(found, rel=1e-9)
    np.testing.assert_allclose(np.abs(2 * plants[0](1j * np.array(found))), 1, rtol=1e-9)


def test_eigenvalues_at_rest_cost_few_evaluations():
    asked = []

    def still(k):
        asked.append(k)
        return np.diag([-1.0, -2.0])

    assert sb.eigenvalue_locus(still, {"k": [0.0, 1.0]}).crossings == ()
    assert len(asked) < 50


def test_a_feedthrough_bounds_the_gain():
    """A loop round -0.5 has no solution at the gain 2."""
    plant = control.ss([[-1.0]], [[1.0]], [[0.0]], [[-0.5]])
    low, high = sb.stability(plant).margins().gain
    assert low == 0 and high < 2 and high == pytest.approx(2, rel=1e-8)
    # 1 + k (0.5 - 1 / (s + 1)) = 0 has its root at 0 for k = 2.
    plant = control.ss([[-1.0]], [[1.0]], [[-1.0]], [[0.5]])
    assert sb.stability(plant).margins().gain == pytest.approx((0, 2))


def test_eigenvalues_at_rest_ask_for_no_halving():
    """What does not move is told apart at once: about one call a step, and not 2^12."""
    calls = []

    def chain(k):
        calls.append(k)
        assert len(calls) < 200, "steps were halved"
        return np.diag([-1.0, -2.0, -3.0])

    assert sb.eigenvalue_locus(chain, {"k": np.linspace(0, 1, 5)}).crossings == ()
