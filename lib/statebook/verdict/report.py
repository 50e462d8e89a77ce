"""What a stability analysis returns: the verdict, its evidence and the modes."""

from __future__ import annotations

import html
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from statebook.verdict.margins import Margins, margins_of, open_loop
from statebook.verdict.words import format_complex, format_real, html_table, text_table

if TYPE_CHECKING:
    import control

# The table of a large system shows its slowest modes only.
_ROWS = 12


@dataclass(frozen=True, eq=False)
class Mode:
    """One natural motion of a linear system.

    Attributes
    ----------
    eigenvalue : complex
        Of the matrix [1/s]; in discrete time of the map, per step.
    damping : float
        Damping ratio ``-Re(s) / abs(s)``; 0 for s = 0. In discrete time s = log(z) / dt.
    frequency : float [rad/s]
        Natural frequency abs(s).
    time_constant : float [s]
        ``1 / abs(Re s)``, in which the mode decays or grows by e; inf on the boundary.
    participation : array, shape (n,)
        Share of each state in the mode, at least 0, of sum 1; it does not depend on units. Of
        eigenvalues that rounding may mix it is the share in their invariant subspace.
    """

    eigenvalue: complex
    damping: float
    frequency: float
    time_constant: float
    participation: np.ndarray

    def __repr__(self) -> str:
        return (
            f"Mode(eigenvalue={format_complex(self.eigenvalue, abs(self.eigenvalue))},"
            f" damping={format_real(self.damping)}, frequency={format_real(self.frequency)},"
            f" time_constant={format_real(self.time_constant)})"
        )


@dataclass(frozen=True, eq=False)
class StabilityReport:
    """A stability verdict with its evidence.

    Attributes
    ----------
    verdict : str
        "asymptotically stable", "marginally stable", "unstable", "inconclusive", or "stable,
        along a family of dimension k".
    eigenvalues : array, shape (n,), complex
        By decreasing real part, then imaginary part. Those judged to lie on the boundary are
        put on it, and those that rounding blurs across it at their mean.
    spectral_margin : float
        ``-max Re`` in continuous time [1/s], ``1 - max abs`` in discrete time: positive if all
        eigenvalues are inside, 0 on the boundary, negative beyond; inf if there are none.
    tolerance : float
        How far rounding may move the margin, in its units: the true one is within it; 0 where
        the verdict is exact. Of eigenvalues that rounding blurs into one it is that of their
        mean.
    reason : str
        What was judged, and why.
    modes : tuple of Mode
        One for each eigenvalue, in the same order.
    dt : float, bool or None
        Timebase: None or 0 is continuous, True or > 0 [s] discrete.
    states : tuple of str
        Labels of the states.
    linearization : control.StateSpace or None
        The linear system that was judged, for python-control; None of a bare matrix.
    """

    verdict: str
    eigenvalues: np.ndarray
    spectral_margin: float
    tolerance: float
    reason: str
    modes: tuple[Mode, ...]
    dt: float | bool | None
    states: tuple[str, ...]
    linearization: control.StateSpace | None = None

    def __repr__(self) -> str:
        lines, rows, more = self._parts()
        return "\n".join([*lines, *text_table(rows), *more])

    def margins(
        self, K: Any = 1.0, *, input: str | None = None, output: str | None = None
    ) -> Margins:
        """Margins of a loop round the linearization.

        Parameters
        ----------
        K : array of shape (m, n), control.StateSpace, control.TransferFunction or float
            The controller, with negative feedback: gains on the states, u = u0 - K (x - x0), or
            what acts on one output.
        input, output : str, optional
            Where the loop is opened, and what K measures unless it is gains on the states; the
            only ones if omitted. Of several inputs of gains the others stay closed.

        Returns
        -------
        Margins

        Raises
        ------
        TypeError, ValueError
            No such input or output, or several and none was named; K does not fit; the report
            is of a bare matrix.

        Examples
        --------
        >>> import statebook as sb
        >>> upright = sb.stability(sb.Pendulum(g=9.0), [sb.pi / 2, 0])
        >>> upright.margins([[18.0, 6.0]])
        closed loop asymptotically stable: gain 0.5 to inf, phase 60 deg, delay 0.2015 s, modulus 1
        """
        return margins_of(open_loop(self.linearization, K, input, output))

    def bode(self, K: Any = 1.0, *, input: str | None = None, output: str | None = None) -> Any:
        """Draw the Bode plot of that loop: python-control's ControlPlot; see `margins`.

        Examples
        --------
        >>> import statebook as sb
        >>> plot = sb.stability(sb.Pendulum(), [sb.pi / 2, 0]).bode([[20.0, 6.0]])
        >>> plot.axes.shape
        (2, 1)
        """
        import control

        return control.bode_plot(open_loop(self.linearization, K, input, output))

    def nyquist(self, K: Any = 1.0, *, input: str | None = None, output: str | None = None) -> Any:
        """Draw the Nyquist plot of that loop: python-control's ControlPlot; see `margins`.

        Examples
        --------
        >>> import statebook as sb
        >>> plot = sb.stability(sb.Pendulum(), [sb.pi / 2, 0]).nyquist([[20.0, 6.0]])
        >>> plot.axes.shape
        (1, 1)
        """
        import control

        return control.nyquist_plot(open_loop(self.linearization, K, input, output))

    def to_markdown(self) -> str:
        """Write the report as Markdown, the modes as a table.

        Returns
        -------
        str

        Examples
        --------
        >>> import statebook as sb
        >>> print(sb.stability([[-2.0]]).to_markdown().splitlines()[-1])
        | -2 | 1 | 2 | 0.5 | x\\[0\\] |
        """
        (title, reason), rows, more = self._parts()
        # What Markdown would read as a link, a table or emphasis is meant as it stands.
        cells = [(*map(_literal, row),) for row in rows]
        cells[:1] = [rows[0], ("---",) * 5] if rows else []
        table = "\n".join("| " + " | ".join(row) + " |" for row in cells)
        return "\n\n".join(filter(None, [f"**{title}**", _literal(reason), table, *more]))

    def _repr_html_(self) -> str:
        (title, reason), rows, more = self._parts()
        words = f"<p><strong>{html.escape(title)}</strong></p><p>{html.escape(reason)}</p>"
        return words + html_table(rows) + "".join(f"<p>{line}</p>" for line in more)

    def _parts(self) -> tuple[list[str], list[tuple[str, ...]], list[str]]:
        """Title and reason, rows of the table of modes, and what it leaves out."""
        title = f"{self.verdict} (spectral margin {format_real(self.spectral_margin)})"
        unit = "sample" if self.dt is True else "s"
        scale = float(np.abs(self.eigenvalues).max(initial=0.0))
        head = ("eigenvalue", "damping", f"freq. [rad/{unit}]", f"time const. [{unit}]", "states")
        rows = [
            (
                format_complex(mode.eigenvalue, scale),
                format_real(mode.damping),
                format_real(mode.frequency, scale if self.dt in (None, 0) else 1.0),
                format_real(mode.time_constant),
                self._main_states(mode),
            )
            for mode in self.modes[:_ROWS]
        ]
        left = len(self.modes) - _ROWS
        more = [f"... and {left} more"] if left > 0 else []
        return [title, self.reason], [head, *rows] if rows else [], more

    def _main_states(self, mode: Mode) -> str:
        """Labels of the states whose share is at least half the largest."""
        share = mode.participation
        return ", ".join(np.array(self.states)[share >= 0.5 * share.max() - 1e-6])


def _literal(text: str) -> str:
    return re.sub(r"([\\`*_\[\]<>|])", r"\\\1", text)


def modes_of(
    eigenvalues: np.ndarray, participations: np.ndarray, discrete: bool, dt: float | bool | None
) -> tuple[Mode, ...]:
    """Modes from eigenvalues and the participation of states (rows) in them (columns)."""
    modes = []
    for value, share in zip(eigenvalues, participations.T, strict=True):
        if discrete:
            # log(0) is the mode that is over after one step: infinitely fast.
            s = complex(np.log(value)) / float(dt or 1) if value != 0 else complex(-np.inf)
            if abs(abs(value) - 1) <= 4 * np.finfo(float).eps:
                s = complex(0, s.imag)
        else:
            s = complex(value)
        size, rate = abs(s), abs(s.real)
        damping = 1.0 if np.isinf(size) else 0.0 if size == 0 else -s.real / size
        time_constant = float("inf") if rate == 0 else 1 / rate
        modes.append(Mode(complex(value), damping + 0.0, size, time_constant, share))
    return tuple(modes)
