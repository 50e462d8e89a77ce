"""Exercises of primer 81, probability."""

from __future__ import annotations

import numpy as np

from statebook.grading.exercise import Exercise, Parameters, Slip


def _readings(rng: np.random.Generator) -> dict[str, float]:
    return {
        "sigma": round(float(rng.uniform(0.25, 0.6)), 2),
        "wanted": round(float(rng.uniform(0.03, 0.06)), 3),
    }


def _robot(rng: np.random.Generator) -> dict[str, float]:
    return {
        "sp": round(float(rng.uniform(0.1, 0.4)), 2),
        "sv": round(float(rng.uniform(0.2, 0.5)), 2),
        "T": round(float(rng.uniform(1.5, 3.5)), 1),
    }


def _moved(p: Parameters) -> np.ndarray:
    return np.array([[1.0, p.T], [0.0, 1.0]])


def _covariance(p: Parameters, power: int = 2) -> np.ndarray:
    return np.diag([p.sp, p.sv]) ** power


EXERCISES = (
    Exercise(
        "81.1",
        "How many readings",
        "compute",
        5,
        _readings,
        lambda p: (p.sigma / p.wanted) ** 2,
        (
            Slip(
                "an average of N is better by the root of N, not by N",
                lambda p: p.sigma / p.wanted,
            ),
            Slip(
                "turned over: you need more than one reading", lambda p: (p.wanted / p.sigma) ** 2
            ),
            Slip(
                "sigma and the wanted deviation both count squared",
                lambda p: p.sigma**2 / p.wanted,
            ),
        ),
        rtol=0.02,
    ),
    Exercise(
        "81.2",
        "Driving on without looking",
        "compute",
        5,
        _robot,
        lambda p: _moved(p) @ _covariance(p) @ _moved(p).T,
        (
            Slip(
                "a covariance is multiplied from both sides, F P F'",
                lambda p: _moved(p) @ _covariance(p),
            ),
            Slip(
                "F' P F is not F P F': which index of P belongs to which row of F?",
                lambda p: _moved(p).T @ _covariance(p) @ _moved(p),
            ),
            Slip(
                "the diagonal of a covariance holds variances, the squares of the deviations",
                lambda p: _moved(p) @ _covariance(p, 1) @ _moved(p).T,
            ),
            Slip(
                "variances add, deviations do not: the errors of p and v are independent at first",
                lambda p: np.array(
                    [[(p.sp + p.T * p.sv) ** 2, p.T * p.sv**2], [p.T * p.sv**2, p.sv**2]]
                ),
            ),
            Slip("that is the covariance before the drive", _covariance),
        ),
    ),
)
