"""Exercises of primer 82, feedback."""

from __future__ import annotations

import numpy as np

from statebook.grading.exercise import Exercise, Parameters, Slip

G = 9.8


def _stick(rng: np.random.Generator) -> dict[str, float]:
    """A stick on a hand, and the rate that its loop is to have."""
    return {
        "reach": round(float(rng.uniform(0.3, 0.9)), 2),
        "rate": round(float(rng.uniform(3.5, 7.5)), 1),
    }


def _gains(p: Parameters) -> np.ndarray:
    """Lean and rate: both eigenvalues at -rate."""
    return np.array([G + p.reach * p.rate**2, 2 * p.reach * p.rate])


def _observer(p: Parameters) -> np.ndarray:
    """Eigenvalues of the error at -rate and -1.5 rate."""
    return np.array([2.5 * p.rate, 1.5 * p.rate**2 + G / p.reach])


EXERCISES = (
    Exercise(
        "82.1",
        "Two gains for a stick",
        "compute",
        10,
        _stick,
        _gains,
        (
            Slip(
                "gravity is missing: its part of the lean's equation must be overcome first",
                lambda p: _gains(p) - [G, 0.0],
            ),
            Slip(
                "gravity turns the stick further: the gain must exceed g, not fall short of it",
                lambda p: _gains(p) - [2 * G, 0.0],
            ),
            Slip(
                "u is an acceleration of the pivot: divided by the reach it turns the stick",
                lambda p: np.array([G / p.reach + p.rate**2, 2 * p.rate]),
            ),
            Slip(
                "(s + r)^2 = s^2 + 2 r s + r^2: a factor of two in the rate's gain",
                lambda p: _gains(p) * [1.0, 0.5],
            ),
            Slip("the order is lean, rate", lambda p: _gains(p)[::-1]),
            Slip("u = -K x: look at the sign", lambda p: -_gains(p)),
        ),
    ),
    Exercise(
        "82.2",
        "An observer that runs away",
        "debug",
        15,
        _stick,
        _observer,
        (
            Slip(
                "that is the gain for A - C' K; the observer's error has A - L C: transpose A",
                lambda p: np.array([2.5 * p.rate, 1 + 1.5 * p.rate**2 * p.reach / G]),
            ),
            Slip(
                "that adds gravity with the wrong sign: write down the polynomial of A - L C",
                lambda p: _observer(p) - [0.0, 2 * G / p.reach],
            ),
            Slip(
                "gravity is missing: write down the polynomial of A - L C",
                lambda p: _observer(p) - [0.0, G / p.reach],
            ),
            Slip(
                "the first entry corrects the lean, the second the rate",
                lambda p: _observer(p)[::-1],
            ),
        ),
        points=2,
    ),
)
