"""What each Matplotlib artist draws, in data coordinates.

Private attributes of Matplotlib are read where it has no public way to the data: the corners
of three-dimensional collections, and what contours were computed from.
"""

import math
from typing import Any, NamedTuple

from nbregress.patches import classes, label_of, patches_digest
from nbregress.summary import summarize

# Beyond this many, unlabelled lines of one axes are summarized together.
_SINGLE_LINES = 10
_PLACES = ("x", "y", "to x", "to y")
# Corners of three-dimensional collections, under the names Matplotlib has had for them.
_SOLID = ("_faces", "_vec", "_segments3d", "_offsets3d")


class Side(NamedTuple):
    """How an axis shows its data.

    Parameters
    ----------
    log : bool
    window : float
        Width of chosen limits; infinite where they follow from the data.
    limits : tuple of float
    """

    log: bool = False
    window: float = math.inf
    limits: tuple[float, float] = (0.0, 0.0)

    def __call__(self, values: Any) -> str:
        """Summary of values along the axis."""
        beside = max(map(abs, self.limits))
        return summarize(values, log=self.log, window=self.window, beside=beside)


class View(NamedTuple):
    """The two sides of an axes."""

    x: Side = Side()
    y: Side = Side()

    def pair(self, points: Any) -> dict[str, str]:
        """Summary of points, shape (n, 2)."""
        return {"x": self.x(points[:, 0]), "y": self.y(points[:, 1])}


def artists_digest(owner: Any, view: View | None = None) -> list[dict[str, Any]]:
    """Digest of the visible artists of an axes or a figure.

    Parameters
    ----------
    owner : matplotlib.axes.Axes or matplotlib.figure.Figure
    view : View, optional

    Returns
    -------
    items : list of dict
        ``kind``, ``label`` where there is one, ``count`` where several are taken together,
        and ``data``, a summary for each array.
    """

    view = view or View()

    def seen(name: str) -> list[Any]:
        return [artist for artist in getattr(owner, name, ()) if artist.get_visible()]

    found = _lines(seen("lines"), view)
    found += [_collection(collection, view) for collection in seen("collections")]
    found += patches_digest(seen("patches"), view.pair)
    found += [_image(image) for image in seen("images")]
    placed = [t for c in getattr(owner, "collections", ()) for t in getattr(c, "labelTexts", ())]
    texts = [text for text in seen("texts") if text.get_text() and text not in placed]
    if any(hasattr(patch, "theta1") for patch in seen("patches")):
        texts.sort(key=lambda text: str(text.get_text()))  # a pie's, in another order since 3.11
    found += [_text(text, view) for text in texts]
    for table in seen("tables"):
        cells = sorted(table.get_celld().items())
        texts = [cell.get_text().get_text() for _, cell in cells]
        found.append(
            {"kind": "table", "places": [f"{r},{c}" for (r, c), _ in cells], "texts": texts}
        )
    # A legend is no artist of the data.
    return found + [_other(a) for a in seen("artists") if not hasattr(a, "legend_handles")]


def _lines(lines: list[Any], view: View) -> list[dict[str, Any]]:
    import numpy as np

    found: list[dict[str, Any]] = []
    unlabelled = [line for line in lines if not label_of(line)]
    together = unlabelled if len(unlabelled) > _SINGLE_LINES else []
    before = None
    summaries: tuple[Any, ...] = (view.x, view.y, summarize)
    for line in lines:
        if line in together:
            continue
        item: dict[str, Any] = {"kind": "line", **label_of(line)}
        if line.get_drawstyle() != "default":
            item["steps"] = line.get_drawstyle()
        if hasattr(line, "get_xy1"):  # the endless line of Axes.axline
            ends = [line.get_xy1(), line.get_xy2() or (line.get_slope(),)]
            item["data"] = {"through": summarize(np.concatenate([np.ravel(end) for end in ends]))}
        else:
            columns = _line_data(line)
            item["data"] = {
                name: summary(column)
                for name, summary, column in zip("xyz", summaries, columns, strict=False)
            }
            # Curves over one and the same grid say so once.
            if len(columns[0]) > 12 and item["data"]["x"] == before:
                del item["data"]["x"]
            else:
                before = item["data"]["x"]
        found.append(item)
    if together:
        every = [_line_data(line) for line in together]
        data = {"lengths": summarize([len(columns[0]) for columns in every])}
        for k, summary in enumerate(summaries[: len(every[0])]):
            data["xyz"[k]] = summary(np.concatenate([c[k] for c in every]))
        found.append({"kind": "lines", "count": len(together), "data": data})
    return found


def _line_data(line: Any) -> list[Any]:
    import numpy as np

    columns = line.get_data_3d() if hasattr(line, "get_data_3d") else line.get_data(orig=False)
    return [np.ma.filled(np.ma.asarray(column, dtype=float), np.nan) for column in columns]


def _collection(artist: Any, view: View) -> dict[str, Any]:
    import numpy as np
    from matplotlib import collections, contour, quiver

    item: dict[str, Any] = {"kind": "collection", **label_of(artist)}
    data: dict[str, str] = {}
    vectors: Any = artist
    if solid := [name for name in _SOLID if getattr(artist, name, None) is not None]:
        item["kind"] = "solid"
        data = _corners(getattr(artist, solid[0]))
    elif isinstance(artist, (quiver.Quiver, quiver.Barbs)):
        item["kind"] = "arrows"
        places = artist.get_offsets()
        u, v = (vectors.U, vectors.V) if hasattr(vectors, "U") else (vectors.u, vectors.v)
        size = float(np.hypot(u, v).max()) if np.size(u) else 0.0
        data = {**view.pair(places), "u": summarize(u, beside=size), "v": summarize(v, beside=size)}
        if isinstance(artist, quiver.Quiver):
            item["units"] = ", ".join(map(str, (artist.angles, artist.scale_units)))
            if artist.scale is not None and artist.scale_units is not None:
                data["scale"] = summarize([artist.scale])
    elif isinstance(artist, contour.ContourSet):
        item["kind"] = "filled contours" if artist.filled else "contours"
        data = {"levels": summarize(artist.levels), **_contours(artist)}
        if getattr(artist, "labelTexts", None):
            formats = artist.labelFmt
            item["labels"] = [artist.get_text(v, formats) for v in artist.labelLevelList]
            item["label format"] = formats if isinstance(formats, str) else ""
    elif isinstance(artist, collections.QuadMesh):
        item["kind"] = "mesh"
        data = view.pair(np.reshape(artist.get_coordinates(), (-1, 2)))
    elif isinstance(artist, collections.PathCollection):
        item["kind"] = "points"
        data = view.pair(artist.get_offsets())
        if len(artist.get_sizes()) > 1:
            data["sizes"] = summarize(artist.get_sizes())
    else:
        if isinstance(artist, collections.LineCollection):
            item["kind"] = "segments"
        elif isinstance(artist, collections.PolyCollection):
            item["kind"] = "area"
        paths = artist.get_paths()
        item["count"] = len(paths)
        data = view.pair(np.concatenate([np.empty((0, 2)), *(path.vertices for path in paths)]))
        if len(artist.get_offsets()) > 1:
            offsets = view.pair(artist.get_offsets())
            data["offset x"], data["offset y"] = offsets["x"], offsets["y"]
    if isinstance(artist, contour.ContourSet):
        item |= _norm(artist, data)
    elif artist.get_array() is not None:
        data["values"] = summarize(artist.get_array())
        data["colour limits"] = summarize([np.nan if c is None else c for c in artist.get_clim()])
        item |= _norm(artist, data)
    else:
        line = item["kind"] == "segments"
        data |= classes(artist.get_edgecolor() if line else artist.get_facecolor())
    item["data"] = data
    return item


def _norm(artist: Any, data: dict[str, str]) -> dict[str, str]:
    """Name of an unusual norm; what it makes of its range goes to the data."""
    import numpy as np

    name = type(artist.norm).__name__
    low, high = artist.get_clim()
    if name not in ("Normalize", "NoNorm", "LogNorm") and low is not None:
        data["shades"] = summarize(artist.norm(np.linspace(low, high, 65)))
    return {} if name in ("Normalize", "NoNorm") else {"norm": name}


def _corners(parts: Any) -> dict[str, str]:
    """Corners of solids, whatever the order of their faces, counted once each."""
    import numpy as np

    filled: list[Any] = [np.ma.filled(np.ma.asarray(part, float), np.nan) for part in parts]
    if not filled or filled[0].ndim == 1:  # a row for each coordinate
        points = np.stack(filled[:3], axis=1) if filled else np.empty((0, 3))
    else:
        points = np.concatenate([part.reshape(-1, 3) for part in filled])
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return {}
    span = np.ptp(points, axis=0).max() or 1.0
    _, first = np.unique(np.round(points / span, 7), axis=0, return_index=True)
    points = points[first]
    q = points - points.mean(axis=0)
    skew, mixed = np.cbrt((q**3).mean(axis=0)), (q * np.roll(q, 1, axis=1)).mean(axis=0) / span
    parts = [points.min(0), points.max(0), points.mean(0), q.std(0), skew, mixed]
    return {
        name: summarize([part[k] for part in parts], beside=1e3 * span)
        for k, name in enumerate("xyz")
    }


def _contours(artist: Any) -> dict[str, str]:
    """Length, centre and spread of each level's curves: no matter where a curve starts."""
    import numpy as np

    curves = [path.to_polygons(closed_only=False) for path in artist.get_paths()]
    if getattr(artist, "labelTexts", None):
        # Labels cut the curves where there is room on paper: take them as computed.
        lines = getattr(getattr(artist, "_contour_generator", None), "lines", None)
        if lines is None:
            return {}
        curves = [lines(level)[0] for level in artist.levels]
    rows: list[Any] = []
    for level in curves:
        total, size = np.zeros(7), np.zeros(7)
        for points in level:
            step = np.diff(points, axis=0)
            length = np.hypot(step[:, 0], step[:, 1])
            x, y = ((points[:-1] + points[1:]) / 2.0).T
            terms = np.stack([np.ones_like(x), x, y, x * y, x**2, x**3, y**3])
            total += terms @ length
            size += np.abs(terms) @ length
        rows.append(np.where(np.abs(total) < 1e-9 * size, 0.0, total))
    columns = np.reshape(rows, (-1, 7)).T
    names = ("lengths", "x", "y", "xy", "xx", "xxx", "yyy")
    return {name: summarize(column) for name, column in zip(names, columns, strict=True)}


def _image(artist: Any) -> dict[str, Any]:
    values = artist.get_array()
    item: dict[str, Any] = {"kind": "image", **label_of(artist), "shape": list(values.shape)}
    item["data"] = {"values": summarize(values), "colour limits": summarize(artist.get_clim())}
    if hasattr(artist, "get_extent"):
        item["data"]["extent"] = summarize(artist.get_extent())
    return {**item, **_norm(artist, item["data"])}


def _text(artist: Any, view: View) -> dict[str, Any]:
    place, units = [*artist.get_position()], [True, True]
    item: dict[str, Any] = {"kind": "text", "text": artist.get_text()}
    if hasattr(artist, "xyann"):
        place += [*artist.xy]
        units = [name == "data" for name in (artist.anncoords, artist.xycoords) for _ in "xy"]
        if artist.arrow_patch is not None and artist.arrow_patch.get_visible():
            item["arrow"] = True
    # Each by itself: an offset in points stands beside a place in data.
    spans = [abs(side.limits[1] - side.limits[0]) for side in view] * 2
    try:
        data = {
            name: summarize([value], scale=span if own else 0.0)
            for name, value, span, own in zip(_PLACES, place, spans, units, strict=False)
        }
    except (TypeError, ValueError):  # dates and categories as positions
        data = {}
        item["at"] = [str(value) for value in place]
    return {**item, "data": data}


def _other(artist: Any) -> dict[str, Any]:
    """Boxes with text, and the key of an arrow field."""
    from matplotlib.quiver import QuiverKey

    if isinstance(artist, QuiverKey):
        return {"kind": "key", "text": artist.text.get_text(), "data": {"u": summarize([artist.U])}}
    texts = [t.get_text() for t in artist.findobj(lambda a: hasattr(a, "get_text")) if t.get_text()]
    return {"kind": type(artist).__name__, "text": "\n".join(dict.fromkeys(texts))}
