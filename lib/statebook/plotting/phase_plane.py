"""Systems with two states in the plane of these."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from statebook import _validate
from statebook.plotting.style import new_axes
from statebook.systems import as_system

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def _field(
    system: Any, xlim: Sequence[float], ylim: Sequence[float], u: Any, number: int, ax: Axes | None
) -> tuple[Axes, tuple[np.ndarray, ...]]:
    """Return labelled axes, the states on a grid of their plane and the derivatives there."""
    x, y = _validate.interval("xlim", xlim), _validate.interval("ylim", ylim)
    X, Y = np.meshgrid(np.linspace(*x, number), np.linspace(*y, number))
    points = np.stack([X.ravel(), Y.ravel()])
    system = as_system(system, points[:, 0], u)
    if system.n != 2:
        raise ValueError(f"the system must have two states to be drawn, got {system.n}")
    rates = system.dynamics(points, u).reshape(2, *X.shape)
    ax = new_axes(ax)
    ax.set(xlabel=system.states[0], ylabel=system.states[1])
    return ax, (X, Y, *rates)


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
    ax, (X, Y, dX, dY) = _field(system, xlim, ylim, u, 60, ax)
    ax.streamplot(X, Y, dX, dY, density=1.0, color="0.65", linewidth=0.7, arrowsize=0.8)
    ax.set(xlim=xlim, ylim=ylim)
    return ax


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
    ax, field = _field(system, xlim, ylim, u, _validate.integer("number", number, 2), ax)
    ax.quiver(*field, angles="xy", color="0.4", width=0.003)
    return ax


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
    from statebook.simulation import simulate

    x0s = _validate.real_array("x0s", x0s, (2, None))
    times = np.linspace(0, _validate.positive("duration", duration), 401)
    ax = flow(system, xlim, ylim, u, ax=ax)
    states = simulate(system, x0s, u, times=times).states
    for trajectory in states.swapaxes(0, 1):
        ax.plot(*trajectory, color="C0")
    ax.plot(*x0s, "o", color="C0", markersize=4)
    return ax
