"""Figures in one style. Every function takes an Axes, or makes one, and returns it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from statebook import _validate
from statebook.systems import System, as_system

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from statebook.timescale import TimedPath

_STYLE: dict[str, Any] = {
    "figure.figsize": (6.0, 3.7),
    "figure.dpi": 110,
    "figure.constrained_layout.use": True,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": "medium",
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    # Dark blue, orange, teal, wine, grey: their luminances differ, so they survive greyscale.
    "axes.prop_cycle": "cycler('color', ['#12407a', '#e08214', '#2a9d8f', '#8c2d4f', '#777777'])",
}


def use_style() -> None:
    """Set the workbook's figure style, and sharp figures in a notebook.

    Examples
    --------
    >>> use_style()
    """
    import matplotlib.style

    matplotlib.style.use(_STYLE)
    try:
        from IPython import get_ipython
        from matplotlib_inline.backend_inline import set_matplotlib_formats
    except ImportError:  # not in a notebook
        return
    if get_ipython() is not None:
        set_matplotlib_formats("retina")


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.subplots()[1]


def _plane(
    system: Any, xlim: Sequence[float], ylim: Sequence[float], u: Any, number: int
) -> tuple[System, np.ndarray, np.ndarray, np.ndarray]:
    """Return the system, its states on a grid of the plane and their derivatives there."""
    left, right = _validate.real_array("xlim", xlim, (2,))
    low, high = _validate.real_array("ylim", ylim, (2,))
    X, Y = np.meshgrid(np.linspace(left, right, number), np.linspace(low, high, number))
    points = np.stack([X.ravel(), Y.ravel()])
    system = as_system(system, points[:, 0], u)
    if system.n != 2:
        raise ValueError(f"the system must have two states to be drawn, got {system.n}")
    return system, X, Y, system.dynamics(points, u).reshape(2, *X.shape)


def _label(ax: Axes, system: System) -> Axes:
    ax.set_xlabel(system.states[0])
    ax.set_ylabel(system.states[1])
    return ax


def flow(
    system: Any,
    xlim: Sequence[float],
    ylim: Sequence[float],
    u: Any = None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw streamlines of a system with two states.

    Parameters
    ----------
    system : system
        Whatever as_system takes.
    xlim, ylim : (float, float)
        The part of the plane.
    u : array, shape (m,), optional
        A constant input; zeros if omitted.
    ax : matplotlib.axes.Axes, optional

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        The system does not have two states.

    Examples
    --------
    >>> flow(lambda x: [x[1], -x[0]], (-1, 1), (-1, 1)).get_xlabel()
    'x[0]'
    """
    ax = _axes(ax)
    system, X, Y, (dX, dY) = _plane(system, xlim, ylim, u, 60)
    ax.streamplot(X, Y, dX, dY, density=1.0, color="0.65", linewidth=0.7, arrowsize=0.8)
    ax.set_xlim(*xlim)
    ax.set_ylim(*ylim)
    return _label(ax, system)


def arrows(
    system: Any,
    xlim: Sequence[float],
    ylim: Sequence[float],
    u: Any = None,
    *,
    number: int = 15,
    ax: Axes | None = None,
) -> Axes:
    """Draw the vector field of a system with two states.

    Parameters
    ----------
    system, xlim, ylim, u, ax
        As in flow.
    number : int > 1
        Arrows along each axis.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        The system does not have two states.

    Examples
    --------
    >>> arrows(lambda x: [x[1], -x[0]], (-1, 1), (-1, 1)).get_ylabel()
    'x[1]'
    """
    ax = _axes(ax)
    system, X, Y, (dX, dY) = _plane(system, xlim, ylim, u, _validate.integer("number", number, 2))
    ax.quiver(X, Y, dX, dY, angles="xy", color="0.4", width=0.003)
    return _label(ax, system)


def phase_portrait(
    system: Any,
    xlim: Sequence[float],
    ylim: Sequence[float],
    x0s: Any,
    duration: float,
    u: Any = None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw the flow and simulated trajectories from given states.

    Parameters
    ----------
    system, xlim, ylim, u, ax
        As in flow.
    x0s : array, shape (2, N)
        Initial states, marked with dots.
    duration : float > 0 [s]

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        The system does not have two states, or x0s another shape.

    Examples
    --------
    >>> ax = phase_portrait(lambda x: [x[1], -x[0]], (-1, 1), (-1, 1), [[1], [0]], 1.0)
    >>> len(ax.lines)
    2
    """
    from statebook.simulate import simulate

    x0s = _validate.real_array("x0s", x0s, (2, None))
    ax = flow(system, xlim, ylim, u, ax=ax)
    times = np.linspace(0, _validate.positive("duration", duration), 401)
    states = simulate(system, x0s, u, times=times).states
    for trajectory in states.swapaxes(0, 1):
        ax.plot(*trajectory, color="C0")
    ax.plot(*x0s, "o", color="C0", markersize=4)
    return ax


def eigenvalues(
    values: Any,
    *,
    discrete: bool = False,
    label: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Mark eigenvalues in the complex plane, with the stability boundary.

    Parameters
    ----------
    values : array of complex, any shape
    discrete : bool
        The boundary is the unit circle instead of the imaginary axis.
    label : str, optional
        For the legend.
    ax : matplotlib.axes.Axes, optional

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    TypeError, ValueError
        values are not finite numbers.

    Examples
    --------
    >>> eigenvalues([-1 + 2j, -1 - 2j]).get_xlabel()
    'real part'
    """
    ax = _axes(ax)
    values = np.ravel(_validate.array("values", values))
    if discrete:
        turn = np.linspace(0, 2 * np.pi, 201)
        ax.plot(np.cos(turn), np.sin(turn), "--", color="0.4", linewidth=1)
        ax.set_aspect("equal")
    else:
        ax.axvline(0, linestyle="--", color="0.4", linewidth=1)
    ax.plot(values.real, values.imag, "x", markeredgewidth=2, label=label)
    ax.set_xlabel("real part")
    ax.set_ylabel("imaginary part")
    return ax


def stability_region(
    method: Any,
    *,
    xlim: Sequence[float] = (-4.0, 2.0),
    ylim: Sequence[float] = (-3.5, 3.5),
    ax: Axes | None = None,
) -> Axes:
    """Shade the step-eigenvalue products z = h lambda with abs(R(z)) <= 1.

    Parameters
    ----------
    method : str or ButcherTableau
        A one-step method with a stability function R.
    xlim, ylim : (float, float)
    ax : matplotlib.axes.Axes, optional

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        No such method.

    Examples
    --------
    >>> stability_region("rk4").get_title()
    'rk4'
    """
    from statebook.integrate import stability_function

    ax = _axes(ax)
    x, y = np.linspace(xlim[0], xlim[1], 301), np.linspace(ylim[0], ylim[1], 301)
    growth = np.abs(stability_function(method, x[None, :] + 1j * y[:, None]))
    growth = np.nan_to_num(growth, posinf=1e3)
    ax.contourf(x, y, growth, levels=[0.0, 1.0], colors=["#c9d6e8"])
    ax.contour(x, y, growth, levels=[1.0], colors=["#12407a"], linewidths=1.2)
    ax.axhline(0, color="0.4", linewidth=0.6)
    ax.axvline(0, color="0.4", linewidth=0.6)
    ax.set_aspect("equal")
    ax.set_xlabel("real part of $h\\lambda$")
    ax.set_ylabel("imaginary part of $h\\lambda$")
    ax.set_title(getattr(method, "name", method))
    return ax


def timed_path(timed: TimedPath, *, ax: Axes | None = None) -> Axes:
    """Draw a timed path in the plane of s and its rate s'.

    The profile as a line, the speeds from which the end can be reached as a shade, the
    maximum-velocity curve dashed.

    Parameters
    ----------
    timed : TimedPath
    ax : matplotlib.axes.Axes, optional

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    TypeError
        timed is not a TimedPath.

    Examples
    --------
    >>> import statebook as sb
    >>> timed = sb.time_scale(sb.Path.through([[0, 1, 0]]), velocity=1, acceleration=2)
    >>> timed_path(timed).get_ylabel()
    "$s'$ [1/s]"
    """
    from statebook.timescale import TimedPath

    if not isinstance(timed, TimedPath):
        raise TypeError(f"timed must be a TimedPath, got {type(timed).__name__}")
    ax = _axes(ax)
    s = np.linspace(timed.s[0], timed.s[-1], 801)
    slowest, fastest = timed.controllable
    ax.fill_between(timed.s, slowest, fastest, color="0.9", label="controllable")
    limit = timed.maximum_speed(s)
    ax.plot(s, np.where(np.isfinite(limit), limit, np.nan), "--", color="0.4", label="maximum")
    ax.plot(timed.s, timed.sdot, color="C0", label="profile")
    ax.set_ylim(0, 1.3 * timed.sdot.max())
    ax.set_xlabel("$s$")
    ax.set_ylabel("$s'$ [1/s]")
    ax.legend()
    return ax
