"""Plots hold the data they claim to show."""

from __future__ import annotations

import matplotlib
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import statebook as sb

matplotlib.use("Agg")
import matplotlib.pyplot as plt


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


def test_use_style_changes_the_defaults():
    sb.use_style()
    wanted = {
        "figure.figsize": [6.0, 3.7],
        "figure.dpi": 110,
        "figure.constrained_layout.use": True,
        "axes.grid": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.titlesize": "medium",
        "grid.alpha": 0.3,
        "legend.frameon": False,
        "lines.linewidth": 1.6,
    }
    assert {name: plt.rcParams[name] for name in wanted} == wanted


def test_colours_differ_in_grey():
    sb.use_style()
    colours = plt.rcParams["axes.prop_cycle"].by_key()["color"]
    rgb = np.array([matplotlib.colors.to_rgb(colour) for colour in colours])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    grey = np.sort(linear @ [0.2126, 0.7152, 0.0722])
    assert len(colours) == 5 and np.diff(grey).min() > 0.02 and grey[-1] < 0.4


def look(artist):
    """Return dashes, width, colour and size of a line."""
    colour = matplotlib.colors.to_hex(artist.get_color())
    return artist.get_linestyle(), artist.get_linewidth(), colour, artist.get_markersize()


def test_arrows_are_the_vector_field():
    ax = sb.plotting.arrows(sb.Pendulum(m=2.0, L=0.5), (-3, 3), (-5, 5), [1.5], number=7)
    (field,) = ax.collections
    x = np.stack([field.X, field.Y])
    expected = sb.Pendulum(m=2.0, L=0.5).dynamics(x, [1.5])
    np.testing.assert_allclose([np.ravel(field.U), np.ravel(field.V)], expected)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("theta", "omega")


def test_arrows_cover_the_window():
    ax = sb.plotting.arrows(sb.Pendulum(), (-3, 1), (-5, 2))
    (field,) = ax.collections
    assert len(field.X) == 15 * 15 and field.width == 0.003 and field.angles == "xy"
    assert (min(field.X), max(field.X), min(field.Y), max(field.Y)) == (-3, 1, -5, 2)
    np.testing.assert_array_equal(field.get_facecolor()[0, :3], 0.4)
    assert len(sb.plotting.arrows(sb.Pendulum(), (-3, 1), (-5, 2), number=2).collections[0].X) == 4
    with pytest.raises(ValueError, match="number must be at least 2"):
        sb.plotting.arrows(sb.Pendulum(), (-3, 1), (-5, 2), number=1)


def test_streamlines_are_tangent_to_the_flow():
    pendulum = sb.Pendulum(m=2.0, L=0.5, damping=0.3)
    ax = sb.plotting.flow(pendulum, (-3, 1), (-5, 6), [1.5])
    lines = ax.collections[0]
    steps = [np.diff(piece, axis=0) for piece in lines.get_segments()]
    middles = [piece[:-1] + np.diff(piece, axis=0) / 2 for piece in lines.get_segments()]
    middle, step = np.concatenate(middles).T, np.concatenate(steps).T
    field = pendulum.dynamics(middle, [1.5])
    turn = np.angle((field[0] + 1j * field[1]) * (step[0] - 1j * step[1]))
    assert len(turn) > 500 and np.median(np.abs(turn)) < 0.02 and np.mean(np.abs(turn) < 0.2) > 0.97
    assert (ax.get_xlim(), ax.get_ylim()) == ((-3, 1), (-5, 6))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("theta", "omega")
    assert lines.get_linewidth() == [0.7] and np.all(lines.get_color()[0, :3] == 0.65)


def test_phase_portrait_is_what_simulate_says():
    pendulum, x0s = sb.Pendulum(damping=0.2), np.array([[1.0, -2.0, 0.5], [0.0, 1.0, -1.5]])
    ax = sb.plotting.phase_portrait(pendulum, (-4, 2), (-5, 5), x0s, 2.5, [3.0])
    *runs, dots = ax.lines
    exact = sb.simulate(pendulum, x0s, [3.0], times=np.linspace(0, 2.5, 401)).states
    np.testing.assert_array_equal([run.get_data() for run in runs], exact.swapaxes(0, 1))
    np.testing.assert_array_equal(dots.get_data(), x0s)
    assert {look(run)[2] for run in runs} == {look(dots)[2]}
    assert look(dots)[0] == "None" and dots.get_marker() == "o" and look(dots)[3] == 4
    assert (ax.get_xlim(), ax.get_ylim()) == ((-4, 2), (-5, 5))


def test_phase_portrait_has_a_closed_orbit_of_the_oscillator():
    ax = sb.plotting.phase_portrait(
        sb.Oscillator(), (-2, 2), (-2, 2), [[1.0, 0.0], [0.0, 1.5]], duration=2 * np.pi
    )
    for line, radius in zip(ax.lines[:2], (1.0, 1.5), strict=True):
        np.testing.assert_allclose(np.hypot(*line.get_data()), radius, rtol=1e-6)
        x, y = line.get_data()
        np.testing.assert_allclose([x[-1], y[-1]], [x[0], y[0]], atol=1e-6)


@pytest.mark.parametrize("discrete", [False, True])
def test_eigenvalues_with_their_boundary(discrete):
    values = np.array([[-0.3 + 0.4j, -0.3 - 0.4j], [0.0, 2.0]])
    ax = sb.plotting.eigenvalues(values, discrete=discrete, label="mine")
    edge, marks = ax.lines
    np.testing.assert_array_equal(marks.get_xdata() + 1j * marks.get_ydata(), values.ravel())
    assert (marks.get_marker(), marks.get_markeredgewidth(), look(marks)[0]) == ("x", 2, "None")
    assert marks.get_label() == "mine"
    assert look(edge)[:3] == ("--", 1, "#666666")
    if discrete:
        x, y = edge.get_data()
        np.testing.assert_allclose(np.hypot(x, y), 1)
        np.testing.assert_allclose(np.diff(np.unwrap(np.arctan2(y, x))), 2 * np.pi / 200)
        assert ax.get_aspect() == 1
    else:
        assert list(edge.get_xdata()) == [0, 0] and ax.get_aspect() == "auto"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("real part", "imaginary part")


@pytest.mark.parametrize("discrete", [False, True])
def test_eigenvalues_are_continuous_unless_said(discrete):
    asked = {"discrete": True} if discrete else {}
    edge = sb.plotting.eigenvalues([0.5], **asked).lines[0]
    assert (len(edge.get_xdata()) == 201) == discrete


@pytest.mark.parametrize("method", ["euler", "rk4", sb.METHODS["heun"]])
def test_stability_region_ends_where_the_amplification_is_one(method):
    ax = sb.plotting.stability_region(method)
    inside, edge = ax.collections
    z = np.concatenate([path.vertices for path in edge.get_paths()])
    growth = np.abs(sb.stability_function(method, z[:, 0] + 1j * z[:, 1]))
    np.testing.assert_allclose(growth, 1, atol=2e-3)
    assert z[:, 1].max() > 0.9 and z[:, 1].min() < -0.9
    assert inside.get_paths()[0].contains_point((-0.5, 0.1))
    assert not any(path.contains_point((0.5, 0.1)) for path in inside.get_paths())
    assert (ax.get_xlim(), ax.get_ylim()) == ((-4, 2), (-3.5, 3.5))
    assert ax.get_title() == getattr(method, "name", method) and ax.get_aspect() == 1
    assert edge.get_linewidth() == [1.2] and edge.levels.tolist() == [1]
    across, up = ax.lines
    assert list(across.get_ydata()) == [0, 0] and list(up.get_xdata()) == [0, 0]
    assert look(across)[1:3] == look(up)[1:3] == (0.6, "#666666")
    assert ax.get_xlabel() == "real part of $h\\lambda$"
    assert ax.get_ylabel() == "imaginary part of $h\\lambda$"


def test_stability_region_has_the_window_that_was_asked():
    ax = sb.plotting.stability_region("euler", xlim=(-3, 1), ylim=(-2, 1.5))
    assert (ax.get_xlim(), ax.get_ylim()) == ((-3, 1), (-2, 1.5))
    edge = ax.collections[1].get_paths()[0].vertices
    np.testing.assert_allclose(np.hypot(edge[:, 0] + 1, edge[:, 1]), 1, atol=1e-3)


def test_a_region_without_bounds_is_drawn():
    implicit = sb.plotting.stability_region("backward_euler", xlim=(0, 2), ylim=(-1, 1))
    edge = implicit.collections[1].get_paths()[0].vertices
    np.testing.assert_allclose(np.hypot(edge[:, 0] - 1, edge[:, 1]), 1, atol=1e-3)


def test_timed_path_shows_profile_limit_and_what_can_be_reached():
    pytest.importorskip("toppra")
    timed = sb.time_scale(sb.Path.through([[0, 1, 0.5]]), velocity=1, acceleration=2)
    _, ax = plt.subplots()
    assert sb.plotting.timed_path(timed, ax=ax) is ax
    limit, profile = ax.lines
    s = np.linspace(timed.s[0], timed.s[-1], 801)
    np.testing.assert_array_equal(limit.get_xdata(), s)
    expected = timed.maximum_speed(s)
    np.testing.assert_array_equal(
        limit.get_ydata(), np.where(np.isfinite(expected), expected, np.nan)
    )
    np.testing.assert_array_equal(profile.get_data(), [timed.s, timed.sdot])
    (shade,) = ax.collections
    slowest, fastest = timed.controllable
    around = shade.get_paths()[0].vertices
    for bound in (slowest, fastest):
        for point in np.stack([timed.s, bound], axis=1):
            assert np.hypot(*(around - point).T).min() < 1e-12
    assert ax.get_ylim() == (0, pytest.approx(1.3 * timed.sdot.max()))
    assert look(limit)[0] == "--" and look(limit)[2] == "#666666" and look(profile)[0] == "-"
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["controllable", "maximum", "profile"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$s$", r"$\dot s$ [1/s]")
    with pytest.raises(TypeError, match="timed must be a TimedPath, got list"):
        sb.plotting.timed_path([1, 2])


@settings(deadline=None, max_examples=25)
@given(st.lists(st.complex_numbers(max_magnitude=1e6, allow_nan=False), min_size=1, max_size=6))
def test_any_eigenvalues_are_marked_where_they_are(values):
    marks = sb.plotting.eigenvalues(values).lines[1]
    np.testing.assert_array_equal(marks.get_xdata() + 1j * marks.get_ydata(), values)
    plt.close("all")


@pytest.mark.parametrize(
    ("plot", "message"),
    [
        (lambda: sb.plotting.eigenvalues([np.nan]), "values must be finite"),
        (lambda: sb.plotting.eigenvalues("a"), "values must be an array of numbers"),
        (lambda: sb.plotting.stability_region("rk5"), "rk5"),
        (lambda: sb.plotting.flow(sb.Pendulum(), (-1, 1, 2), (-1, 1)), r"xlim must have shape"),
        (lambda: sb.plotting.flow(sb.Pendulum(), (1, 1), (-1, 1)), "xlim must increase"),
        (lambda: sb.plotting.arrows(sb.Pendulum(), (-1, 1), (2, -2)), "ylim must increase"),
        (lambda: sb.plotting.stability_region("rk4", xlim=(1, -1)), "xlim must increase"),
        (
            lambda: sb.plotting.phase_portrait(sb.Pendulum(), (-1, 1), (-1, 1), [[1], [0]], 0),
            "duration must be greater than 0",
        ),
        (
            lambda: sb.plotting.phase_portrait(sb.Pendulum(), (-1, 1), (-1, 1), [1, 0], 1),
            r"x0s must have shape \(2, any\)",
        ),
    ],
)
def test_what_cannot_be_drawn_is_refused_before_a_figure_is_made(plot, message):
    with pytest.raises((TypeError, ValueError), match=message):
        plot()
    assert plt.get_fignums() == []


@pytest.mark.parametrize("plot", [sb.plotting.flow, sb.plotting.arrows])
def test_given_axes_are_used_and_the_system_must_be_planar(plot):
    _, ax = plt.subplots()
    assert plot(sb.Pendulum(), (-1, 1), (-1, 1), ax=ax) is ax
    with pytest.raises(ValueError, match="two states to be drawn, got 4"):
        plot(sb.CartPole(), (-1, 1), (-1, 1))
