"""A Matplotlib figure's data as a small JSON digest, and how IPython comes to show it.

Labels, scales, limits, and what each artist draws, in data coordinates: fonts, colours,
sizes on paper and the picture's bytes are left out.
"""

from typing import TYPE_CHECKING, Any

from nbregress.artists import artists_digest
from nbregress.axes import axes_digest, legend_digest
from nbregress.frames import watch_animations
from nbregress.mime import FIGURE_TYPE
from nbregress.values import KNOWN, data_bundle

if TYPE_CHECKING:
    from IPython.core.interactiveshell import InteractiveShell

VERSION = 2


def install(shell: "InteractiveShell") -> None:
    """Let figures and known objects that IPython shows carry their digests.

    Matplotlib, NumPy and pandas are not loaded; the hooks wait for their first object.

    Parameters
    ----------
    shell : IPython.core.interactiveshell.InteractiveShell
    """
    formatter: Any = getattr(shell.display_formatter, "mimebundle_formatter")  # noqa: B009
    formatter.for_type_by_name("matplotlib.figure", "Figure", figure_bundle)
    for module, name in KNOWN:
        formatter.for_type_by_name(module, name, data_bundle)
    for kind in (list, tuple, dict):
        formatter.for_type(kind, data_bundle)
    watch_animations(shell, formatter, digest)


def figure_bundle(figure: Any, **_: Any) -> dict[str, Any]:
    """A figure's digest by its MIME type; what IPython calls for a figure.

    Parameters
    ----------
    figure : matplotlib.figure.Figure

    Returns
    -------
    bundle : dict
    """
    return {FIGURE_TYPE: digest(figure)}


def digest(figure: Any) -> dict[str, Any]:
    """Digest of what a figure shows.

    Parameters
    ----------
    figure : matplotlib.figure.Figure

    Returns
    -------
    digest : dict
        JSON data; arrays appear as the texts of `nbregress.summary.summarize`. Of a figure
        that cannot be read, ``error`` says why.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> figure = Figure()
    >>> _ = figure.subplots().plot([0, 1, 2], [0, 1, 4], label="square")
    >>> digest(figure)["axes"][0]["artists"]
    [{'kind': 'line', 'label': 'square', 'data': {'x': '0 1 2', 'y': '0 1 4'}}]
    """
    try:
        return {"version": VERSION, **_parts(figure)}
    except Exception as error:
        return {"version": VERSION, "error": f"{type(error).__name__}: {error}"}


def _parts(figure: Any) -> dict[str, Any]:
    own = [figure.get_suptitle(), figure.get_supxlabel(), figure.get_supylabel()]
    names = ("title", "supxlabel", "supylabel")
    result: dict[str, Any] = {n: text for n, text in zip(names, own, strict=True) if text}
    if figure.legends:
        result["legends"] = [legend_digest(legend) for legend in figure.legends]
    artists = artists_digest(figure)
    # Where a figure's own texts stand is a matter of its layout on paper.
    artists = [{"kind": "text", "text": a["text"]} if a["kind"] == "text" else a for a in artists]
    artists = [a for a in artists if a.get("text") not in own or a["kind"] != "text"]
    if artists:
        result["artists"] = artists
    # A figure lists the axes of its subfigures too.
    result["axes"] = [axes_digest(ax) for ax in figure.axes if ax.figure is figure]
    if figure.subfigs:
        result["subfigures"] = [_parts(sub) for sub in figure.subfigs]
    return result
