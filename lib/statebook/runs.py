"""A run of a simulation, from its first step to its trajectory."""

import warnings
from collections.abc import Callable, Iterable

import numpy as np

from statebook import _validate
from statebook.dense_output import DenseOutput, Steps
from statebook.errors import DivergenceError
from statebook.policies import Control, Stretch, held
from statebook.solvers import SOLVERS
from statebook.stepping import Flow, Solver, StoppedError, fixed_steps
from statebook.systems import System
from statebook.trajectory import Trajectory, of_run

_CONTRADICTION = 1e4  # tolerances
_LOOSE = 0.3  # of the states: what no tolerance makes a contradiction


@np.errstate(all="ignore")
def through(
    flow: Flow,
    steps: Steps,
    solver: Solver,
    stretches: Iterable[Stretch],
    control: Callable[[], Control],
    *,
    per_interval: bool = False,
) -> Trajectory:
    """Run a system through stretches; control() is asked at the end."""
    system = flow.system
    stop = None
    with warnings.catch_warnings():
        # An overflow is reported as the divergence it is; the solver's status says the rest.
        warnings.filterwarnings("ignore", module=r"scipy\.")
        try:
            if solver.method in SOLVERS and not system.discrete:
                solver.run(flow, steps, stretches, float(steps.times[-1]))
            else:
                fixed_steps(flow, steps, stretches, solver.method)
        except StoppedError as stopped:
            stop = stopped
    dense, felt = steps.settle(), control()
    states = np.concatenate(steps.samples, axis=-1)
    times = steps.shown[: states.shape[-1]]
    beyond = ~np.isfinite(states.reshape(-1, len(times))).all(axis=0)
    if beyond.any():  # within the last step, or where an interpolation asks outside the domain
        states, times = states[..., : np.argmax(beyond)], times[: np.argmax(beyond)]
        stop = stop or StoppedError("the interpolation is not finite", times[-1], states[..., -1])
    controls = None
    if system.m:
        at = times[:-1] if per_interval else times
        if felt.plan is not None:
            controls = felt.plan(at).reshape(system.m, *felt.batch, len(at))
        else:
            given = zip(np.moveaxis(states, -1, 0), at.tolist(), strict=False)
            controls = np.stack([flow.control(felt.policy, *xt) for xt in given], axis=-1)
    if controls is not None and not np.isfinite(controls).all():
        if stop is None:
            k = int(np.argmin(np.isfinite(controls).reshape(-1, controls.shape[-1]).all(axis=0)))
            raise ValueError(f"u(x, t) must be finite, got {controls[..., k]} at t = {times[k]:g}")
        controls = None  # the control is what stopped the simulation
    labels, plan = (None, None) if controls is None else (system.inputs, felt.plan)
    found = tuple(solver.found)
    samples = Trajectory(times, states, controls, (), system.states, labels, found)
    run = of_run(samples, dense, plan)
    if stop is not None:
        raise DivergenceError(
            f"simulation of {system.name} stopped at t = {stop.time:.6g}, x = "
            f"{_validate.brief(stop.state)}: {stop}; "
            f"{len(run.times)} of {len(steps.times)} samples are in .trajectory",
            time=stop.time,
            state=stop.state,
            trajectory=run,
        )
    if felt.is_policy and controls is not None and dense is not None and dense.curve:
        _warn_of_contradiction(run, dense, controls, flow, solver)
    return run


def may_vary(system: System) -> bool:
    """Whether the dynamics may depend on time by themselves."""
    return system.timed or (system.source is None and not system.linear)


def _warn_of_contradiction(
    run: Trajectory, dense: DenseOutput, controls: np.ndarray, flow: Flow, solver: Solver
) -> None:
    """Compare the dynamics under the returned controls with the slopes of the motion."""
    slopes, lengths = dense.slopes(run.times)
    if run.states.ndim == 2 and flow.system.batched and not may_vary(flow.system):
        rates = flow(run.states, held(controls), run.times[0])
    else:
        rates = np.empty(run.states.shape)
        for k, t in enumerate(run.times):
            rates[..., k] = flow(run.states[..., k], held(controls[..., k]), float(t))
    size = np.abs(run.states).max(axis=-1, keepdims=True)
    rtol = min(_CONTRADICTION * solver.rtol, _LOOSE)
    allowed = _CONTRADICTION * solver.atol.reshape(-1, *[1] * (size.ndim - 1)) + rtol * size
    worst = (np.abs(rates - slopes) * lengths / allowed).reshape(-1, len(run.times)).max(axis=0)
    k = int(np.argmax(worst))
    if worst[k] > 1:
        warnings.warn(
            f"the control returned at t = {run.times[k]:.6g} is not one that the motion felt: a "
            "pulse was stepped over; give max_step=, or the times of the pulse as switches=",
            stacklevel=5,
        )
