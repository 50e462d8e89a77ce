"""The one style of all figures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
        set_matplotlib_formats("retina")  # type: ignore[no-untyped-call]


def new_axes(ax: Axes | None) -> Axes:
    """Return the Axes, or those of a new figure."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.subplots()[1]
