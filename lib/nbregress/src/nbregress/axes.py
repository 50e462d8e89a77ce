"""What one axes of a Matplotlib figure shows, in data coordinates."""

import math
from typing import Any

from nbregress.artists import Side, View, artists_digest
from nbregress.summary import summarize

# What a chosen format makes of these is compared, wherever the ticks may be.
_PROBES = (0.0, 0.25, 1.0, 1234.5)
_AUTOMATIC = (
    "ScalarFormatter LogFormatter LogFormatterMathtext LogFormatterSciNotation LogitFormatter "
    "LogFormatterExponent AutoDateFormatter ConciseDateFormatter NullFormatter ThetaFormatter "
    "RadialFormatter"
).split()


def axes_digest(ax: Any) -> dict[str, Any]:
    """Digest of an axes.

    Parameters
    ----------
    ax : matplotlib.axes.Axes

    Returns
    -------
    digest : dict
    """
    result: dict[str, Any] = {}
    if hasattr(ax, "set_functions"):  # secondary_xaxis, which has one axis and no data
        name = "x" if "x" in str(getattr(ax, "_orientation", "x")) else "y"
        return {"projection": "secondary", name: _axis(getattr(ax, f"{name}axis"), False)}
    if ax.name != "rectilinear":
        result["projection"] = ax.name
    title = " / ".join(
        filter(None, (ax.get_title(loc=side) for side in ("left", "center", "right")))
    )
    if title:
        result["title"] = title
    if not ax.get_visible():
        return {**result, "hidden": True}
    bar = getattr(ax, "_colorbar", None) is not None
    spec = None if bar else ax.get_subplotspec()
    if spec is not None:
        spec = spec.get_topmost_subplotspec()  # a colour bar takes its room from an axes
    if spec is not None and spec.get_gridspec().get_geometry() != (1, 1):
        rows, columns = spec.get_gridspec().get_geometry()
        span = f"{spec.rowspan.start}:{spec.rowspan.stop},{spec.colspan.start}:{spec.colspan.stop}"
        result["place"] = f"[{span}] of {rows} x {columns}"
    if not ax.axison and ax.name != "3d":
        result["axis"] = "off"
    elif ax.get_aspect() != "auto":
        result["aspect"] = f"{ax.get_aspect():g}"
    if ax.name == "polar":
        result["direction"] = [f"{ax.get_theta_direction():g}", f"{ax.get_theta_offset():.6g}"]
    sides = {}
    for name in ("x", "y", "z"):
        axis = getattr(ax, f"{name}axis", None)
        if axis is not None:
            chosen = not getattr(ax, f"get_autoscale{name}_on")()
            chosen = chosen and not _follows_data(ax, name)
            result[name] = _axis(axis, chosen)
            window = _window(axis) if chosen else math.inf
            sides[name] = Side(axis.get_scale() == "log", window, tuple(axis.get_view_interval()))
    if bar:
        return {**result, "colour bar": True}
    legend = ax.get_legend()
    if legend is not None:
        result["legend"] = legend_digest(legend)
    result["artists"] = artists_digest(ax, View(sides["x"], sides["y"]))
    others = [legend_digest(a) for a in ax.artists if hasattr(a, "legend_handles")]
    if others:
        result["more legends"] = others
    if ax.child_axes:
        result["insets"] = [axes_digest(child) for child in ax.child_axes]
    return result


def legend_digest(legend: Any) -> list[str]:
    """What a legend says, and of which kind of sign, or which line if that has another label.

    Parameters
    ----------
    legend : matplotlib.legend.Legend

    Returns
    -------
    entries : list of str
    """
    title = legend.get_title().get_text()
    texts = [text.get_text() for text in legend.get_texts()]
    lines = list(getattr(legend.axes, "lines", ()))
    pairs = [
        text + _handle(handle, text, lines)
        for text, handle in zip(texts, legend.legend_handles, strict=False)
    ]
    return ([title] if title else []) + pairs


def _handle(handle: Any, text: str, lines: list[Any]) -> str:
    if hasattr(handle, "get_hatch") and not hasattr(handle, "get_offsets"):
        return " (area)"
    if not hasattr(handle, "get_xdata") or text in [line.get_label() for line in lines]:
        return ""
    looks = [_look(line) for line in (handle, *lines)]
    return f" (line {looks.index(looks[0], 1)})" if looks[0] in looks[1:] else ""


def _look(line: Any) -> tuple[Any, ...]:
    from matplotlib.colors import to_hex

    return to_hex(line.get_color()), line.get_linestyle(), line.get_marker()


def _follows_data(ax: Any, name: str) -> bool:
    """Whether limits are those of the data, set by whatever drew them."""
    if name == "z":
        return False
    low, high = sorted(getattr(ax, f"{name}axis").get_view_interval())
    data = sorted(getattr(ax.dataLim, f"interval{name}"))
    return math.isfinite(data[0]) and math.isclose(low, data[0]) and math.isclose(high, data[1])


def _window(axis: Any) -> float:
    low, high = sorted(axis.get_view_interval())
    if axis.get_scale() == "log":
        return math.log10(high / low) if low > 0 else math.inf
    return float(high - low) or math.inf


def _axis(axis: Any, chosen: bool) -> dict[str, Any]:
    import numpy as np
    from matplotlib.ticker import FixedLocator, FuncFormatter, IndexLocator, MultipleLocator

    scale = axis.get_scale()
    result: dict[str, Any] = {}
    if chosen:
        # Automatic limits follow from the data, and at times from the size on paper.
        result["limits"] = summarize(axis.get_view_interval(), log=scale == "log")
    if axis.get_label_text():
        result["label"] = axis.get_label_text()
    if scale != "linear":
        result["scale"] = scale
    if scale not in ("linear", "log", "logit"):
        with np.errstate(all="ignore"):
            result["spacing"] = summarize(axis.get_transform().transform(np.array(_PROBES)))
    if axis.get_inverted():
        result["inverted"] = True
    locator, formatter = axis.get_major_locator(), axis.get_major_formatter()
    kind = type(formatter).__name__
    places = None
    if type(locator) in (FixedLocator, MultipleLocator, IndexLocator):
        low, high = sorted(axis.get_view_interval())
        slack = 1e-9 * (high - low)
        places = [t for t in locator() if low - slack <= t <= high + slack]
        result["tick places"] = summarize(places)
    if not axis.get_visible() or not axis.axes.axison or kind in _AUTOMATIC:
        return result
    if kind in ("FixedFormatter", "StrCategoryFormatter") or (
        places is not None and isinstance(formatter, FuncFormatter)
    ):
        result["ticks"] = [tick.get_text() for tick in axis.get_ticklabels()]
    else:
        result["tick format"] = [_formatted(formatter, probe) for probe in _PROBES]
    return result


def _formatted(formatter: Any, value: float) -> str:
    try:
        return str(formatter(value, None))
    except Exception:  # made for the values of its axis
        return "-"
