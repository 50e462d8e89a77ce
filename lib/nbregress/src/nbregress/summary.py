"""A short text that stands for an array, and the comparison of two of them.

Up to 12 values are written out. Of more, the text keeps the count, the extremes, nine
values spread over the array and four weighted sums of all values. The weights are fixed
pseudo-random numbers of modulus 0.5 to 1.5, so any single value that changes moves each
sum, while last-digit noise hardly adds up. The second sum of each pair weights by position
too: the quotient of the two changes is where a single changed value sits.
"""

import math
from typing import Any, NamedTuple

_WHOLE = 12
_SAMPLES = 9
_SEEDS = (1, 2)
# On a logarithmic axis everything below this counts as this: rounding noise.
_FLOOR = 1e-12


class _Summary(NamedTuple):
    log: bool
    size: int
    gaps: str
    extremes: list[float]
    sample: list[float]
    sums: list[float]


def summarize(values: Any, *, log: bool = False) -> str:
    """Summary of an array as one line of text.

    Parameters
    ----------
    values : array_like
        Real numbers; masked, NaN and infinite ones count as gaps.
    log : bool
        Summarize log10 of the values, as a logarithmic axis shows them.

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

    v: Any = np.ma.filled(np.ma.asarray(values, dtype=float).ravel(), np.nan)
    if log:
        v = np.log10(np.maximum(v, _FLOOR))
    prefix = "log10 " if log else ""
    if v.size <= _WHOLE:
        return prefix + _join(v)
    finite = np.isfinite(v)
    filled = np.where(finite, v, 0.0)
    extremes = [v[finite].min(), v[finite].max()] if finite.any() else []
    position = np.linspace(0.0, 1.0, v.size)
    sums = []
    for seed in _SEEDS:
        weighted = _weights(v.size, seed) * filled
        sums += [weighted.sum(), (weighted * position).sum()]
    parts = [str(v.size), _join(extremes), _join(v[_sample_indices(v.size)]), _join(sums)]
    if not finite.all():
        gaps = np.flatnonzero(~finite)
        parts.append(f"{gaps.size} gaps {gaps.sum()}")
    return prefix + " | ".join(parts)


def difference(stored: str, new: str, *, rtol: float, atol: float) -> str | None:
    """What differs between two summaries, or None.

    A value may differ by ``rtol`` times the largest modulus in its array, plus ``atol``.

    Parameters
    ----------
    stored, new : str
        Results of `summarize`.
    rtol, atol : float >= 0

    Returns
    -------
    message : str or None

    Examples
    --------
    >>> difference("0 0.5 -1", "0 0.505 -1", rtol=1e-6, atol=1e-12)
    'point 2 of 3: 0.505, stored 0.5 (difference 0.005, allowed 1e-06)'
    """
    if stored == new:
        return None
    a, b = _parse(stored), _parse(new)
    if a.log != b.log:
        return "logarithmic in one, linear in the other"
    if a.size != b.size:
        return f"{b.size} points, stored {a.size}"
    if a.gaps != b.gaps:
        return f"gaps (NaN) at other points: {b.gaps or 'none'}, stored {a.gaps or 'none'}"
    finite = [abs(x) for x in (*a.extremes, *b.extremes) if math.isfinite(x)]
    allowed = rtol * max(finite, default=0.0) + atol
    places = _sample_indices(a.size) if a.size > _WHOLE else range(a.size)
    differences = [
        (_distance(x, y), f"point {i + 1} of {a.size}", x, y)
        for i, x, y in zip(places, a.sample, b.sample, strict=True)
    ]
    located = _locate(a, b, allowed)
    if located is not None and max(d for d, *_ in differences) <= allowed:
        return located
    for name, x, y in zip(("minimum", "maximum"), a.extremes, b.extremes, strict=False):
        differences.append((_distance(x, y), name, x, y))
    worst, name, x, y = max(differences, key=lambda item: item[0])
    if worst <= allowed:
        return None
    unit = ", in decades" if a.log else ""
    return f"{name}: {y:g}, stored {x:g} (difference {worst:.3g}, allowed {allowed:.2g}{unit})"


def _locate(a: _Summary, b: _Summary, allowed: float) -> str | None:
    """The change seen by the weighted sums, with its place if it is a single point's."""
    # Independent noise adds up as the root of the count; 2 is above the weights' 1.5.
    bound = 2.0 * allowed * math.sqrt(a.size)
    moves = [y - x for x, y in zip(a.sums, b.sums, strict=True)]
    if all(abs(move) <= bound for move in moves):
        return None
    places = [moves[k + 1] / moves[k] * (a.size - 1) if moves[k] else -1.0 for k in (0, 2) if moves]
    index = round(places[0])
    same = abs(places[0] - places[1]) < 1.0 and 0 <= index < a.size
    if not same:
        return f"several of the {a.size} points differ, between those sampled"
    change = moves[0] / _weights(a.size, _SEEDS[0])[index]
    return f"point {index + 1} of {a.size} differs by {change:.3g} (allowed {allowed:.2g})"


def _weights(size: int, seed: int) -> Any:
    """Fixed pseudo-random weights (splitmix64), the same with every NumPy."""
    import numpy as np

    z = np.arange(1, size + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z += np.uint64(seed << 32)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    unit = (z >> np.uint64(11)).astype(float) * 2.0**-53
    return np.where(z & np.uint64(1), -1.0, 1.0) * (0.5 + unit)


def _sample_indices(size: int) -> list[int]:
    return [round(k * (size - 1) / (_SAMPLES - 1)) for k in range(_SAMPLES)]


def _join(values: Any) -> str:
    return " ".join(f"{float(value) + 0.0:.8g}" for value in values)


def _parse(text: str) -> _Summary:
    log = text.startswith("log10")
    parts = text.removeprefix("log10").split("|")
    lists = [[float(word) for word in part.split()] for part in parts[:4]]
    if len(parts) == 1:
        return _Summary(log, len(lists[0]), "", lists[0], lists[0], [])
    return _Summary(log, int(lists[0][0]), "".join(parts[4:]).strip(), *lists[1:])


def _distance(x: float, y: float) -> float:
    if math.isnan(x) or math.isnan(y) or math.isinf(x) or math.isinf(y):
        return 0.0 if x == y or (math.isnan(x) and math.isnan(y)) else math.inf
    return abs(x - y)
