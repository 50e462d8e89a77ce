"""A control-engineering workbook's library: models, stability, time scaling.

Every public name is an attribute of the package and is loaded when first used,
so that ``import statebook as sb`` costs next to nothing.

Examples
--------
>>> import statebook as sb
>>> sb.stability(sb.Pendulum(damping=0.1), x0=[-sb.pi / 2, 0]).verdict
'asymptotically stable'
"""

from math import pi
from typing import Any

import lazy_loader

__version__ = "0.2.0"

# The stub beside this file says where each name is defined: to editors, type checkers and here.
_load, _, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = [*_names, "pi"]


def __getattr__(name: str) -> Any:
    if name == "regression":
        raise AttributeError(
            "statebook.regression is now the package nbregress: install lib/nbregress"
            " (pip install path/to/statebook/lib/nbregress), then use nbregress"
        )
    return _load(name)


def __dir__() -> list[str]:
    return sorted(__all__)
