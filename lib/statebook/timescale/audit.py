"""How much of each limit a motion uses, over all time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from statebook.timescale import bernstein
from statebook.timescale.limits import DENSE, Limit, TorqueLimit, VelocityLimit
from statebook.timescale.profile import Profile

_SAME = 1e-6  # uses that differ by less are the same use


@dataclass(frozen=True)
class Use:
    """The largest use of one limit.

    Attributes
    ----------
    limit : str
        "velocity", "acceleration", "speed" or "torque".
    row : int
        Joint, or row of the torques.
    use : float
        The quantity over its bound at the worst instant: at most 1 if the limit holds. Of a
        torque range that does not enclose 0: 1 plus the excess over the larger bound.
    time, s : float
        When and where, the first time.
    exact : bool
        True if it is the maximum over all time to rounding; False for torques, which are looked
        at on 17 points of each interval.
    """

    limit: str
    row: int
    use: float
    time: float
    s: float
    exact: bool


@dataclass(frozen=True)
class Audit:
    """The largest use of every limit over a whole motion.

    Attributes
    ----------
    uses : tuple of Use
        One per limit and joint.
    """

    uses: tuple[Use, ...]

    @property
    def worst(self) -> Use:
        """The limit that is used most."""
        return max(self.uses, key=lambda use: use.use)

    def __iter__(self) -> Iterator[Use]:
        return iter(self.uses)

    def __len__(self) -> int:
        return len(self.uses)

    def __repr__(self) -> str:
        lines = ["limit         row    use       time         s"]
        for u in self.uses:
            lines.append(
                f"{u.limit:<12}{u.row:>5}{u.use + 0.0:>7.4f}{u.time + 0.0:>11.4g}{u.s + 0.0:>10.4g}"
            )
        return "\n".join(lines)


def audit(profile: Profile, limits: Sequence[Limit]) -> Audit:
    """Find the largest use of every limit.

    Velocities and accelerations are polynomials of s in each interval; their maxima are enclosed
    to rounding by their Bernstein coefficients, which bound them. Torques are not polynomials:
    they are looked at on dense points.
    """
    uses: list[Use] = []
    for limit in limits:
        exact = limit.kind != "torque"
        z = bernstein.nodes(limit.degree(profile.grid)) if exact else np.linspace(0, 1, DENSE)
        sampled = limit.use(profile.grid, z, profile.u(z), profile.x(z))
        highest, places = _maxima(profile, limit, z) if exact else (sampled.max(axis=(0, 1)), [])
        for row, use in enumerate(highest):
            # Limits are reached again and again: name the first time, whatever the rounding.
            reached = sampled[:, :, row] >= use - _SAME * abs(use)
            if reached.any():
                i = int(reached.any(axis=0).argmax())
                fraction = float(z[reached[:, i].argmax()])
            else:
                i, fraction = places[row]
            uses.append(
                Use(
                    limit=limit.kind,
                    row=row,
                    use=float(use),
                    time=profile.time_at(i, fraction),
                    s=float(profile.grid.s[i] + fraction * profile.grid.h[i]),
                    exact=exact,
                )
            )
    return Audit(tuple(uses))


def _maxima(
    profile: Profile, limit: Limit, z: np.ndarray
) -> tuple[np.ndarray, list[tuple[int, float]]]:
    """Return the largest use of each row, and the interval and the fraction of it where it is."""
    to_bernstein = bernstein.from_values(len(z) - 1)
    values = limit.values(profile.grid, z, profile.u(z), profile.x(z))
    coefficients = bernstein.along(to_bernstein, values)
    sides: list[tuple[np.ndarray, np.ndarray | None]]
    if isinstance(limit, VelocityLimit) and not np.array_equal(limit.upper, -limit.lower):
        slope = bernstein.along(to_bernstein, profile.grid.path(z, 1))
        sides = [(limit.upper**2, slope), (limit.lower**2, -slope)]
    elif limit.squared:
        sides = [(limit.upper**2, None)]
    else:
        sides = [(limit.upper, None), (limit.lower, None)]
    found = [bernstein.maxima(coefficients / bound, sign) for bound, sign in sides]
    use, interval, fraction = (np.stack(values) for values in zip(*found, strict=True))
    side, rows = use.argmax(axis=0), np.arange(use.shape[1])
    highest = np.maximum(use[side, rows], 0.0)
    places = list(zip(interval[side, rows].tolist(), fraction[side, rows].tolist(), strict=True))
    return (np.sqrt(highest) if limit.squared else highest), places


def static_torques_hold(profile: Profile, limits: Sequence[Limit]) -> bool:
    """Whether the load of the robot at rest is within the torque limits all along the path."""
    z = np.linspace(0, 1, DENSE)
    rest = np.zeros((DENSE, len(profile.x0)))
    torques = [limit for limit in limits if isinstance(limit, TorqueLimit)]
    return all(float(limit.use(profile.grid, z, rest, rest).max()) <= 1.0 for limit in torques)
