"""Timed paths in the plane of s and its rate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from statebook import _validate
from statebook.plotting.style import new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from statebook.timescale.timed_path import TimedPath


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
    >>> timed_path(timed).get_xlabel()
    '$s$'
    """
    from statebook.timescale.timed_path import TimedPath

    timed, ax = _validate.instance("timed", timed, TimedPath), new_axes(ax)
    s = np.linspace(timed.s[0], timed.s[-1], 801)
    slowest, fastest = timed.controllable
    ax.fill_between(timed.s, slowest, fastest, color="0.9", label="controllable")
    limit = timed.maximum_speed(s)
    ax.plot(s, np.where(np.isfinite(limit), limit, np.nan), "--", color="0.4", label="maximum")
    ax.plot(timed.s, timed.sdot, color="C0", label="profile")
    ax.set(xlabel="$s$", ylabel=r"$\dot s$ [1/s]", ylim=(0, 1.3 * timed.sdot.max()))
    ax.legend()
    return ax
