"""The values of an object that a cell shows, beside the text that rounds and shortens them.

Arrays, data frames, python-control's systems, xarray's objects, and lists, tuples and
dictionaries that hold some of these.
"""

import hashlib
import re
from typing import Any

from nbregress.mime import DATA_TYPE
from nbregress.summary import summarize

_WHOLE = 100  # numbers that are written out
_TEXTS = 200  # texts that are
_MEMBERS, _DEPTH = 50, 3
#: Types that are known, by module and name, so that nothing is imported for them.
KNOWN = [
    tuple(name.rsplit(".", 1))
    for name in "numpy.ndarray pandas.core.frame.DataFrame pandas.core.series.Series "
    "pandas.DataFrame pandas.Series pandas.core.indexes.base.Index pandas.Index "
    "xarray.core.dataarray.DataArray xarray.core.dataset.Dataset control.statesp.StateSpace "
    "control.xferfcn.TransferFunction control.frdata.FrequencyResponseData".split()
]


def data_bundle(value: Any, **_: Any) -> dict[str, Any] | None:
    """The digest of an object that IPython is about to show, by its type.

    Parameters
    ----------
    value : object

    Returns
    -------
    bundle : dict or None
        None if nothing in the object is known.
    """
    try:
        found = _digest(value, 0)
    except Exception:  # a stranger's object: its text is compared
        return None
    return None if found is None else {DATA_TYPE: found}


def _digest(value: Any, depth: int) -> dict[str, Any] | None:
    if isinstance(value, (list, tuple, dict)):
        if depth >= _DEPTH or not 0 < len(value) <= _MEMBERS:
            return None
        members = list(value.values() if isinstance(value, dict) else value)
        found = [_digest(member, depth + 1) for member in members]
        # What is not known is compared by its text, and then all of it.
        plain = (bool, int, float, complex, str, type(None))
        pairs = list(zip(found, members, strict=True))
        if not any(found) or not all(f or isinstance(m, plain) for f, m in pairs):
            return None
        result: dict[str, Any] = {
            "type": type(value).__name__,
            "members": [f or repr(m) for f, m in pairs],
        }
        if isinstance(value, dict):
            result["keys"] = [repr(key) for key in value]
        return result
    names = {(cls.__module__, cls.__name__) for cls in type(value).__mro__}
    if ("numpy", "ndarray") in names:
        own = type(value).__module__.startswith("numpy")  # others have units, or the like
        return array_digest(value) | ({} if own else {"and": "text"})
    if not names & set(KNOWN):
        return None
    kind = type(value).__name__
    if hasattr(value, "iloc"):
        frame = value.to_frame() if value.ndim == 1 else value
        columns = [frame.iloc[:, k] for k in range(frame.shape[1])]
        return {
            "type": kind,
            "names": [str(name) for name in frame.columns],
            "index": _column(frame.index),
            "columns": [_column(column) for column in columns],
            **_titles(index=frame.index.names, columns=frame.columns.names),
        }
    if hasattr(value, "get_indexer"):  # an index
        return {"type": kind, "index": _column(value), **_titles(index=value.names)}
    if kind in ("Dataset", "DataArray"):
        parts = value.variables if kind == "Dataset" else value.coords
        digest = {"type": kind, **{str(k): array_digest(v.values) for k, v in parts.items()}}
        digest |= _titles(name=[getattr(value, "name", None)], attributes=[value.attrs or None])
        if kind == "Dataset":
            return digest
        return digest | {"dims": list(map(str, value.dims)), **array_digest(value.values)}
    result = {"type": kind, "dt": repr(value.dt) if hasattr(value, "dt") else None}
    signals = [*getattr(value, "input_labels", ()), *getattr(value, "output_labels", ())]
    result |= _titles(signals=[s for s in signals if not re.fullmatch(r"[uy]\[\d+\]", s)])
    for name in ("A", "B", "C", "D", "omega", "frdata"):
        if hasattr(value, name):
            result[name] = array_digest(getattr(value, name))
    if kind == "TransferFunction":
        for name in ("num", "den"):
            rows = getattr(value, f"{name}_list", None) or getattr(value, name)
            result[name] = [[array_digest(entry) for entry in row] for row in rows]
    return result


def _titles(**texts: Any) -> dict[str, Any]:
    """Names that an author gave, as entries of a digest; none where there are none."""
    found = {name: [str(t) for t in given] for name, given in texts.items() if any(given)}
    return {"titles": found} if found else {}


def _column(column: Any) -> dict[str, Any]:
    import numpy as np

    kind = str(column.dtype)
    dates = kind.startswith(("datetime", "timedelta"))
    if dates or getattr(column, "nlevels", 1) > 1:
        name = kind.split("[")[0] if dates else "tuples"
        return {"dtype": name, "texts": _texts([str(v) for v in column])}
    digest = array_digest(np.asarray(column))
    if kind == "category":
        digest["categories"] = _texts([str(c) for c in getattr(column, "cat", column).categories])
    return digest


def array_digest(values: Any) -> dict[str, Any]:
    """Digest of an array of numbers or of anything else.

    Parameters
    ----------
    values : array_like

    Returns
    -------
    digest : dict
        Type, shape, and the values or their summary.

    Examples
    --------
    >>> array_digest([1.0, 2.5])
    {'dtype': 'float64', 'shape': [2], 'data': {'values': '1 2.5'}}
    """
    import numpy as np

    a: Any = np.ma.asarray(values) if np.ma.isMaskedArray(values) else np.asarray(values)
    name = str(a.dtype) if a.dtype.names else a.dtype.name
    result: dict[str, Any] = {"dtype": name, "shape": list(a.shape)}
    if a.dtype.kind == "O" and a.size and all(isinstance(v, float) for v in a.ravel()):
        a = a.astype(float)
    if a.dtype.kind == "c":
        parts = np.stack([a.real, a.imag], axis=-1)  # rounding leaves one beside the other
        result["data"] = {"real and imaginary parts": summarize(parts, whole=2 * _WHOLE)}
    elif a.dtype.kind == "f":
        result["data"] = {"values": summarize(a, whole=_WHOLE)}
    else:
        result["texts"] = _texts([str(v) for v in a.ravel().tolist()])
    return result


def _texts(texts: list[str]) -> Any:
    if len(texts) <= _TEXTS and sum(map(len, texts)) < 4000:
        return texts
    whole = hashlib.sha256("\0".join(texts).encode("utf-8", "replace")).hexdigest()
    return {"count": len(texts), "first": texts[:3], "last": texts[-3:], "sha256": whole[:16]}
