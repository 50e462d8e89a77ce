"""What each Matplotlib artist draws, in data coordinates.

Private attributes of Matplotlib are read where it has no public way to the data: the ends
of a FancyArrowPatch and the corners of three-dimensional collections.
"""

from typing import Any

from nbregress.summary import summarize

# Beyond this many, unlabelled lines of one axes are summarized together.
_SINGLE_LINES = 10
_PATCH_COLUMNS = {
    "rectangles": ("x", "y", "width", "height", "angle"),
    "arrows": ("x", "y", "to x", "to y"),
}
# Corners of three-dimensional collections, under the names Matplotlib has had for them.
_SOLID = ("_faces", "_vec", "_segments3d", "_offsets3d")


def artists_digest(owner: Any, *, xlog: bool = False, ylog: bool = False) -> list[dict[str, Any]]:
    """Digest of the visible artists of an axes or a figure.

    Parameters
    ----------
    owner : matplotlib.axes.Axes or matplotlib.figure.Figure
    xlog, ylog : bool
        Whether the axis is logarithmic.

    Returns
    -------
    items : list of dict
        ``kind``, ``label`` where there is one, ``count`` where several are taken together,
        and ``data``, a summary for each array.
    """

    def pair(points: Any) -> dict[str, str]:
        return {
            "x": summarize(points[:, 0], log=xlog),
            "y": summarize(points[:, 1], log=ylog),
        }

    found = _lines([line for line in owner.lines if line.get_visible()], xlog, ylog)
    for collection in getattr(owner, "collections", ()):
        if collection.get_visible():
            found.append(_collection(collection, pair))
    found += _patches([patch for patch in owner.patches if patch.get_visible()], pair)
    for image in owner.images:
        if image.get_visible():
            found.append(_image(image))
    placed = [t for c in getattr(owner, "collections", ()) for t in getattr(c, "labelTexts", ())]
    for text in owner.texts:
        if text.get_visible() and text.get_text() and text not in placed:
            found.append(_text(text))
    return found


def _label(artist: Any) -> dict[str, str]:
    label = str(artist.get_label())
    return {} if label.startswith("_") or not label else {"label": label}


def _lines(lines: list[Any], xlog: bool, ylog: bool) -> list[dict[str, Any]]:
    import numpy as np

    found: list[dict[str, Any]] = []
    unlabelled = [line for line in lines if not _label(line)]
    together = unlabelled if len(unlabelled) > _SINGLE_LINES else []
    before = None
    for line in lines:
        if line in together:
            continue
        item: dict[str, Any] = {"kind": "line", **_label(line)}
        if line.get_drawstyle() != "default":
            item["steps"] = line.get_drawstyle()
        if hasattr(line, "get_xy1"):  # the endless line of Axes.axline
            ends = [line.get_xy1(), line.get_xy2() or (line.get_slope(),)]
            item["data"] = {"through": summarize(np.concatenate([np.ravel(end) for end in ends]))}
        else:
            columns = _line_data(line)
            logs = (xlog, ylog, False)
            names = zip("xyz", columns, logs, strict=False)
            item["data"] = {name: summarize(column, log=log) for name, column, log in names}
            # Curves over one and the same grid say so once.
            if len(columns[0]) > 12 and item["data"]["x"] == before:
                del item["data"]["x"]
            else:
                before = item["data"]["x"]
        found.append(item)
    if together:
        every = [_line_data(line) for line in together]
        data = {"lengths": summarize([len(columns[0]) for columns in every])}
        for k, log in enumerate((xlog, ylog, False)[: len(every[0])]):
            data["xyz"[k]] = summarize(np.concatenate([c[k] for c in every]), log=log)
        found.append({"kind": "lines", "count": len(together), "data": data})
    return found


def _line_data(line: Any) -> list[Any]:
    import numpy as np

    columns = line.get_data_3d() if hasattr(line, "get_data_3d") else line.get_data(orig=False)
    return [np.ma.filled(np.ma.asarray(column, dtype=float), np.nan) for column in columns]


def _collection(artist: Any, pair: Any) -> dict[str, Any]:
    import numpy as np
    from matplotlib import collections, contour, quiver

    item: dict[str, Any] = {"kind": "collection", **_label(artist)}
    data: dict[str, str] = {}
    vectors: Any = artist
    solid = [getattr(artist, name, None) for name in _SOLID]
    if any(part is not None for part in solid):
        item["kind"] = "solid"
        parts = next(part for part in solid if part is not None)
        corners: list[Any] = [
            np.ravel(np.ma.filled(np.ma.asarray(part, float), np.nan)) for part in parts
        ]
        data = {"corners": summarize(np.concatenate([np.empty(0), *corners]))}
    elif isinstance(artist, (quiver.Quiver, quiver.Barbs)):
        item["kind"] = "arrows"
        places = artist.get_offsets()
        u, v = (vectors.U, vectors.V) if hasattr(vectors, "U") else (vectors.u, vectors.v)
        data = {**pair(places), "u": summarize(u), "v": summarize(v)}
    elif isinstance(artist, contour.ContourSet):
        item["kind"] = "filled contours" if artist.filled else "contours"
        data = {"levels": summarize(artist.levels), **_contours(artist)}
    elif isinstance(artist, collections.QuadMesh):
        item["kind"] = "mesh"
        data = pair(np.reshape(artist.get_coordinates(), (-1, 2)))
    elif isinstance(artist, collections.PathCollection):
        item["kind"] = "points"
        data = pair(artist.get_offsets())
        if len(artist.get_sizes()) > 1:
            data["sizes"] = summarize(artist.get_sizes())
    else:
        if isinstance(artist, collections.LineCollection):
            item["kind"] = "segments"
        elif isinstance(artist, collections.PolyCollection):
            item["kind"] = "area"
        paths = artist.get_paths()
        item["count"] = len(paths)
        data = pair(np.concatenate([np.empty((0, 2)), *(path.vertices for path in paths)]))
        if len(artist.get_offsets()) > 1:
            offsets = pair(artist.get_offsets())
            data["offset x"], data["offset y"] = offsets["x"], offsets["y"]
    if artist.get_array() is not None and not isinstance(artist, contour.ContourSet):
        data["values"] = summarize(artist.get_array())
        data["colour limits"] = summarize([np.nan if c is None else c for c in artist.get_clim()])
    item["data"] = data
    return item


def _contours(artist: Any) -> dict[str, str]:
    """Length and centre of each level's curves: no matter where a curve starts."""
    import numpy as np

    curves = [path.to_polygons(closed_only=False) for path in artist.get_paths()]
    if artist.labelTexts:
        # Labels cut the curves where there is room on paper: take them as computed.
        lines = getattr(getattr(artist, "_contour_generator", None), "lines", None)
        if lines is None:
            return {}
        curves = [lines(level)[0] for level in artist.levels]
    rows = []
    for level in curves:
        total = np.zeros(3)
        for points in level:
            step = np.diff(points, axis=0)
            length = np.hypot(step[:, 0], step[:, 1])
            middle = (points[:-1] + points[1:]) / 2.0
            total += (length.sum(), *(length @ middle))
        rows.append(total)
    lengths, x, y = np.reshape(rows, (-1, 3)).T
    return {"lengths": summarize(lengths), "x": summarize(x), "y": summarize(y)}


def _patches(patches: list[Any], pair: Any) -> list[dict[str, Any]]:
    import numpy as np
    from matplotlib.patches import FancyArrowPatch, Rectangle

    groups: dict[str, list[tuple[Any, Any]]] = {}
    for patch in patches:
        if isinstance(patch, Rectangle):
            corner, size = patch.get_xy(), (patch.get_width(), patch.get_height(), patch.angle)
            groups.setdefault("rectangles", []).append((patch, [*corner, *size]))
        elif isinstance(patch, FancyArrowPatch):
            ends = getattr(patch, "_posA_posB", None)
            if ends is None:
                vertices = getattr(patch, "_path_original").vertices  # noqa: B009
                groups.setdefault("arrow along a path", []).append((patch, vertices))
            else:
                groups.setdefault("arrows", []).append((patch, np.ravel(ends)))
        else:
            vertices = patch.get_patch_transform().transform(patch.get_path().vertices)
            groups.setdefault("patches", []).append((patch, vertices))
    found = []
    for kind, members in groups.items():
        item: dict[str, Any] = {"kind": kind, "count": len(members)}
        labels = [label["label"] for patch, _ in members if (label := _label(patch))]
        if labels:
            item["labels"] = labels
        if kind in _PATCH_COLUMNS:
            names = _PATCH_COLUMNS[kind]
            columns = np.array([row for _, row in members], dtype=float).T
            item["data"] = {name: summarize(c) for name, c in zip(names, columns, strict=True)}
        else:
            item["data"] = pair(np.concatenate([vertices for _, vertices in members]))
        found.append(item)
    return found


def _image(artist: Any) -> dict[str, Any]:
    values = artist.get_array()
    item: dict[str, Any] = {"kind": "image", **_label(artist), "shape": list(values.shape)}
    item["data"] = {"values": summarize(values), "colour limits": summarize(artist.get_clim())}
    if hasattr(artist, "get_extent"):
        item["data"]["extent"] = summarize(artist.get_extent())
    return item


def _text(artist: Any) -> dict[str, Any]:
    place = [*artist.get_position()]
    if hasattr(artist, "xyann"):
        place += [*artist.xy]
    try:
        data = {"at": summarize(place)}
    except (TypeError, ValueError):  # dates and categories as positions
        data = {}
    return {"kind": "text", "text": artist.get_text(), "data": data}
