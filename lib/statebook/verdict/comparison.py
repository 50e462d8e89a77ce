"""Two stability reports side by side: operating points, or versions of a model."""

from __future__ import annotations

import html
from dataclasses import dataclass

import numpy as np
import scipy

from statebook.verdict.report import Mode, StabilityReport
from statebook.verdict.words import format_complex, format_real, html_table, text_table

_HEAD = ("eigenvalue", "damping", "frequency")


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two stability reports, mode beside mode.

    Attributes
    ----------
    names : (str, str)
    reports : (StabilityReport, StabilityReport)
    pairs : tuple of (Mode or None, Mode or None)
        Modes that correspond; None where one has no counterpart.
    """

    names: tuple[str, str]
    reports: tuple[StabilityReport, StabilityReport]
    pairs: tuple[tuple[Mode | None, Mode | None], ...]

    def __repr__(self) -> str:
        lines, rows = self._parts()
        return "\n".join([*lines, *text_table(rows)])

    def _repr_html_(self) -> str:
        lines, rows = self._parts()
        return "".join(f"<p>{html.escape(line)}</p>" for line in lines) + html_table(rows)

    def _parts(self) -> tuple[list[str], list[tuple[str, ...]]]:
        """Return the verdicts in words, and the rows of the table."""
        lines = [
            f"{name}: {r.verdict} (spectral margin {format_real(r.spectral_margin)})"
            for name, r in zip(self.names, self.reports, strict=True)
        ]
        scales = [float(np.abs(r.eigenvalues).max(initial=0.0)) for r in self.reports]
        head = tuple(f"{name}: {head}" for name in self.names for head in _HEAD)
        rows = [_cells(one, scales[0]) + _cells(two, scales[1]) for one, two in self.pairs]
        return lines, [head, *rows]


def _cells(mode: Mode | None, scale: float) -> tuple[str, ...]:
    if mode is None:
        return ("-",) * len(_HEAD)
    value = format_complex(mode.eigenvalue, scale)
    return (value, format_real(mode.damping), format_real(mode.frequency, scale))


def compare(
    first: StabilityReport, second: StabilityReport, *, names: tuple[str, str] = ("first", "second")
) -> Comparison:
    """Set two stability reports side by side, mode beside mode.

    Of two operating points, or of two versions of a model. Modes correspond where eigenvalues
    are near and, if both have the same states, the same states take part.

    Parameters
    ----------
    first, second : StabilityReport
        Both in continuous time, or both in discrete time.
    names : (str, str)
        What to call them.

    Returns
    -------
    Comparison

    Raises
    ------
    TypeError, ValueError
        One of them is no report, or one is in continuous and the other in discrete time.

    Examples
    --------
    >>> import statebook as sb
    >>> light, heavy = (
    ...     sb.stability(sb.Pendulum(m=m, damping=1.0), [-sb.pi / 2, 0]) for m in (1.0, 4.0)
    ... )
    >>> compare(light, heavy, names=("a", "b"))
    a: asymptotically stable (spectral margin 0.5)
    b: asymptotically stable (spectral margin 0.125)
    a: eigenvalue  a: damping  a: frequency  b: eigenvalue    b: damping  b: frequency
    -0.5 + 3.09j   0.1597      3.13          -0.125 + 3.128j  0.03993     3.13
    -0.5 - 3.09j   0.1597      3.13          -0.125 - 3.128j  0.03993     3.13
    """
    for report in (first, second):
        if not isinstance(report, StabilityReport):
            raise TypeError(f"compare takes two reports of stability, got {type(report).__name__}")
    if (first.dt in (None, 0)) != (second.dt in (None, 0)):
        raise ValueError(
            f"both reports must be in continuous or in discrete time, got dt = {first.dt} and"
            f" {second.dt}"
        )
    here, there = first.eigenvalues[:, None], second.eigenvalues
    size = np.abs(here) + np.abs(there)
    unlike = np.abs(here - there) / np.where(size > 0, size, 1.0)
    if first.states == second.states and first.modes:
        shares = [np.stack([mode.participation for mode in r.modes]) for r in (first, second)]
        unlike = unlike + 0.5 * np.abs(shares[0][:, None] - shares[1]).sum(axis=-1)
    rows, columns = scipy.optimize.linear_sum_assignment(unlike)
    match = {first.modes[j]: second.modes[k] for j, k in zip(rows, columns, strict=True)}
    alone = [(None, mode) for mode in second.modes if mode not in match.values()]
    pairs = (*((mode, match.get(mode)) for mode in first.modes), *alone)
    return Comparison(names, (first, second), pairs)
