"""A short text that stands for an array, and the comparison of two of them.

Few values are written out. Of more, the text keeps the count, the extremes, nine values
spread over the array and weighted sums of all values, four for each thousand. The weights are
fixed pseudo-random numbers of modulus 0.5 to 1.5, so any single value that changes moves each
sum, while last-digit noise hardly adds up. The second sum of each pair weights by position
too: the quotient of the two changes is where a single changed value sits.
"""

import itertools
import math
from typing import Any, NamedTuple

_WHOLE = 12
_SAMPLES = 9
_SEEDS = (1, 2)
# Values to a block of sums, the most blocks, and the values that are taken at a time.
_BLOCK, _BLOCKS, _CHUNK = 1000, 16, 1 << 17
_DIGITS = 8
# On a logarithmic axis, decades below the maximum (or below 1) that are rounding noise.
_FLOOR = 1e-12
# Rounding leaves this much of the largest value, writing with eight digits this much of a range.
_RESIDUE, _WRITTEN = 1000 * 2.0**-52, 1e-7


class _Summary(NamedTuple):
    log: bool
    window: float
    size: int
    gaps: str
    extremes: list[float]
    sample: list[float]
    sums: list[float]


def summarize(
    values: Any,
    *,
    log: bool = False,
    window: float = math.inf,
    whole: int = _WHOLE,
    beside: float = 0.0,
    scale: float = 0.0,
) -> str:
    """Summary of an array as one line of text.

    Parameters
    ----------
    values : array_like
        Real numbers; masked, NaN and infinite ones count as gaps.
    log : bool
        Summarize log10 of the values, as a logarithmic axis shows them.
    window : float > 0
        How much of the range is in view.
    beside : float >= 0
        The largest value beside these: what is rounding of it counts as zero, and as no range.
    scale : float > 0
        What a tolerance refers to, in place of the values' range.
    whole : int
        How many values are written out.

    Returns
    -------
    text : str

    Examples
    --------
    >>> summarize([0.0, 0.5, -1.0])
    '0 0.5 -1'
    >>> summarize(range(100))
    '100 | 0 99 | 0 12 25 37 50 62 74 87 99 | 263.41344 155.29335 244.20561 115.37191'
    """
    import numpy as np

    v: Any = np.ma.asarray(values).ravel()
    masked = np.ma.getmaskarray(v) if np.ma.is_masked(v) else None
    v = np.ma.getdata(v)
    if v.dtype.kind not in "fiub":
        v = v.astype(float)
    if masked is not None:
        v = np.where(masked, np.nan, v)
    prefix = f"={scale:.3g} " if scale else ""
    if beside and not log:
        v = np.where(np.abs(v) < _RESIDUE * beside, 0.0, v)
    if log:
        v = v.astype(float)
        top = v[np.isfinite(v)].max(initial=0.0)
        v = np.log10(np.maximum(v, _FLOOR * min(1.0, top) or _FLOOR))
        prefix = "log10 "
    finite = np.isfinite(v)
    every = finite.all()
    inside = v if every else v[finite]
    low, high = (float(inside.min()), float(inside.max())) if inside.size else (0.0, 0.0)
    if window < high - low:
        prefix += f"~{window:.3g} "
    if not (log or scale) and 0.0 < high - low < _RESIDUE * beside:  # flat, but for rounding
        prefix = f"={_RESIDUE * beside / _WRITTEN:.3g} "
    # A small signal on a large offset needs more digits.
    spread = min(high - low, window) or 1.0
    ratio = max(abs(low), abs(high)) / spread
    digits = min(_DIGITS + max(math.ceil(math.log10(ratio)), 0) if ratio > 0 else _DIGITS, 16)
    if v.size <= whole:
        return prefix + _join(v, digits)
    sums = [_sums(v, start, end, every) for start, end in _blocks(v.size)]
    parts = [
        str(v.size),
        _join([low, high] if inside.size else [], digits),
        _join(v[_sample_indices(v.size)], digits),
        _join([total for block in sums for total in block], digits),
    ]
    if not every:
        gaps = np.flatnonzero(~finite)
        ends = [str((np.flatnonzero(v == end) + 1).sum()) for end in (np.inf, -np.inf)]
        parts.append(
            f"{gaps.size} gaps {gaps.sum()}" + f" inf {' '.join(ends)}" * (ends != ["0"] * 2)
        )
    return prefix + " | ".join(parts)


def _blocks(size: int) -> list[tuple[int, int]]:
    count = min(math.ceil(size / _BLOCK), _BLOCKS)
    ends = [round(k * size / count) for k in range(count + 1)]
    return list(itertools.pairwise(ends))


def _sums(v: Any, start: int, end: int, every: bool) -> list[float]:
    import numpy as np

    sums = [0.0] * (2 * len(_SEEDS))
    for first in range(start, end, _CHUNK):
        last = min(first + _CHUNK, end)
        part = v[first:last].astype(float)
        if not every:
            part = np.where(np.isfinite(part), part, 0.0)
        position = (np.arange(first, last) - start) / max(end - start - 1, 1)
        for k, seed in enumerate(_SEEDS):
            weighted = _weights(first, last, seed) * part
            sums[2 * k] += float(weighted.sum())
            sums[2 * k + 1] += float((weighted * position).sum())
    return sums


def difference(
    stored: str, new: str, *, rtol: float, atol: float, each: bool = False
) -> str | None:
    """What differs between two summaries, or None.

    A value may differ by ``rtol`` times the range of its array, plus ``atol``.

    Parameters
    ----------
    stored, new : str
        Results of `summarize`.
    rtol, atol : float >= 0
    each : bool
        A value that is written out may differ by ``rtol`` times itself only, plus what
        rounding leaves of the largest one.

    Returns
    -------
    message : str or None

    Examples
    --------
    >>> difference("0 0.5 -1", "0 0.505 -1", rtol=1e-6, atol=1e-12)
    'point 2 of 3: 0.505, stored 0.5 (difference 0.005, allowed 1.7e-06)'
    """
    if stored == new:
        return None
    a, b = _parse(stored), _parse(new)
    if a.log != b.log:
        return "logarithmic in one, linear in the other"
    if a.size != b.size:
        return f"{b.size} points, stored {a.size}"
    if a.gaps != b.gaps:
        return (
            f"gaps (NaN, infinities) at other points: {b.gaps or 'none'}, stored {a.gaps or 'none'}"
        )
    finite = [x for x in (*a.extremes, *b.extremes) if math.isfinite(x)]
    largest = max(map(abs, finite), default=0.0)
    spread = min(max(finite, default=0.0) - min(finite, default=0.0), a.window, b.window)
    spread = abs(spread)  # a window below zero is a scale
    allowed = atol + _RESIDUE * largest + (rtol + _WRITTEN) * (spread or largest)
    places = _sample_indices(a.size) if a.sums else range(a.size)
    differences = []
    for i, x, y in zip(places, a.sample, b.sample, strict=True):
        own = allowed
        if each:
            size = max(abs(x), abs(y)) if math.isfinite(x + y) else 0.0
            own = atol + (rtol + _WRITTEN) * size + _RESIDUE * largest
        differences.append((_distance(x, y) - own, f"point {i + 1} of {a.size}", x, y, own))
    located = _locate(a, b, allowed)
    if located is not None and max(d for d, *_ in differences) <= 0.0:
        return located
    if a.sums:
        for name, x, y in zip(("minimum", "maximum"), a.extremes, b.extremes, strict=False):
            differences.append((_distance(x, y) - allowed, name, x, y, allowed))
    if not differences:
        return None
    excess, name, x, y, own = max(differences, key=lambda item: item[0])
    if excess <= 0.0 or math.isnan(excess):
        return None
    unit = ", in decades" if a.log else ""
    gap = f"difference {_distance(x, y):.3g}, allowed {own:.2g}{unit}"
    return f"{name}: {y:.8g}, stored {x:.8g} ({gap})"


def _locate(a: _Summary, b: _Summary, allowed: float) -> str | None:
    """The change seen by the weighted sums, with its place if it is a single point's."""
    for k, (start, end) in enumerate(_blocks(a.size) if a.sums else ()):
        size = end - start
        # Independent noise adds up as the root of the count; 2 is above the weights' 1.5.
        bound = 2.0 * allowed * math.sqrt(size)
        moves = [y - x for x, y in zip(a.sums[4 * k :][:4], b.sums[4 * k :][:4], strict=True)]
        if all(abs(move) <= bound for move in moves):
            continue
        places = [moves[j + 1] / moves[j] * (size - 1) if moves[j] else -1.0 for j in (0, 2)]
        index = round(places[0])
        if not (abs(places[0] - places[1]) < 1.0 and 0 <= index < size):
            return f"several of the {a.size} points differ, between those sampled"
        index += start
        change = moves[0] / _weights(index, index + 1, _SEEDS[0])[0]
        return f"point {index + 1} of {a.size} differs by {change:.3g} (allowed {allowed:.2g})"
    return None


def _weights(start: int, end: int, seed: int) -> Any:
    """Fixed pseudo-random weights (splitmix64), the same with every NumPy."""
    import numpy as np

    z = np.arange(start + 1, end + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z += np.uint64(seed << 32)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    unit = (z >> np.uint64(11)).astype(float) * 2.0**-53
    return np.where(z & np.uint64(1), -1.0, 1.0) * (0.5 + unit)


def _sample_indices(size: int) -> list[int]:
    return [round(k * (size - 1) / (_SAMPLES - 1)) for k in range(_SAMPLES)]


def _join(values: Any, digits: int) -> str:
    return " ".join(f"{float(value) + 0.0:.{digits}g}" for value in values)


def _parse(text: str) -> _Summary:
    log = text.startswith("log10")
    text = text.removeprefix("log10").strip()
    window = math.inf
    if text.startswith(("~", "=")):
        first, _, text = text.partition(" ")
        window = float(first[1:]) * (1 if first[0] == "~" else -1)
    parts = text.split("|")
    lists = [[float(word) for word in part.split()] for part in parts[:4]]
    if len(parts) == 1:
        return _Summary(log, window, len(lists[0]), "", lists[0], lists[0], [])
    return _Summary(log, window, int(lists[0][0]), "".join(parts[4:]).strip(), *lists[1:])


def _distance(x: float, y: float) -> float:
    if math.isnan(x) or math.isnan(y) or math.isinf(x) or math.isinf(y):
        return 0.0 if x == y or (math.isnan(x) and math.isnan(y)) else math.inf
    return abs(x - y)
