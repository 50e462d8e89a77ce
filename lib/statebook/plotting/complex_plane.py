"""Eigenvalues and stability regions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from statebook import _validate
from statebook.plotting.style import new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def eigenvalues(
    values: Any, *, discrete: bool = False, label: str | None = None, ax: Axes | None = None
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
    values = np.ravel(_validate.array("values", values))
    ax = new_axes(ax)
    if discrete:
        turn = np.linspace(0, 2 * np.pi, 201)
        ax.plot(np.cos(turn), np.sin(turn), "--", color="0.4", linewidth=1)
        ax.set_aspect("equal")
    else:
        ax.axvline(0, linestyle="--", color="0.4", linewidth=1)
    ax.plot(values.real, values.imag, "x", markeredgewidth=2, label=label)
    ax.set(xlabel="real part", ylabel="imaginary part")
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
    from statebook.runge_kutta import stability_function

    x = np.linspace(*_validate.interval("xlim", xlim), 301)
    y = np.linspace(*_validate.interval("ylim", ylim), 301)
    growth = np.abs(stability_function(method, x[None, :] + 1j * y[:, None]))
    growth = np.nan_to_num(growth, posinf=1e3)
    ax = new_axes(ax)
    ax.contourf(x, y, growth, levels=[0.0, 1.0], colors=["#c9d6e8"])
    ax.contour(x, y, growth, levels=[1.0], colors=["#12407a"], linewidths=1.2)
    ax.axhline(0, color="0.4", linewidth=0.6)
    ax.axvline(0, color="0.4", linewidth=0.6)
    ax.set(xlabel="real part of $h\\lambda$", ylabel="imaginary part of $h\\lambda$")
    ax.set(aspect="equal", title=getattr(method, "name", method))
    return ax
