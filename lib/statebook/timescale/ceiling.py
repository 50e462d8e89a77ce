"""What no motion can exceed: a bound on s'^2 along the path, and the least time it leaves.

Where tau = a u + b x + c with x = s'^2 and u = x'/2 is at most tau_max and a keeps its sign,

    d/ds (a^2 E x) = 2 a E (tau - c),   E = exp(integral of 2 (b - a')/a),

so that both bounds on tau bound the change of a^2 E x over an interval: for the acceleration of a
joint, where b = a' and E = 1, the change of the square of its velocity. These inequalities, and
those that hold at single points, are necessary. The largest x that satisfies them all lies above
every motion, and the time it takes below every time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from statebook.timescale.bernstein import along
from statebook.timescale.grid import Grid, Section
from statebook.timescale.limits import Limit
from statebook.timescale.profile import travel_time

_COUNT = 5
_NODES = (1 - np.cos(np.linspace(0, np.pi, _COUNT))) / 2  # of each interval
_ORDERS = np.arange(_COUNT)
_TO_POWERS = np.linalg.inv(_NODES[:, None] ** _ORDERS)
_SLOPES = (_ORDERS * _NODES[:, None] ** np.maximum(_ORDERS - 1, 0)) @ _TO_POWERS
_AREAS = (_NODES[:, None] ** (_ORDERS + 1) / (_ORDERS + 1)) @ _TO_POWERS  # from 0 to the nodes
_FLAT = 1e-6  # part of a row's largest a in the interval that counts as 0
_STEEP = 1.0  # log E may change by so much in an interval, or the inequality is left out
_ROUGH = 1e-2  # the highest power in it may be so large
_REST = 0.1  # what comes beyond the highest power is smaller than this part of it
_ROUNDING = 1e-9
_QUIET = np.errstate(divide="ignore", invalid="ignore", over="ignore")
_SAME = 1e-8  # part by which a given s'^2 may be above the bound
_BLOCK = 2000  # intervals at a time
_NEWTON = 30
_ANY = 1e150  # stands for no bound
_BEND = 1.2  # between nodes bounds are taken for quadratics, bent by this much more


class Ceiling(NamedTuple):
    """Bounds on every motion: s'^2 at both ends of the intervals, (2, N), and their times (N,).

    Where there can be no motion, it is not possible.
    """

    x: np.ndarray
    times: np.ndarray
    possible: bool

    @property
    def duration(self) -> float:
        """Time that no motion is below."""
        return float(self.times.sum())


@_QUIET
def ceiling(limits: Sequence[Limit], grid: Grid) -> Ceiling:
    """Bound every motion from above.

    Parameters
    ----------
    limits : sequence of Limit
    grid : Grid
        The finer it is, the sharper is the bound.
    """
    blocks = [slice(first, first + _BLOCK) for first in range(0, len(grid.h), _BLOCK)]
    parts = [_changes_and_caps(limits, grid.part(block)) for block in blocks]
    x, possible = _highest_motion(parts, grid.sections)
    times = [
        _least_times(*part, x[:, block], grid.h[block])
        for part, block in zip(parts, blocks, strict=True)
    ]
    return Ceiling(x, np.concatenate(times), possible)


@_QUIET
def maximum_speeds(limits: Sequence[Limit], grid: Grid, s: np.ndarray) -> np.ndarray:
    """Return the largest s' for which some s'' satisfies all limits at s, shape (N,)."""
    grid = grid.at(s)
    rows = [limit.inequalities(grid, np.zeros(1)) for limit in limits]
    a, b, lower, upper = (np.concatenate(values, axis=2) for values in zip(*rows, strict=True))
    a = np.where(np.abs(a) > 1e-12 * np.abs(a).max(axis=(0, 1)), a, 0.0)
    return np.asarray(np.sqrt(_highest(a, b, lower, upper)[0]) / grid.stretch)


class Changes(NamedTuple):
    """Bounds at the nodes of the intervals: low <= m x - m0 x0 <= high, each (K, N, R).

    m is the square of the pace of the row, in whose own coordinate, the integral of the pace, m x
    is the square of the speed. x0 and m0 are those at the left end. Where the pace vanishes
    within, at a turn of the row, the parts on both sides stand alone: low <= -m0 x0 to the left of
    it, m x <= high to the right.
    """

    pace: np.ndarray  # a sqrt(E)
    low: np.ndarray
    high: np.ndarray
    turn: np.ndarray  # (N, R), bool
    push: np.ndarray  # (N, R), the fastest change of the root of m x in time


def _changes_and_caps(limits: Sequence[Limit], grid: Grid) -> tuple[Changes, np.ndarray]:
    """Return the changes of all rows, and the cap on x (K, N) at the nodes of the intervals."""
    cap = np.full((_COUNT, len(grid.h)), np.inf)
    rows, changes = [], []
    for limit in limits:
        a, b, lower, upper = limit.inequalities(grid, _NODES)
        if limit.squared:
            highest = (1 + _ROUNDING + limit.margin) / np.maximum(b.max(axis=2), 1e-300)
            cap = np.minimum(cap, highest)
            continue
        lower, upper = lower - limit.margin, upper + limit.margin
        a = np.where(np.abs(a) > _FLAT * np.abs(a).max(axis=0), a, 0.0)
        changes.append(_changes(a, b, lower, upper, grid.h))
        rows.append([v[[0, -1]] for v in (a, b, lower, upper)])
    every = Changes(*(np.concatenate(values, axis=-1) for values in zip(*changes, strict=True)))
    a, b, lower, upper = (np.concatenate(values, axis=2) for values in zip(*rows, strict=True))
    # The same for x at one end and at the other, in the place of x and u.
    m0, m1 = every.pace[[0, -1]] ** 2
    low = np.where(every.turn, -np.inf, every.low[-1])
    high = np.where(every.turn, np.inf, every.high[-1])
    ends = [(a, m1, -m0), (b, -m0, m1), (lower, low, low), (upper, high, high)]
    found = _highest(*(np.concatenate([v, [left, right]]) for v, left, right in ends))
    cap[[0, -1]] = np.minimum(cap[[0, -1]], np.minimum(found[:2], found[2:]))
    return every, cap


def _changes(
    a: np.ndarray, b: np.ndarray, lower: np.ndarray, upper: np.ndarray, h: np.ndarray
) -> Changes:
    """Return the changes of m x with m = a^2 E."""
    h = h[:, None]
    drift = b - along(_SLOPES, a) / h
    size = np.abs(a).max(axis=0)
    small = np.abs(drift) <= _ROUNDING * (np.abs(b).max(axis=0) + size / h)
    rate = np.where(small, 0.0, 2 * h * drift / a)
    forward, backward = (a >= 0).all(axis=0), (a <= 0).all(axis=0)
    usable = (forward | backward) & (size > 0) & (np.abs(rate) <= _STEEP).all(axis=0)
    rate = np.where(usable, rate, 0.0)
    rest = np.abs(along(_TO_POWERS[-1:], rate)[0])
    usable &= rest <= _ROUGH
    root = np.exp(along(_AREAS, rate / 2))
    weight = 2 * h * a * root**2
    pushes = [
        weight * np.where(np.isfinite(v), v, 0.0)
        for v in (np.where(forward, lower, upper), np.where(forward, upper, lower))
    ]
    low, high = (along(_AREAS, push) for push in pushes)
    off = [
        (_ROUNDING + _REST * rest) * np.abs(push).max(axis=0)
        + _REST * np.abs(along(_TO_POWERS[-1:], push)[0])
        for push in pushes
    ]
    low -= np.where(_NODES[:, None, None] > 0, off[0], 0.0)
    high += np.where(_NODES[:, None, None] > 0, off[1], 0.0)
    free = ~np.isfinite(lower).all(axis=0), ~np.isfinite(upper).all(axis=0)
    low[:, ~usable | np.where(forward, *free)] = -np.inf
    high[:, ~usable | np.where(forward, *free[::-1])] = np.inf
    turn = small.all(axis=0) & (np.count_nonzero(np.diff(a > 0, axis=0), axis=0) == 1)
    turn &= ~(forward | backward)
    if turn.any():
        low[:, turn], high[:, turn] = _beside_turn(
            a[:, turn], lower[:, turn], upper[:, turn], np.broadcast_to(h, turn.shape)[turn]
        )
    bound = np.maximum(np.abs(lower), np.abs(upper)) * root
    push = np.where(usable | turn, bound.max(axis=0), np.inf)
    return Changes(a * root, low, high, turn, push)


def _beside_turn(
    a: np.ndarray, lower: np.ndarray, upper: np.ndarray, h: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return low and high (K, C) where a changes its sign once and E = 1."""
    powers = _TO_POWERS @ a
    change, every = np.diff(a > 0, axis=0).argmax(axis=0), np.arange(len(h))
    first, last = _NODES[change], _NODES[change + 1]
    before, after = a[change, every], a[change + 1, every]
    left = first + (last - first) * before / (before - after)
    slopes = powers[1:] * _ORDERS[1:, None]
    for _ in range(4):
        slope = np.polynomial.polynomial.polyval(left, slopes, tensor=False)
        value = np.polynomial.polynomial.polyval(left, powers, tensor=False)
        step = np.divide(value, slope, out=np.zeros_like(value), where=slope != 0)
        left = np.clip(left - step, first, last)
    bound = np.where(a[-1] > 0, upper, lower)
    finite = np.isfinite(bound).all(axis=0)
    weight = _TO_POWERS @ (2 * h * a * np.where(finite, bound, 0.0))
    area = np.polynomial.polynomial.polyint(weight)
    at = np.polynomial.polynomial.polyval(_NODES, area).T
    turn = np.polynomial.polynomial.polyval(left, area, tensor=False)
    node = _NODES[:, None]
    off = _ROUNDING * np.abs(at).max(axis=0) + _REST * np.abs(weight[-1])
    low = np.where((node < left) & finite, at - off, np.inf)
    low[-1] = np.where(finite, turn - off, -np.inf)
    return low, np.where((node > left) & finite, at - turn + off, np.inf)


def _highest(a: np.ndarray, b: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return the largest x for which some u satisfies lower <= a u + b x <= upper in all rows.

    All arguments are (..., R). The least u that the rows allow is convex in x, the greatest
    concave: from above, Newton's method comes down to where they meet, and never below.
    """
    flat = a == 0
    direct = np.where(b > 0, upper, lower) / b
    x = np.where(flat & (b != 0) & (direct >= 0), direct, _ANY).min(axis=-1)
    pole = np.where(flat, 1.0, a)
    slope = -b / pole
    low = np.where(flat, -np.inf, np.where(a > 0, lower, upper) / pole)
    high = np.where(flat, np.inf, np.where(a > 0, upper, lower) / pole)
    shape, x = x.shape, x.ravel()
    low, high, slope = (v.reshape(len(x), -1) for v in (low, high, slope))
    falling = np.arange(len(x))
    for _ in range(_NEWTON):
        every, line = np.arange(len(falling)), slope * x[falling, None]
        least, most = (low + line).argmax(axis=1), (high + line).argmin(axis=1)
        steep = slope[every, least] - slope[every, most]
        meet = np.maximum((high[every, most] - low[every, least]) / steep, 0.0)
        on = (steep > 0) & (meet < x[falling] * (1 - 1e-12))
        if not on.any():
            break
        falling = falling[on]
        x[falling] = meet[on]
        low, high, slope = low[on], high[on], slope[on]
    x = x.reshape(shape)
    return np.where(x >= _ANY, np.inf, x * (1 + _ROUNDING))


def _highest_motion(
    parts: Sequence[tuple[Changes, np.ndarray]], sections: Sequence[Section]
) -> tuple[np.ndarray, bool]:
    """Return the largest x at both ends of all intervals, (2, N), and whether there is any."""
    possible = True
    ends = [(*c.pace[[0, -1]] ** 2, c.low[-1], c.high[-1], c.turn) for c, _ in parts]
    m0, m1, low, high, turn = (np.concatenate(values) for values in zip(*ends, strict=True))
    gain, loss = (np.where((d > 0) & ~turn, n / d, 0.0) for n, d in ((m0, m1), (m1, m0)))
    more, less = (np.where(d > 0, n / d, np.inf) for n, d in ((high, m1), (-low, m0)))
    x = np.minimum(np.concatenate([cap[[0, -1]] for _, cap in parts], axis=1), _ANY)
    for first, last, start, end in sections:
        top = np.append(x[0, first:last], x[1, last - 1])
        top[1:-1] = np.minimum(top[1:-1], x[1, first : last - 1])
        top[0] = top[0] if start is None else start
        top[-1] = top[-1] if end is None else end
        best = top.tolist()
        inside = slice(first, last)
        back = reversed(_lines_below(loss[inside], less[inside], top[:-1]))
        ahead = _lines_below(gain[inside], more[inside], top[1:])
        for lines, to in ((back, 0), (ahead, 1)):
            for k, slope, offset in lines:
                best[k + to] = min(best[k + to], slope * best[k + 1 - to] + offset)
        x[:, first:last] = np.maximum([best[:-1], best[1:]], 0.0)
        possible &= min(best[1:-1], default=1.0) > 0
        possible &= best[0] >= (start or 0.0) * (1 - _SAME)
        possible &= best[-1] >= (end or 0.0) * (1 - _SAME)
    return x, possible


def _lines_below(
    slope: np.ndarray, offset: np.ndarray, top: np.ndarray
) -> list[tuple[int, float, float]]:
    """Return the lines, of R to each of N intervals, that begin below a level: number first."""
    interval, row = np.nonzero(offset < top[:, None])
    lines = interval, slope[interval, row], offset[interval, row]
    return list(zip(*(values.tolist() for values in lines), strict=True))


def _least_times(changes: Changes, cap: np.ndarray, x: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Return a time below that of any motion over each interval, given bounds x at its ends.

    Between two nodes it is the larger of two times: that of the row alone that takes longest, and
    that under the lower of two bounds on x, the one active on the left and the one on the right.
    """
    pace, low, high, turn, push = changes
    first, last = (np.where(turn, 0.0, pace[i] ** 2 * x[i][:, None]) for i in (0, -1))
    ahead, back = first + high, last - (low[-1] - low)
    back[-1, turn] = np.inf
    alone = _time_of_rows(ahead, push, 1), _time_of_rows(back, push, -1)
    longest = np.where(turn, alone[0] + alone[1], np.maximum(*alone)).max(axis=2)
    square = np.maximum(np.concatenate([ahead, back, cap[:, :, None]], axis=2), 0.0)
    pace = np.concatenate([pace, pace, np.ones_like(cap)[:, :, None]], axis=2)
    times = np.zeros(len(h))
    for k in range(_COUNT - 1):
        times += np.maximum(_time_under(square, pace, k) * h, longest[k])
    return times


def _time_of_rows(square: np.ndarray, push: np.ndarray, sign: int) -> np.ndarray:
    """Return the times between nodes in which rows gain, or lose, speed as fast as they can.

    square (K, N, R) is m x; its root changes by at most push in a unit of time.
    """
    root = np.sqrt(np.maximum(np.where(np.isfinite(square), square, 0.0), 0.0))
    return np.maximum(sign * np.diff(root, axis=0), 0.0) / push


def _time_under(square: np.ndarray, pace: np.ndarray, k: int) -> np.ndarray:
    """Return the time from node k to the next under bounds on x, for h = 1.

    square (K, N, B) bounds pace^2 x. Of all bounds, those that are lowest at one of the two nodes
    count, up to where they meet. In its own coordinate each is a quadratic at most, bent as much
    as its values at neighbouring nodes tell.
    """
    bounds = np.where(pace != 0, square / pace**2, np.inf)
    known = np.isfinite(bounds)
    usable = known[k] & known[k + 1] & (known[max(k - 1, 0) : k + 3].sum(axis=0) > 2)
    which = [np.where(usable, bounds[i], np.inf).argmin(axis=1) for i in (k, k + 1)]
    some, every = usable.any(axis=1), np.arange(len(usable))
    (l0, l1), (r0, r1) = (bounds[k : k + 2, every, i] for i in which)
    ahead, behind = l1 - r1, r0 - l0
    crossing = (ahead + behind > 0) & (which[0] != which[1])
    z = np.where(crossing, np.clip(behind / (ahead + behind), 0.0, 1.0), 1.0)
    time = np.zeros(len(some))
    for i, part in zip(which, ((0.0, z), (z, 1.0)), strict=True):
        time += _time_along(square[:, every, i], pace[:, every, i], k, *part)
    return np.where(some, time, 0.0)


def _time_along(square: np.ndarray, pace: np.ndarray, k: int, begin: Any, end: Any) -> np.ndarray:
    """Return the time of rows (K, N) over a part of the way from node k to the next, for h = 1."""
    way = along(_AREAS, pace)
    whole = way[k + 1] - way[k]
    bulge = _bend(square, way, k) * whole**2
    gain = (pace[k + 1] - pace[k]) / (pace[k + 1] + pace[k])
    z = [at * (1 + gain * (at - 1)) for at in (begin, end)]
    x0, x1 = (square[k] * (1 - at) + square[k + 1] * at - bulge * at * (1 - at) for at in z)
    part = z[1] - z[0]
    x0, x1 = np.maximum(x0, 0.0), np.maximum(x1, 1e-300)
    return np.where(part > 0, travel_time(part * np.abs(whole), x0, x1, bulge * part**2), 0.0)


def _bend(curve: np.ndarray, way: np.ndarray, k: int) -> np.ndarray:
    """Return half the lowest second derivative of curves (K, N) after node k, at most 0.

    That of the cubic through four nodes, at both ends, or of a parabola where one is not known.
    """
    first = min(max(k - 1, 0), _COUNT - 4)
    curve, at = (values[first : first + 4] for values in (curve, way))
    bends = np.diff(np.diff(curve, axis=0) / np.diff(at, axis=0), axis=0) / (at[2:] - at[:-2])
    known = np.isfinite(bends)
    bends = np.where(known, bends, np.where(known.any(axis=0), bends[::-1], 0.0))
    change = (bends[1] - bends[0]) / (at[3] - at[0])
    ends = (bends[0] + change * (3 * way[i] - at[:3].sum(axis=0)) for i in (k, k + 1))
    return _BEND * np.minimum(np.minimum(*ends), 0.0)
