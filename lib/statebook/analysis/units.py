"""Units as a caller writes them: their dimension and size."""

import re

# By the exponents of (m, kg, s, A, K, mol), the size in SI units; an angle is a number.
_BY_DIMENSION = {
    (0, 0, 0, 0, 0, 0): {"1": 1.0, "rad": 1.0, "deg": 0.017453292519943295},
    (1, 0, 0, 0, 0, 0): {"m": 1.0},
    (0, 1, 0, 0, 0, 0): {"g": 1e-3},
    (0, 0, 1, 0, 0, 0): {"s": 1.0, "min": 60.0, "h": 3600.0},
    (0, 0, 0, 1, 0, 0): {"A": 1.0},
    (0, 0, 0, 0, 1, 0): {"K": 1.0, "degC": 1.0},
    (0, 0, 0, 0, 0, 1): {"mol": 1.0},
    (0, 0, -1, 0, 0, 0): {"Hz": 1.0, "rpm": 0.10471975511965977},
    (1, 1, -2, 0, 0, 0): {"N": 1.0},
    (2, 1, -2, 0, 0, 0): {"J": 1.0},
    (2, 1, -3, 0, 0, 0): {"W": 1.0},
    (-1, 1, -2, 0, 0, 0): {"Pa": 1.0},
    (2, 1, -3, -1, 0, 0): {"V": 1.0},
    (0, 0, 1, 1, 0, 0): {"C": 1.0},
    (3, 0, 0, 0, 0, 0): {"L": 1e-3},
}
_BASE = {name: (size, d) for d, units in _BY_DIMENSION.items() for name, size in units.items()}
_PREFIXES = {"k": 1e3, "M": 1e6, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}


def parsed(unit: str) -> tuple[float, tuple[int, ...]] | None:
    """Return the size of a unit in SI units and its dimension; None if it is not known.

    Parameters
    ----------
    unit : str
        As "mm/s", "N m", "m/s^2".

    Examples
    --------
    >>> parsed("mm/s")
    (0.001, (1, 0, -1, 0, 0, 0))
    >>> parsed("parsec") is None
    True
    """
    size, dimension = 1.0, [0] * 6
    for sign, part in zip("*" + "/" * unit.count("/"), unit.split("/"), strict=True):
        for word in part.replace("*", " ").split():
            found = re.fullmatch(r"([A-Za-z]+|1)\^?(\d)?", word)
            name = found[1] if found else ""
            prefix = 1.0
            if name not in _BASE and name[1:] in _BASE:
                prefix, name = _PREFIXES.get(name[0], 0.0), name[1:]
            if name not in _BASE or not prefix or found is None:
                return None
            power = int(found[2] or 1) * (-1 if sign == "/" else 1)
            size *= (prefix * _BASE[name][0]) ** power
            dimension = [d + power * e for d, e in zip(dimension, _BASE[name][1], strict=True)]
    return size, tuple(dimension)
