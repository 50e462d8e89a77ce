"""Differences over a ladder of steps: the scale at which they settle, and what they are worth.

The steps halve from rung to rung. A difference is wrong by truncation on high rungs and by
noise on low ones; the rung with the least sum of both is taken. What a function computes is
never smooth to the last: its noise is measured on the lowest rungs, and that of a function
that rises in stairs (one that rounds, or computes in short precision) by the stairs.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

_RUNGS = 50  # below the scale of the variable: as far as its own rounding
_AT_ZERO = 30  # more of them where the variable is 0 and has no rounding
_ABOVE = 2.0**40  # how far above a small scale the ladder begins, at most at 1
_TOP = 2.0**0.1  # no multiple of anybody's period
_CLOSE = np.array([0.3, 3e-2, 3e-3, 3e-4, 1e-6, 1e-9])  # where roughness is measured, of the top
_EPS = float(np.finfo(float).eps)
Along = Callable[[np.ndarray, np.ndarray], np.ndarray]


def romberg(up: np.ndarray, down: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Extrapolate central differences over radii that halve along the last axis but one.

    Parameters
    ----------
    up, down : array, shape (..., R, P)
        f at +radius and -radius.
    radii : array, shape (R, 1) or (R, P)

    Returns
    -------
    value : array, shape (..., R - 2, P)
        Slopes of order 6.
    spread : array, shape (..., R - 2, P)
        By what they differ from those of order 4.
    """
    slope = (up - down) / (2 * radii)
    fourth = (4 * slope[..., 1:, :] - slope[..., :-1, :]) / 3
    value = (16 * fourth[..., 1:, :] - fourth[..., :-1, :]) / 15
    return value, value - fourth[..., 1:, :]


def slopes_jump(up: np.ndarray, down: np.ndarray, f0: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Return the jump of the slope, free of curvature, (..., R - 1, P): 2 for abs."""
    even = up + down - 2 * f0
    return (4 * even[..., 1:, :] - even[..., :-1, :]) / radii[:-1]


@dataclass(frozen=True)
class Ladder:
    """The slopes of n rows at P points, and what is known of them; arrays of shape (n, P).

    Attributes
    ----------
    value, error : array
        The slope and its estimated absolute error.
    residue : array
        A computed slope up to here is a zero that was computed.
    still : array of bool
        The row does not change at all.
    undefined, kink, unsettled : array of bool
        There is no slope: f has only one side, two slopes, or none that settles.
    sides : array, shape (2, n, P)
        The slopes below and above the point.
    rate : array
        The largest change over the scale of the variable, over that scale.
    """

    value: np.ndarray
    error: np.ndarray
    residue: np.ndarray
    still: np.ndarray
    undefined: np.ndarray
    kink: np.ndarray
    unsettled: np.ndarray
    sides: np.ndarray
    rate: np.ndarray


def descend(
    along: Along,
    f0: np.ndarray,
    z: np.ndarray,
    s: np.ndarray,
    exact: np.ndarray | None,
    eps: float,
    floor: np.ndarray,
    least: np.ndarray,
) -> Ladder:
    """Descend the ladder and take the best rung, row by row and point by point.

    Parameters
    ----------
    along : callable
        Maps steps (Q, P) and the numbers (P,) of their points to f, (n, Q, P).
    f0 : array, shape (n, P)
    z, s : array, shape (P,)
        The variable and its scale.
    exact : array, shape (n, P), optional
        The slope by the complex step, a candidate.
    eps : float
        Relative precision of what f returns.
    floor : array, shape (n, P)
        Slopes that are negligible beside the other variables': they may be noise all along.
    least : array, shape (n, P)
        Noise of f at the point, at least.
    """
    top = _TOP * np.clip(1.0, s, s * _ABOVE)
    rungs = _RUNGS + int(np.ceil(np.log2((top / s).max()))) + (_AT_ZERO if (z == 0).any() else 0)
    r = top * 2.0 ** -np.arange(rungs)[:, None]
    every = np.arange(len(s))
    # Steps that differ by little more than rounding show what f makes of rounding.
    close = (_CLOSE[:, None] * (1 + 9e-16 * np.arange(6.0) ** 1.5)).reshape(-1, 1) * top
    # The point itself, in seven places of the batch: a product of matrices rounds each place in
    # its own way, and what that makes of f is noise, too.
    again = np.zeros((3, len(s)))
    steps = along(np.concatenate([again, r, -r, again[:1], close, again]), every)
    cuts = np.cumsum([3, 2 * rungs, 1, len(close)])
    before, values, between, nearby, after = np.split(steps, cuts, axis=1)
    start = f0[:, None]
    repeated = np.concatenate([before, between, after], axis=1) - start
    least = np.maximum(least, 2 * np.nan_to_num(np.abs(repeated).max(axis=1)))
    up, down = values[:, :rungs], values[:, rungs:]
    size = np.nan_to_num(np.maximum(np.abs(up), np.abs(down)), nan=0.0, posinf=np.inf)
    # On each rung the rounding of the largest value there or below, and what is measured.
    rounding = eps * np.maximum.accumulate(size[:, ::-1], axis=1)[:, ::-1]
    even = up + down - 2 * start
    bent = np.abs(even[:, 1:] - even[:, :-1] / 4)
    bent = np.where(r[:-1] <= 1e-10 * s, bent, 0.0)
    odd = up - down  # where z + r is rounded, all that follows is a staircase
    risen = np.where((z != 0) & (r[:-1] <= 1e-13 * s), np.abs(odd[:, 1:] - odd[:, :-1] / 2), 0.0)
    measured = np.nan_to_num(np.maximum(bent, risen)).max(axis=1)
    rough = _roughness((z + close) - z, nearby)
    change = np.maximum(np.abs(up - start), np.abs(down - start))
    place = np.clip(np.searchsorted(-_CLOSE, -r[:, 0] / top[0], "right") - 1, 0, None)
    blurred = rough[:, place] * (r / (_CLOSE[place, None] * top))
    noise = np.maximum(rounding + measured[:, None] + blurred, least[:, None])
    noise = noise + np.nan_to_num(_EPS * np.abs(z) * change / r, posinf=0.0)  # z + r is rounded
    flat = np.zeros(f0.shape)
    slopes = [flat] if exact is None else [flat, exact]
    stairs = np.max([_stairs(along, values - start, slope, r, noise) for slope in slopes], axis=0)
    noise = noise + stairs[:, None]

    value, spread = romberg(up, down, r)
    blur = noise[:, 2:] / r[2:]
    error = np.abs(spread) + 2 * blur
    # What holds on a rung must hold on those below, but for their noise.
    for step in range(1, value.shape[1]):
        apart = np.abs(value[:, :-step] - value[:, step:]) - 8 * blur[:, step:]
        error[:, :-step] = np.maximum(error[:, :-step], apart)
    error = np.where(np.isnan(error), np.inf, error)
    best = np.argmin(error, axis=1)[:, None]

    def at(rung: np.ndarray, a: np.ndarray) -> np.ndarray:
        return np.take_along_axis(np.broadcast_to(a, (len(f0), *a.shape[-2:])), rung, axis=1)[:, 0]

    taken, err = at(best, value), at(best, error)
    # A slope that goes on changing from rung to rung is none, how little it may change.
    other = np.where(best + 3 < value.shape[1], best + 3, best - 3)
    drift = np.abs(at(other, value) - taken)
    rate = np.where((r <= s) & np.isfinite(change), change, 0.0).max(axis=1) / s
    settled = drift <= 0.01 * np.abs(taken) + 16 * at(other, blur)
    err = np.where(settled, err, np.maximum(err, 2 * drift))
    unsettled = ~settled & (drift > np.maximum(1e-9 * rate, floor))
    unsteady = (err > 0.1 * np.maximum(np.abs(taken), rate)) & (err > 8 * at(best, blur))
    unsteady |= (stairs > 0) & (err > 0.1 * np.maximum(np.abs(taken), 1e-6 * rate))
    unsettled |= unsteady & (err > floor)
    # Where f saturates, all that is left of it may be the rounding of a 1: such a slope is as
    # good as its error says.
    unsettled &= err * s > 2.0**13 * eps
    jump = np.abs(slopes_jump(up, down, start, r))
    kink, rung = _lasting(jump, 20 * noise[:, :-1] / r[:-1])
    kink &= at(rung, jump) > 1e-3 * floor
    smooth = 1e-3 * rate * s + 16 * rough.max(axis=1) + 8 * least
    for side in (up, down):  # a jump at the point itself
        gap = np.abs(side - start)[:, -8:]
        kink |= gap.min(axis=1) > np.maximum(0.5 * gap.max(axis=1), smooth)
    sides = np.stack([at(rung, (start - down) / r), at(rung, (up - start) / r)])
    bend = at(best, np.abs(even) / r**2)
    excess = measured - 8 * at(best, rounding)
    residue = 2 * _EPS * np.abs(z) * bend + 4 * np.maximum(excess, 0.0) / at(best, r)
    residue = residue + 8 * at(best, blurred / r)
    still, nan = ~(values != start).any(axis=1), np.isnan(up) | np.isnan(down)
    undefined = nan[:, -12:].all(axis=1) | np.isinf(err)
    return Ladder(taken, err, residue, still, undefined, kink, unsettled, sides, rate)


def _roughness(moved: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return by how much f at steps that nearly agree, six by six, is off a line, (n, 6, P)."""
    moved = moved.reshape(-1, 6, moved.shape[-1])
    values = values.reshape(len(values), *moved.shape)
    run = moved[:, -1:] - moved[:, :1]
    part = (moved - moved[:, :1]) / np.where(run == 0, 1.0, run)
    bowed = values - values[:, :, :1] - (values[:, :, -1:] - values[:, :, :1]) * part
    return np.nan_to_num(np.abs(bowed).max(axis=2), posinf=0.0)


def _lasting(jump: np.ndarray, floor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether the jump of the slope lasts as far down as noise lets see it; a rung with it."""
    number = jump.shape[1]
    seen = np.greater(jump, floor)
    run = np.all([seen[:, 4 - k : number - k] for k in range(5)], axis=0)
    last = number - 1 - np.argmax(run[:, ::-1], axis=1)[:, None]
    here = np.take_along_axis(jump, last, axis=1)
    before = np.take_along_axis(jump, last - 4, axis=1)
    below = np.minimum(last + 1, number - 1)
    hidden = (last == number - 1) | (np.take_along_axis(floor, below, axis=1) > 0.3 * here)
    # The jump of a kink stays, that of a root grows by 4; what grows by 16 is noise.
    lasts = (0.5 * before <= here) & (here <= 5 * before)
    kink = np.any(run, axis=1)[:, None] & lasts & hidden
    return kink[:, 0], np.maximum(last - 8, 0)


def _stairs(
    along: Along, change: np.ndarray, slope: np.ndarray, r: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Return the height of the stairs in which a row rises beside its slope, (n, P).

    The row is level on all rungs below some, and steps up by more than its noise there: it
    has stairs if it does so again and again, and not only once, as a saturation does.
    """
    rungs, stairs = len(r), np.zeros(slope.shape)
    line = slope[:, None] * r
    rest = np.maximum(np.abs(change[:, :rungs] - line), np.abs(change[:, rungs:] + line))
    level = rest <= np.where(slope[:, None] == 0, 0.0, 2 * noise)
    below = np.logical_and.accumulate(level[:, ::-1], axis=1)[:, ::-1]
    first = np.argmax(below, axis=1)
    for i, p in np.argwhere(below.any(axis=1) & (first > 0)):
        rung = first[i, p] - 1
        if not rest[i, rung, p] > 8 * noise[i, rung, p]:
            continue
        for width in (2, 8, 64, 512):  # the first riser may be close by chance
            t = np.linspace(-width, width, 193)[:, None] * r[rung, p]
            rise = np.abs(np.diff(along(t, np.array([p]))[i, :, 0] - slope[i, p] * t[:, 0]))
            riser = ~(rise <= max(4 * noise[i, rung, p], 1e-3 * np.nanmax(rise)))
            steps = int(riser[0]) + np.count_nonzero(riser[1:] & ~riser[:-1])
            if steps >= 3 and 2 * np.count_nonzero(riser) < riser.size:
                stairs[i, p] = np.nanmax(rise)
                break
    return stairs
