"""A Matplotlib figure's data as a small JSON digest.

Labels, scales, limits, and what each artist draws, in data coordinates: fonts, colours,
sizes on paper and the picture's bytes are left out.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from nbregress.artists import artists_digest
from nbregress.summary import summarize

if TYPE_CHECKING:
    from IPython.core.interactiveshell import InteractiveShell

MIME_TYPE = "application/vnd.nbregress.figure+json"
# The name under which digests were stored before this package had its own.
_OLD_MIME_TYPE = "application/vnd.statebook.figure+json"


def install(shell: "InteractiveShell") -> None:
    """Let every Matplotlib figure that IPython shows carry its digest.

    Matplotlib itself is not loaded; the hook waits for its first figure.

    Parameters
    ----------
    shell : IPython.core.interactiveshell.InteractiveShell
    """
    formatter = getattr(shell.display_formatter, "mimebundle_formatter", None)
    if formatter is not None:
        formatter.for_type_by_name("matplotlib.figure", "Figure", _bundle)


def uninstall(shell: "InteractiveShell") -> None:
    """Undo `install`.

    Parameters
    ----------
    shell : IPython.core.interactiveshell.InteractiveShell
    """
    formatter = getattr(shell.display_formatter, "mimebundle_formatter", None)
    if formatter is not None:
        formatter.pop("matplotlib.figure.Figure", None)


def _bundle(figure: Any, **_: Any) -> dict[str, Any]:
    return {MIME_TYPE: digest(figure)}


def rename_digest(bundle: Mapping[str, Any]) -> dict[str, Any]:
    """Give a digest that was stored under its old name today's.

    Parameters
    ----------
    bundle : mapping
        Data of an output by MIME type.

    Returns
    -------
    renamed : dict
        A copy; without an old name in it, an equal one.

    Examples
    --------
    >>> rename_digest({"application/vnd.statebook.figure+json": {"version": 1}})
    {'application/vnd.nbregress.figure+json': {'version': 1}}
    """
    renamed = dict(bundle)
    if _OLD_MIME_TYPE in renamed:
        renamed.setdefault(MIME_TYPE, renamed.pop(_OLD_MIME_TYPE))
    return renamed


def digest(figure: Any) -> dict[str, Any]:
    """Digest of what a figure shows.

    Parameters
    ----------
    figure : matplotlib.figure.Figure

    Returns
    -------
    digest : dict
        JSON data; arrays appear as the texts of `nbregress.summary.summarize`.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> figure = Figure()
    >>> _ = figure.subplots().plot([0, 1, 2], [0, 1, 4], label="square")
    >>> digest(figure)["axes"][0]["artists"]
    [{'kind': 'line', 'label': 'square', 'data': {'x': '0 1 2', 'y': '0 1 4'}}]
    """
    result: dict[str, Any] = {"version": 1}
    if figure.get_suptitle():
        result["title"] = figure.get_suptitle()
    if figure.legends:
        result["legend"] = [text.get_text() for leg in figure.legends for text in leg.get_texts()]
    artists = artists_digest(figure)
    # Where a figure's own texts stand is a matter of its layout on paper.
    artists = [{"kind": "text", "text": a["text"]} if a["kind"] == "text" else a for a in artists]
    artists = [a for a in artists if a.get("text") != result.get("title", "")]
    if artists:
        result["artists"] = artists
    # A figure lists the axes of its subfigures too.
    result["axes"] = [_axes(ax) for ax in figure.axes if ax.figure is figure]
    for sub in figure.subfigs:
        result.setdefault("subfigures", []).append(digest(sub))
    return result


def _axes(ax: Any) -> dict[str, Any]:
    result: dict[str, Any] = {}
    if ax.name != "rectilinear":
        result["projection"] = ax.name
    title = " / ".join(
        filter(None, (ax.get_title(loc=side) for side in ("left", "center", "right")))
    )
    if title:
        result["title"] = title
    if not ax.get_visible():
        return {**result, "hidden": True}
    if not ax.axison and ax.name != "3d":
        result["axis"] = "off"
    elif ax.get_aspect() != "auto":
        result["aspect"] = f"{ax.get_aspect():g}"
    for name in ("x", "y", "z"):
        axis = getattr(ax, f"{name}axis", None)
        if axis is not None:
            chosen = not getattr(ax, f"get_autoscale{name}_on")()
            result[name] = _axis(axis, chosen)
    if getattr(ax, "_colorbar", None) is not None:
        return {**result, "colour bar": True}
    legend = ax.get_legend()
    if legend is not None:
        texts = [legend.get_title().get_text(), *(text.get_text() for text in legend.get_texts())]
        result["legend"] = [text for text in texts if text]
    result["artists"] = artists_digest(
        ax, xlog=ax.get_xscale() == "log", ylog=ax.get_yscale() == "log"
    )
    if ax.child_axes:
        result["insets"] = [_axes(child) for child in ax.child_axes]
    return result


def _axis(axis: Any, chosen: bool) -> dict[str, Any]:
    from matplotlib.category import StrCategoryFormatter
    from matplotlib.ticker import FixedFormatter, FuncFormatter

    scale = axis.get_scale()
    result: dict[str, Any] = {}
    if chosen:
        # Automatic limits follow from the data, and at times from the size on paper.
        result["limits"] = summarize(axis.get_view_interval(), log=scale == "log")
    if axis.get_label_text():
        result["label"] = axis.get_label_text()
    if scale != "linear":
        result["scale"] = scale
    if axis.get_inverted():
        result["inverted"] = True
    named = (FixedFormatter, FuncFormatter, StrCategoryFormatter)
    if isinstance(axis.get_major_formatter(), named):
        result["ticks"] = [tick.get_text() for tick in axis.get_ticklabels()]
    return result
