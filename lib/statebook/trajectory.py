"""Sampled trajectories: states and controls with their times."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from statebook import _validate
from statebook.angles import wrap_angle
from statebook.control_trajectory import ControlTrajectory
from statebook.dense_output import DenseOutput
from statebook.events import Event
from statebook.systems import as_system
from statebook.times import ReadOnly, increasing, interval_of, within

if TYPE_CHECKING:
    import control


_FINE = 2001  # samples of a step's characteristics


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(ReadOnly):
    """States, and controls if any, at increasing times.

    Parameters
    ----------
    times : array, shape (T,), increasing [s]
        Sample times; they need not be uniform.
    states : array, shape (n, T) or (n, N, T)
        One state at each time, or a batch of N trajectories with common times.
    controls : array, shape (m, T) or (m, T - 1), with N in between for a batch, optional
        One control per time, or one per interval, held in it; `control_hold` says which.
    circle : tuple of int
        Indices of the states that are angles known up to full turns: between two samples they
        take the shorter way round.
    state_labels, input_labels : tuple of str, optional
        Names; by default "x[0]", ... and "u[0]", ...
    events : tuple of Event
        What `simulate` found on the way, each with its label, time and state.

    Attributes
    ----------
    dense : DenseOutput or None
        The solver's own interpolation, if `simulate` made the trajectory; `dataclasses.replace`
        leaves it behind.
    plan : ControlTrajectory or None
        The control as a function of time alone, if it was one.

    Raises
    ------
    TypeError, ValueError
        If the times do not increase, shapes disagree, or an entry is not finite.

    Examples
    --------
    >>> trajectory = Trajectory([0, 1, 3], [[0, 2, 6]])
    >>> trajectory
    Trajectory(n=1, m=0, 3 times over [0, 3] s)
    >>> trajectory(2.0)
    array([4.])
    """

    times: np.ndarray
    states: np.ndarray
    controls: np.ndarray | None = None
    circle: tuple[int, ...] = ()
    state_labels: tuple[str, ...] | None = None
    input_labels: tuple[str, ...] | None = None
    events: tuple[Event, ...] = ()
    dense: DenseOutput | None = field(default=None, init=False)
    plan: ControlTrajectory | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        times = increasing("times", self.times, minimum=1)
        states = _validate.real_array("states", self.states).copy()
        if states.ndim not in (2, 3) or states.shape[-1] != len(times) or len(states) == 0:
            raise ValueError(
                f"states must have shape (n, {len(times)}) or (n, N, {len(times)}), one state for "
                f"each time, got {states.shape}"
            )
        self._keep(times=times, states=states)
        if self.controls is not None:
            controls = _validate.real_array("controls", self.controls).copy()
            batch = states.shape[1:-1]
            wanted = [(*batch, len(times)), (*batch, len(times) - 1)]
            if controls.ndim < 2 or controls.shape[1:] not in wanted or len(controls) == 0:
                raise ValueError(
                    f"controls must have shape (m, *{wanted[0]}), one per time, or "
                    f"(m, *{wanted[1]}), one per interval, got {controls.shape}"
                )
            self._keep(controls=controls)
        circle = tuple(_validate.integer("circle", i, 0) for i in self.circle)
        if any(i >= self.n for i in circle):
            raise ValueError(f"circle must hold indices below n = {self.n}, got {circle}")
        self._keep(circle=circle)
        for name, letter, count in (("state", "x", self.n), ("input", "u", self.m)):
            labels = getattr(self, f"{name}_labels")
            labels = [f"{letter}[{i}]" for i in range(count)] if labels is None else labels
            if isinstance(labels, str) or len(labels) != count:
                raise ValueError(f"{name}_labels must be {count} names, got {labels!r}")
            self._keep(**{f"{name}_labels": tuple(str(label) for label in labels)})

    def __repr__(self) -> str:
        batch = f"a batch of {self.states.shape[1]}, " if self.states.ndim == 3 else ""
        count = f"{len(self.times)} time{'s' if len(self.times) > 1 else ''}"
        start, end = self.times[[0, -1]]
        return f"Trajectory({batch}n={self.n}, m={self.m}, {count} over [{start:g}, {end:g}] s)"

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def m(self) -> int:
        """Number of inputs, 0 without controls."""
        return 0 if self.controls is None else len(self.controls)

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]."""
        return float(self.times[-1] - self.times[0])

    @property
    def control_hold(self) -> str | None:
        """Either "time", one control per time, or "interval"; None without controls."""
        if self.controls is None:
            return None
        return "time" if self.controls.shape[-1] == len(self.times) else "interval"

    def __call__(self, t: Any) -> np.ndarray:
        """Interpolate the state; the same as ``at(t)``."""
        return self.at(t)

    def at(self, t: Any, kind: str | None = None, *, system: Any = None) -> np.ndarray:
        """Interpolate the state.

        Parameters
        ----------
        t : float or array, shape (K,) [s]
            Times between the first sample and the last.
        kind : str, optional
            "dense", the solver's own interpolation, as accurate as the samples; "linear"; or
            "cubic": Hermite, whose slopes at the samples are the dynamics'. By default "dense"
            for what a solver of `simulate` made, else "linear".
        system : system
            Continuous-time system of the trajectory; for "cubic" only.

        Returns
        -------
        array, shape (n,) or (n, K), with N in between for a batch
            At a sample time exactly the sample. A circle-valued state is continued from the
            sample before and is not wrapped.

        Raises
        ------
        ValueError
            If a time is outside the trajectory, or "cubic" lacks a continuous-time system.

        Examples
        --------
        >>> fall = Trajectory([0, 1], [[0.0, -4.9], [0.0, -9.8]])
        >>> fall.at(0.5, "cubic", system=lambda x: np.stack([x[1], 0 * x[1] - 9.8])).round(3)
        array([-1.225, -4.9  ])
        """
        kind = kind or ("linear" if self.dense is None else "dense")
        _validate.choice("kind", kind, ("dense", "linear", "cubic"))
        t = within("t", t, self.times)
        k = interval_of(t, self.times)
        if kind == "dense":
            return self._dense_at(t, k)
        if len(self.times) == 1:
            return np.array(self.states[..., k])
        start, end = self.states[..., k], self.states[..., k + 1]
        step = self.times[k + 1] - self.times[k]
        s = (t - self.times[k]) / step
        rise = end - start
        for i in self.circle:
            rise[i] = wrap_angle(rise[i])
        if kind == "linear":
            value = start + s * rise
        else:
            first, last = self._slopes(k, system)
            value = start + s**2 * (3 - 2 * s) * rise
            value += s * (1 - s) * step * ((1 - s) * first - s * last)
        return np.where(s == 1, end, value)

    def _dense_at(self, t: np.ndarray, k: np.ndarray) -> np.ndarray:
        if self.dense is None:
            raise ValueError('kind "dense" needs what a solver of simulate made')
        k = k + (len(self.times) > 1) * (t == self.times[-1])
        sampled = t == self.times[k]
        if np.all(sampled):
            return np.array(self.states[..., k])
        return np.where(sampled, self.states[..., k], self.dense(t))

    def _slopes(self, k: np.ndarray, system: Any) -> tuple[np.ndarray, np.ndarray]:
        """Time derivatives at both ends of each interval k."""
        if system is None:
            raise ValueError('kind "cubic" takes its slopes from the dynamics: give system=')
        u0 = None if self.controls is None else self.controls[..., 0]
        system = as_system(system, self.states[..., 0], u0)
        if system.discrete:
            raise ValueError(f'kind "cubic" needs a continuous-time system, got dt = {system.dt}')
        at, which = np.unique(k, return_inverse=True)
        ends = []
        for shift, hold in ((0, 0), (1, int(self.control_hold == "time"))):
            slopes = [
                system.dynamics(
                    self.states[..., j + shift],
                    None if self.controls is None else self.controls[..., j + hold],
                    float(self.times[j + shift]),
                )
                for j in at
            ]
            ends.append(np.stack(slopes, axis=-1)[..., which.reshape(k.shape)])
        return ends[0], ends[1]

    def control_at(self, t: Any) -> np.ndarray:
        """The control between the samples.

        That of the run where it was a function of time: held, if it was held. The samples of a
        policy u(x, t) are interpolated: linear if one per time, else held.

        Parameters
        ----------
        t : float or array, shape (K,) [s]
            Times between the first sample and the last.

        Returns
        -------
        array, shape (m,) or (m, K), with N in between for a batch

        Raises
        ------
        ValueError
            If a time is outside the trajectory, or it has no controls.

        Examples
        --------
        >>> Trajectory([0, 1, 2], [[0, 0, 1]], [[5, 7]]).control_at(1.5)
        array([7.])
        """
        controls = self._controls()
        t = within("t", t, self.times)
        k = interval_of(t, self.times)
        if self.plan is not None:
            return self.plan(t).reshape(*controls.shape[:-1], *t.shape)
        if self.control_hold == "interval" or len(self.times) == 1:
            return np.array(controls[..., k])
        s = (t - self.times[k]) / (self.times[k + 1] - self.times[k])
        return (1 - s) * controls[..., k] + s * controls[..., k + 1]

    def resample(self, times: Any, kind: str | None = None, *, system: Any = None) -> Trajectory:
        """Interpolate states and controls at other times.

        Parameters
        ----------
        times : array, shape (K,), increasing [s]
            New times, within the old.
        kind, system
            How to interpolate the state, as in `at`.

        Returns
        -------
        Trajectory
            One control per time or per interval, as before; held controls are those at the
            starts of the new intervals.

        Examples
        --------
        >>> Trajectory([0, 1], [[0, 2]]).resample([0, 0.5, 1]).states.tolist()
        [[0.0, 1.0, 2.0]]
        """
        times = increasing("times", times, minimum=1)
        controls = None
        if self.controls is not None:
            controls = self.control_at(times[:-1] if self.control_hold == "interval" else times)
        states = self.at(times, kind, system=system)
        run = replace(self, times=times, states=states, controls=controls)
        return of_run(run, self.dense, self.plan)

    def path(self) -> np.ndarray:
        """The states alone, without times: a geometric path.

        Returns
        -------
        array, shape (n, K)
            The states in order, a repeated one once: how long the trajectory waits is timing.

        Examples
        --------
        >>> Trajectory([0, 1, 5], [[0, 2, 2]]).path().tolist()
        [[0.0, 2.0]]
        """
        moved = np.any(np.diff(self._single("path").states) != 0, axis=0)
        return self.states[:, np.concatenate([[True], moved])]

    def to_control_space(self) -> tuple[np.ndarray, ControlTrajectory]:
        """The initial state and the control, from which `simulate` restores the rest.

        Returns
        -------
        x0 : array, shape (n,)
        u : ControlTrajectory
            The run's own where its control was a function of time: simulating again repeats it.
            Else piecewise linear if there is one control per time, or piecewise constant.

        Examples
        --------
        >>> Trajectory([0, 1, 2], [[0, 0, 1]], [[5, 7]]).to_control_space()[1]
        ControlTrajectory(m=1, 2 pieces of degree 0 over [0, 2] s)
        """
        controls = self._single("to_control_space")._controls()
        if self.plan is not None:
            return np.array(self.states[:, 0]), self.plan.between(*self.times[[0, -1]])
        held = self.control_hold == "interval"
        form = ControlTrajectory.piecewise_constant if held else ControlTrajectory.piecewise_linear
        return np.array(self.states[:, 0]), form(self.times, controls)

    def step_info(
        self, state: int | str = 0, *, final: float | None = None, **options: Any
    ) -> dict[str, float]:
        """Rise time, overshoot, settling time of a state's step.

        The state is counted from where it starts, by `control.step_info`.

        Parameters
        ----------
        state : int or str
            Index or label.
        final : float, optional
            Value it is to settle at; by default the last one.
        **options
            SettlingTimeThreshold and RiseTimeLimits of `control.step_info`.

        Returns
        -------
        dict
            "RiseTime", "SettlingTime" [s], "Overshoot" [%], "Peak", ... of python-control.

        Raises
        ------
        ValueError
            If there is no such state, or it ends where it starts.

        Examples
        --------
        >>> import statebook as sb
        >>> run = sb.simulate(lambda x: 1 - x, [0.0], duration=20)
        >>> round(run.step_info()["RiseTime"], 2)
        2.2
        """
        import control

        labels = self._single("step_info").state_labels or ()
        if isinstance(state, str):
            state = labels.index(_validate.choice("state", state, labels))
        if _validate.integer("state", state, 0) >= self.n:
            raise ValueError(f"state must be below n = {self.n}, or a label, got {state}")
        times = self.times
        if self.dense is not None:
            times = np.union1d(times, np.linspace(times[0], times[-1], _FINE))
        values = self(times)[state]
        step = (values[-1] if final is None else _validate.number("final", final)) - values[0]
        if step == 0:
            raise ValueError(f"{labels[state]} ends where it starts, at {values[0]:g}: no step")
        return control.step_info(values - values[0], times, yfinal=step, **options)

    def to_response(self) -> control.TimeResponseData:
        """Convert to python-control's response; a batch becomes its traces.

        Returns
        -------
        control.TimeResponseData
            Its outputs are the states. It knows no controls per interval: the last is repeated.

        Examples
        --------
        >>> Trajectory([0, 1], [[0, 2]]).to_response().states.tolist()
        [[0.0, 2.0]]
        """
        import control

        inputs = self.controls
        if inputs is not None and self.control_hold == "interval":
            inputs = np.concatenate([inputs, inputs[..., -1:]], axis=-1)
        states, driven = list(self.state_labels or ()), list(self.input_labels or ()) or None
        names = {"output_labels": states, "state_labels": states, "input_labels": driven}
        samples = (self.times, self.states, self.states, inputs)
        return control.TimeResponseData(*samples, issiso=False, **names)

    @classmethod
    def from_response(cls, response: control.TimeResponseData) -> Trajectory:
        """Convert from python-control's response; its traces become a batch.

        Parameters
        ----------
        response : control.TimeResponseData
            It must contain states.

        Returns
        -------
        Trajectory
            With one control per time, if the response has inputs.

        Examples
        --------
        >>> Trajectory.from_response(Trajectory([0, 1], [[0, 2]]).to_response())
        Trajectory(n=1, m=0, 2 times over [0, 1] s)
        """
        states, controls = response.x, response.u
        if states is None:
            raise ValueError("response must contain states: ask for them with return_x=True")
        if controls is not None and controls.ndim < states.ndim:
            controls = np.broadcast_to(controls[:, None], (len(controls), *states.shape[1:]))
        driven = controls is not None and len(controls) > 0
        labels = response.state_labels, response.input_labels if driven else None
        return cls(response.t, states, controls if driven else None, (), *labels)

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the samples as a table, exactly.

        Columns are ``t``, ``x:`` and a label for each state, ``u:`` and a label for each
        control. The last row leaves controls per interval empty.

        Parameters
        ----------
        path : str or path
            File to write.
        """
        single = self._single("to_csv")
        rows = np.vstack([self.times, self.states]).T.tolist()
        if single.controls is not None:
            for row, control_row in zip(rows, single.controls.T.tolist(), strict=False):
                row.extend(control_row)
            rows[-1].extend([""] * (1 + self.n + self.m - len(rows[-1])))
        header = ["t", *(f"x:{label}" for label in self.state_labels or ())]
        with open(path, "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([*header, *(f"u:{label}" for label in self.input_labels or ())])
            writer.writerows(rows)

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str], *, circle: tuple[int, ...] = ()) -> Trajectory:
        """Read what `to_csv` wrote.

        Parameters
        ----------
        path : str or path
            File to read.
        circle : tuple of int
            Indices of circle-valued states; the file does not hold them.

        Returns
        -------
        Trajectory
        """
        with open(path, newline="", encoding="utf-8") as file:
            header, *rows = list(csv.reader(file)) or [[]]
        n, m = (sum(name.startswith(prefix) for name in header) for prefix in ("x:", "u:"))
        ordered = ["t"] * bool(header) + ["x:"] * n + ["u:"] * m
        if n == 0 or not rows or [name[:2] for name in header] != ordered:
            raise ValueError(
                f"{os.fspath(path)} must have the columns t, x:..., u:... and rows, got {header}"
            )
        held = m > 0 and not any(rows[-1][1 + n :])
        try:
            table = [[float(cell) for cell in row] for row in (rows[:-1] if held else rows)]
            last = [[float(cell) for cell in rows[-1][: 1 + n]]] if held else []
            samples = np.array([row[: 1 + n] for row in table] + last).T
            controls = np.array([row[1 + n :] for row in table]).reshape(len(table), m).T
        except ValueError as error:
            raise ValueError(f"{os.fspath(path)} must hold numbers in full rows: {error}") from None
        names = tuple(name[2:] for name in header[1:])
        found = (samples[0], samples[1:], controls if m else None)
        return cls(*found, circle, names[:n], names[n:])

    def _controls(self) -> np.ndarray:
        if self.controls is None:
            raise ValueError("the trajectory has no controls: it was made without")
        return self.controls

    def _single(self, name: str) -> Trajectory:
        if self.states.ndim == 3:
            raise ValueError(
                f"{name} takes one trajectory, got a batch of {self.states.shape[1]}: "
                "make one from states[:, i]"
            )
        return self


def of_run(
    samples: Trajectory, dense: DenseOutput | None, plan: ControlTrajectory | None
) -> Trajectory:
    """The trajectory of a run: its samples, and what is known between them."""
    vars(samples).update(dense=dense, plan=plan)
    return samples
