"""Bars, wedges, arrows and other patches, and which of them have the same colour."""

from typing import Any

from nbregress.summary import summarize

_COLUMNS = {
    "rectangles": ("x", "y", "width", "height", "angle"),
    "arrows": ("x", "y", "to x", "to y"),
    "ellipses": ("x", "y", "width", "height", "angle"),
    "wedges": ("x", "y", "radius", "from", "to", "width"),
}


def label_of(artist: Any) -> dict[str, str]:
    """An artist's label, if its author gave it one.

    Parameters
    ----------
    artist : matplotlib.artist.Artist

    Returns
    -------
    label : dict
        Empty, or with the one entry ``label``.
    """
    label = str(artist.get_label())
    return {} if label.startswith("_") or not label else {"label": label}


def classes(colours: Any) -> dict[str, str]:
    """Which of several things have the same colour, whatever colour it is.

    Parameters
    ----------
    colours : array_like, shape (n, 4)

    Returns
    -------
    classes : dict
        Empty if all have one, else the entry ``classes``.
    """
    import numpy as np

    rows = np.reshape(np.asarray(colours, dtype=float), (-1, 4))
    if len(rows) < 2:
        return {}
    numbers: dict[tuple[float, ...], int] = {}
    of_each = [numbers.setdefault(tuple(row), len(numbers)) for row in np.round(rows, 4).tolist()]
    return {"classes": summarize(of_each)} if len(numbers) > 1 else {}


def patches_digest(patches: list[Any], pair: Any) -> list[dict[str, Any]]:
    """Digest of patches, those of one kind together.

    Parameters
    ----------
    patches : list of matplotlib.patches.Patch
    pair : callable
        Summary of points, shape (n, 2).

    Returns
    -------
    items : list of dict
    """
    import numpy as np

    groups: dict[str, list[tuple[Any, Any]]] = {}
    for patch in patches:
        kind, row = _parameters(patch)
        groups.setdefault(kind, []).append((patch, row))
    found = []
    for kind, members in groups.items():
        item: dict[str, Any] = {"kind": kind, "count": len(members)}
        labels = [label["label"] for patch, _ in members if (label := label_of(patch))]
        if labels:
            item["labels"] = labels
        if kind in _COLUMNS:
            columns = np.array([row for _, row in members], dtype=float).T
            named = zip(_COLUMNS[kind], columns, strict=True)
            item["data"] = {name: summarize(column) for name, column in named}
        else:
            item["data"] = pair(np.concatenate([vertices for _, vertices in members]))
        item["data"] |= classes([patch.get_facecolor() for patch, _ in members])
        found.append(item)
    return found


def _parameters(patch: Any) -> tuple[str, Any]:
    """What a patch was given, not the polygon that it is drawn with."""
    import numpy as np
    from matplotlib.patches import Ellipse, FancyArrowPatch, Rectangle, Wedge

    if isinstance(patch, Rectangle):
        return "rectangles", [*patch.get_xy(), patch.get_width(), patch.get_height(), patch.angle]
    if isinstance(patch, Wedge):
        width = np.nan if patch.width is None else patch.width
        x, y = patch.center
        return "wedges", [x, y, patch.r, patch.theta1, patch.theta2, width]
    if isinstance(patch, Ellipse) and type(patch).__name__ in ("Ellipse", "Circle"):
        x, y = np.ravel(patch.get_center())
        return "ellipses", [x, y, patch.width, patch.height, patch.angle]
    if isinstance(patch, FancyArrowPatch):
        ends = getattr(patch, "_posA_posB", None)
        if ends is not None:
            return "arrows", np.ravel(ends)
        return "arrow along a path", getattr(patch, "_path_original").vertices  # noqa: B009
    given = np.asarray(getattr(patch, "xy", np.empty((0, 2))), dtype=float)
    digits = 11 - int(np.log10(np.abs(given).max(initial=1e-99)))  # the rest is rounding
    corners = np.unique(np.round(given, digits), axis=0)
    low, high = (np.unique(corners[:, k]).tolist() for k in (0, 1))
    if len(corners) == 4 and len(low) == len(high) == 2:  # axhspan's, before Matplotlib 3.9
        return "rectangles", [low[0], high[0], low[1] - low[0], high[1] - high[0], 0.0]
    return "patches", patch.get_patch_transform().transform(patch.get_path().vertices)
