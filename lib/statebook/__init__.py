"""A control-engineering workbook's library: models, stability, time scaling.

Every public name is an attribute of the package and is loaded when first used,
so that ``import statebook as sb`` costs next to nothing.

Examples
--------
>>> import statebook as sb
>>> sb.stability(sb.Pendulum(damping=0.1), x0=[-sb.pi / 2, 0]).verdict
'asymptotically stable'
"""

from __future__ import annotations

import importlib
import sys
from math import pi
from types import ModuleType
from typing import Any

__version__ = "0.1.0"

_MODULE_OF = {
    name: module
    for module, names in {
        "angles": "wrap_angle",
        "check": "check",
        "control_trajectory": "ControlTrajectory",
        "controllers": ("LQR PD PID CartPoleSwingUp SwingUp bang_bang cart_force simulate_clocked"),
        "derivatives": "InexactDerivativeWarning",
        "discretize": "discretize discretize_many map_eigenvalues critical_sample_time",
        "errors": (
            "DivergenceError EquilibriumNotFoundError InfeasiblePathError KinkError"
            " NotAnEquilibriumError"
        ),
        "integrate": (
            "METHODS ButcherTableau amplification_matrix integrate integrate_euler"
            " stability_function"
        ),
        "linearize": "Equilibrium find_equilibrium jacobians linearize",
        "models": "CartPole DubinsCar Oscillator Particle Pendulum PlanarArm",
        "plotting": "use_style",
        "simulate": "simulate",
        "stability": (
            "Mode StabilityReport critical_step distance_to_instability eigenvalue_map stability"
        ),
        "sweep": "sweep",
        "systems": "System as_system",
        "timescale": "Path TimedPath time_scale",
        "trajectory": "Trajectory",
        "uncertainty": (
            "HeldNoise consistency discretize_noise monte_carlo with_actuation_error"
            " with_disturbance with_measurement_error with_parameters"
        ),
    }.items()
    for name in names.split()
}
_MODULES = ("controllers", "plotting", "regression")

__all__ = ["pi", *_MODULE_OF, *_MODULES]


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF:
        value = getattr(importlib.import_module(f"statebook.{_MODULE_OF[name]}"), name)
    elif name in _MODULES:
        value = importlib.import_module(f"statebook.{name}")
    else:
        raise AttributeError(f"module 'statebook' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """The package: a public function wins over the submodule of the same name.

    Importing the submodule ``statebook.stability`` sets it as the package's attribute
    ``stability``, which belongs to the function.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if isinstance(value, ModuleType) and _MODULE_OF.get(name) == name:
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
