"""A planned swing-up of the cart-pole works as tried, or is refused."""

from __future__ import annotations

import numpy as np
import pytest

import statebook as sb

CARTPOLE = sb.CartPole(m_cart=1.5, m_pole=0.5)
WEIGHTS = {"Q": np.diag([1.0, 10.0, 1.0, 1.0]), "R": [[0.01]]}


def sinusoid(period, amplitude=0.5):
    omega = 2 * np.pi / period

    def acceleration(t):
        return amplitude * omega**2 * np.cos(omega * t) if t < 1.5 * period else 0.0

    return acceleration


def swing_up(cartpole=CARTPOLE, plan=None, switch=2.0, **changes):
    options = {"limit": 30.0, "track": (-0.5, 2.5)} | WEIGHTS | changes
    return sb.CartPoleSwingUp(cartpole, plan or sinusoid(1.52), switch, **options)


def test_cart_force_gives_the_acceleration_and_is_newtons_law():
    rng = np.random.default_rng(1)
    cartpole = sb.CartPole(m_cart=1.3, m_pole=0.7, L=0.8, g=9.1)
    x, a = rng.normal(size=(4, 50)), rng.normal(size=50)
    u = np.stack([sb.cart_force(cartpole, x, a), np.zeros(50)])
    rate = cartpole.dynamics(x, u)
    np.testing.assert_allclose(rate[2], a, rtol=1e-10, atol=1e-10)
    _, theta, _, omega = x
    np.testing.assert_allclose(rate[3], 2 / 0.8 * (a * np.sin(theta) - 9.1 * np.cos(theta)))
    # The force moves the centre of mass: cart at p, pole's mass at p + L/2 cos(theta).
    pole = a - 0.4 * (rate[3] * np.sin(theta) + omega**2 * np.cos(theta))
    np.testing.assert_allclose(u[0], 1.3 * a + 0.7 * pole, rtol=1e-9)
    one = sb.cart_force(cartpole, x[:, 3], a[3])
    assert one.shape == () and one == u[0, 3]


@pytest.mark.parametrize("acceleration", [np.nan, [1.0, 2.0], "fast"])
def test_cart_force_names_a_bad_acceleration(acceleration):
    with pytest.raises((TypeError, ValueError), match="acceleration must"):
        sb.cart_force(sb.CartPole(), np.zeros((4, 3)), acceleration)


def test_plan_is_followed_and_the_pole_is_caught_and_held():
    swing = swing_up()
    times = np.concatenate([np.linspace(0, 2, 201), np.linspace(2, 17, 301)[1:]])
    run = sb.simulate(CARTPOLE, [0, -np.pi / 2, 0, 0], swing, times=times)
    p, theta, _, omega = run.states
    driven = times <= 2.0
    np.testing.assert_allclose(
        p[driven], 0.5 - 0.5 * np.cos(2 * np.pi / 1.52 * times[driven]), atol=1e-6
    )
    assert np.abs(run.controls[0]).max() <= 30.0 and not run.controls[1].any()
    assert -0.5 <= p.min() and p.max() <= 2.5
    late = times >= 10.0
    assert np.abs(sb.wrap_angle(theta[late] - np.pi / 2)).max() < 0.01
    assert np.abs(omega[late]).max() < 0.01
    np.testing.assert_allclose(swing.trial.at(9.0), run.at(9.0), atol=1e-3)


def test_target_is_the_middle_of_the_track_unless_given():
    assert swing_up().catch.x0[0] == 1.0
    swing = swing_up(target=0.6)
    assert swing.trial.states[0, -1] == pytest.approx(0.6, abs=0.01)


def test_start_moves_the_plan():
    swing = swing_up(start=3.0, track=(2.5, 5.5))
    assert swing.trial.states[0, 0] == 3.0
    assert swing.trial.states[0, -1] == pytest.approx(4.0, abs=0.01)


def test_batch_of_states_is_the_states_one_by_one():
    swing = swing_up()
    x = np.random.default_rng(2).normal(size=(4, 6)) * 3
    for t in (0.4, 2.5):
        u = swing(x, t)
        assert u.shape == (2, 6) and np.abs(u).max() <= 30.0
        for k in range(6):
            np.testing.assert_allclose(swing(x[:, k], t), u[:, k], rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"limit": 0.0}, "limit must be greater than 0"),
        ({"limit": 10.0}, r"the plan needs 24\.\d+ N, the limit is 10 N"),
        ({"start": 3.0}, r"start must be on the track \[-0.5, 2.5\] m, got 3 m"),
        ({"target": -1.0}, "target must be on the track"),
        ({"track": (1.0, -1.0)}, "track must increase"),
        ({"track": (-0.5, 0.9)}, r"the plan takes the cart over \[0, 1\] m"),
        ({"track": (-0.5, 1.2)}, "the catch takes the cart over"),
        ({"switch": 0.0}, "switch must be greater than 0"),
        # This pole passes upright too fast: on an endless track the cart chases it for ever.
        ({"plan": sinusoid(0.9), "limit": 200.0}, "the pole is not caught: 8 s after the switch"),
        (
            {"plan": sinusoid(0.9), "limit": 200.0, "track": (-1e6, 1e6)},
            "the pole is not caught: 8 s after the switch",
        ),
    ],
)
def test_what_cannot_work_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        swing_up(**changes)


def test_wrong_types_are_refused():
    with pytest.raises(TypeError, match="cartpole must be a CartPole, got Pendulum"):
        swing_up(cartpole=sb.Pendulum())
    with pytest.raises(TypeError, match="acceleration must be a function of time"):
        swing_up(plan=3.0)
