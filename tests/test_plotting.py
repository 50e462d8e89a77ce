"""Plots hold the data they claim to show."""

from __future__ import annotations

import matplotlib
import numpy as np
import pytest

import statebook as sb

matplotlib.use("Agg")
import matplotlib.pyplot as plt


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


def test_use_style_changes_the_defaults():
    sb.use_style()
    assert plt.rcParams["axes.grid"] and plt.rcParams["figure.constrained_layout.use"]


def test_arrows_are_the_vector_field():
    ax = sb.plotting.arrows(sb.Pendulum(m=2.0, L=0.5), (-3, 3), (-5, 5), [1.5], number=7)
    (field,) = ax.collections
    x = np.stack([field.X, field.Y])
    expected = sb.Pendulum(m=2.0, L=0.5).dynamics(x, [1.5])
    np.testing.assert_allclose([np.ravel(field.U), np.ravel(field.V)], expected)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("theta", "omega")


def test_phase_portrait_has_a_closed_orbit_of_the_oscillator():
    ax = sb.plotting.phase_portrait(
        sb.Oscillator(), (-2, 2), (-2, 2), [[1.0, 0.0], [0.0, 1.5]], duration=2 * np.pi
    )
    for line, radius in zip(ax.lines[:2], (1.0, 1.5), strict=True):
        np.testing.assert_allclose(np.hypot(*line.get_data()), radius, rtol=1e-6)


@pytest.mark.parametrize(("discrete", "boundary"), [(False, [0, 0]), (True, None)])
def test_eigenvalues_with_their_boundary(discrete, boundary):
    values = [-0.3 + 0.4j, -0.3 - 0.4j]
    ax = sb.plotting.eigenvalues(values, discrete=discrete, label="mine")
    edge, marks = ax.lines
    np.testing.assert_array_equal(marks.get_xdata() + 1j * marks.get_ydata(), values)
    if discrete:
        np.testing.assert_allclose(np.hypot(*edge.get_data()), 1)
    else:
        assert list(edge.get_xdata()) == boundary


def test_stability_region_of_euler_is_the_disc_about_minus_one():
    ax = sb.plotting.stability_region("euler")
    edge = ax.collections[1].get_paths()[0].vertices
    np.testing.assert_allclose(np.hypot(edge[:, 0] + 1, edge[:, 1]), 1, atol=1e-3)


@pytest.mark.parametrize("plot", [sb.plotting.flow, sb.plotting.arrows])
def test_given_axes_are_used_and_the_system_must_be_planar(plot):
    _, ax = plt.subplots()
    assert plot(sb.Pendulum(), (-1, 1), (-1, 1), ax=ax) is ax
    with pytest.raises(ValueError, match="two states to be drawn, got 4"):
        plot(sb.CartPole(), (-1, 1), (-1, 1))
