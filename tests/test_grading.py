"""Answers are judged with a reason; nothing that a student hands in breaks the judge."""

from __future__ import annotations

import doctest
import functools
import json
import os
import re
import time
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg

import statebook as sb
from statebook.grading import sandbox
from statebook.grading.exercise import LEVELS, Exercise, Slip
from statebook.grading.grade import compare
from statebook.grading.students import hand_out, main, without_solutions
from statebook_exercises import ch08, ch09, ch92
from statebook_exercises.answers import Watched, beyond

WORKBOOK = Path(__file__).parents[1] / "workbook"
SOLVED = sorted((WORKBOOK / "exercises").glob("*.ipynb"))


def all_exercises() -> list[Exercise]:
    import importlib

    import statebook_exercises

    folder = Path(statebook_exercises.__path__[0])
    modules = [f"statebook_exercises.{path.stem}" for path in sorted(folder.glob("ch*.py"))]
    return [task for module in modules for task in importlib.import_module(module).EXERCISES]


EXERCISES = all_exercises()

# Wrong answers where many are right, with a word of the hint that fits.
WRONG = {
    "05.4": [(lambda p: lambda x, y, h: [x - h * (y + h * x), y + h * x], "where is w")],
    "07.4": [
        (
            lambda p: lambda x: p.m * p.L * (p.L * x[1] ** 2 / 2 - 9.8 * np.cos(x[0])),
            "height of the mass is L sin",
        )
    ],
    "07.5": [
        (lambda p: (0.9 * p.m * 9.8 * p.L, 1.0), "no more than m g L"),
        (lambda p: (6.0 * p.m * 9.8 * p.L, 1.0), "the motor's limit"),
        (lambda p: (2.6 * p.m * 9.8 * p.L, 0.0), "overshoots"),
        (lambda p: (1.1 * p.m * 9.8 * p.L, 1.0), "still"),
        (lambda p: (2.6 * p.m * 9.8 * p.L, -0.5), "the swing grows"),
        (lambda p: 3.0, r"shape \(2,\), got \(\)"),
        (lambda p: (2.6 * p.m * 9.8 * p.L, np.inf), "finite"),
        (lambda p: (2.6 * p.m * 9.8 * p.L, 1e9), "raised DivergenceError"),
    ],
    "07.6": [
        (lambda p: lambda x, t: 0.0, "Which sign of the torque adds energy"),
        (lambda p: lambda x, t: -p.limit if x[1] >= 0 else p.limit, "Which sign"),
        (lambda p: lambda x, t: 2 * p.limit, "and the limit is"),
        (lambda p: lambda x, t: 1 / 0, "division by zero"),
    ],
    "08.5": [
        (lambda p: -ch08.regulator(p), "even without a clock"),
        (lambda p: ch08.regulator(p, 0.01), "is too near"),
        (lambda p: ch08.regulator(p, 1.0), "from its place"),
        (lambda p: ch08.regulator(p, 0.1) * [1, 0.75, 1, 1], "still leans by"),
    ],
    "08.6": [
        (lambda p: np.array([1.288, 2.0]) * np.sqrt(p.L), "the plan needs"),
        (lambda p: np.array([1.55, 2.0]) * np.sqrt(p.L), "the pole is not caught"),
        (lambda p: (0.0, 1.0), "must lie between"),
    ],
    "09.5": [
        (lambda p: (p.room, 1), "to the side"),
        (lambda p: (2 * p.room, 1), "is none for a room"),
        (lambda p: (p.room, 1.5), "must be a whole one"),
        (lambda p: (np.sqrt(p.step * p.L / np.tan(np.radians(p.degrees)) / 40), 40), "in fewer"),
    ],
    "09.6": [
        (lambda p: np.zeros((3, 2)), "the car ends at"),
        (lambda p: [[1, 0], [-1, 1], [-1, -1]], "the wheels turn by"),
        (lambda p: ch09.parking(p) * [[-1, 1], [-1, 1], [-1, 1]], "touches a parked car"),
        (lambda p: [[40, 0], [-40, 0], [0, 0]], "60 m are allowed"),
    ],
    "01.1": [(lambda p: 0.075 * p.t**2, "under the push of the figure")],
    "03.2": [(lambda p: p.x0 * (1 - p.b) ** 2 + p.a * p.dt, "where is dt")],
    "03.4": [(lambda p: lambda T, dt: T * (p.v0 - p.g * T / 2), "the exact parabola")],
    "10.1": [
        (lambda p: (p.sigma, 2 * p.omega), "you count every zero"),
        (lambda p: (p.sigma, 2 * np.pi / p.omega), "is the period"),
        (lambda p: (p.sigma, p.omega / 2 / np.pi), "turns a second"),
        (lambda p: (p.sigma, p.omega / 2), "one period, not half"),
        (lambda p: (1 / p.sigma, p.omega), "a time"),
        (lambda p: (-p.sigma, p.omega), "counts as positive"),
        (lambda p: (1.3 * p.sigma, p.omega), "within 10 %"),
    ],
    "10.6": [
        (lambda p: (0.1 * p.m / p.h**2, 0.5 * p.m / p.h), "it is still"),
        (lambda p: (p.m / p.h**2, 3 * p.m / p.h), "on this clock the motion grows"),
        (lambda p: (-1.0, 1.0), "on this clock the motion grows"),
        (lambda p: (1.5 * p.m / p.h**2, 1.5 * p.m / p.h), "the force reaches"),
    ],
    "11.3": [
        (
            lambda p: [
                [np.cos(p.heading), 0],
                [np.sin(p.heading), 0],
                [np.tan(p.steer) / p.L, p.speed / p.L],
            ],
            "derivative of tan",
        )
    ],
    "12.2": [(lambda p: np.cbrt(3 * p.d**2 / p.q), "a force is divided by the mass")],
    "14.4": [(lambda p: lambda t, angle: np.diff(angle) / np.diff(t), "take the short way")],
    "15.4": [
        (
            lambda p: lambda z, k, ds: z + 2 * ds * np.sqrt(p.grip**2 - k * z**2),
            "square all of it",
        )
    ],
}


@pytest.mark.parametrize("task", EXERCISES, ids=lambda task: task.id)
def test_exercise_is_told_right_from_wrong(task):
    p = task.parameters("Ada")
    most = 180 if task.level == "project" else 60
    assert task.level in LEVELS and 0 < task.minutes <= most and task.title
    result = sb.grade(task.id, task.solution(p), "Ada")
    assert result and result.points == task.points
    unsolved = sb.grade(task.id, None, "Ada")
    assert not unsolved and unsolved.points == 0 and "no answer yet" in unsolved.message
    wrong = [(slip.answer, re.escape(slip.hint)) for slip in task.slips] + WRONG.get(task.id, [])
    assert len(wrong) >= 3
    for answer, hint in wrong:
        result = sb.grade(task.id, answer(p), "Ada")
        assert not result.right
        assert re.search(hint, result.message), result


def ball(p):
    """Height by Euler's method: the velocity falls by g dt a step, and moves the ball before."""

    def height(T, dt):
        steps = round(T / dt)
        return p.v0 * steps * dt - p.g * dt**2 * steps * (steps - 1) / 2

    return height


def tick(p, x):
    """A cart after a period of a held force."""
    force = -p.kp * x[0] - p.kd * x[1]
    return x[0] + p.h * x[1] + p.h**2 * force / (2 * p.m), x[1] + p.h * force / p.m


def beside(p):
    """The plane that touches a pendulum's rate at the angle, at rest."""

    def rate(x):
        pull = np.cos(p.angle) - np.sin(p.angle) * (x[0] - p.angle)
        return [x[1], -G / p.L * pull - p.b / (p.m * p.L**2) * x[1]]

    return rate


G = 9.8
# What the exercises ask for, in closed form: the checkers' own solutions are compared with it.
RIGHT = {
    "01.1": lambda p: p.d * p.t**2 / 4,
    "01.2": lambda p: [p.omega, (p.u / (p.m * p.L) - G * np.cos(p.theta)) / p.L],
    "01.4": lambda p: lambda x, plan: p.m * plan[2] + np.dot([p.kp, p.kd], plan[:2] - x),
    "02.2": lambda p: tick(p, (p.p, p.v)),
    "02.3": lambda p: lambda y, u: [y[1], (u - p.k * y[0] ** 3 - p.b * y[1]) / p.m],
    "02.4": lambda p: (
        lambda k: functools.reduce(lambda x, _: tick(p, x), range(int(k)), (p.p, p.v))[0]
    ),
    "03.2": lambda p: p.x0 * (1 - p.b * p.dt) ** 2 + p.a * p.dt**2,
    "03.3": lambda p: lambda t, dt: p.a**3 * dt**2 * t / 6,
    "03.4": ball,
    "03.7": lambda p: p.g * p.dt * p.T / 2,
    "03.8": lambda p: p.b * p.s * p.T * p.dt / 2,
    "04.2": lambda p: -np.arccos(p.u / (p.m * G * p.L)),
    "04.6": lambda p: [[0, 1], [G / p.L * np.sin(p.theta), -p.b / (p.m * p.L**2)]],
    "04.7": lambda p: -np.sqrt(2 * G / p.L * (p.theta - np.sin(p.theta))),
    "05.1": lambda p: scipy.linalg.expm(np.array([[0, 1], [-p.k / p.m, -p.c / p.m]]) * p.t)[0, 0],
    "05.2": lambda p: p.c / p.k,
    "05.4": lambda p: lambda x, y, h: [(1 - (h * p.w) ** 2) * x - h * p.w * y, y + h * p.w * x],
    "05.5": lambda p: p.r * np.array([np.cos(p.theta + p.t), np.sin(p.theta + p.t)]),
    "06.1": lambda p: 2 * np.sqrt(p.m * p.d / p.limit),
    "06.2": lambda p: p.p0 + p.m * p.v0**2 / (2 * p.u),
    "06.3": lambda p: lambda t: 6 * p.m * p.d / p.T**2 * (1 - 2 * t / p.T),
    "06.6": lambda p: lambda r, F: (r[0] - p.x) * F[1] - (r[1] - p.y) * F[0],
    "06.7": lambda p: np.sqrt(np.pi * p.M * p.w**2 / (3 * p.F * p.handle)),
    "07.2": lambda p: 2 * np.pi * np.sqrt(p.L / G),
    "07.3": lambda p: (
        lambda theta, omega, u: (u - p.b * omega) / (p.m * p.L**2) - G / p.L * np.cos(theta)
    ),
    "07.5": lambda p: [
        2.6 * p.m * G * p.L,
        2 * np.sqrt(1.6 * p.m**2 * G * p.L**3) - p.b,
    ],  # critically damped
    "07.4": lambda p: lambda x: p.m * (p.L * x[1]) ** 2 / 2 + p.m * G * p.L * np.sin(x[0]),
    "08.2": lambda p: np.sqrt(2 * G / p.L * (1 + p.m_pole / p.m_cart)),
    "08.4": lambda p: lambda theta, a: (a * np.sin(theta) - G * np.cos(theta)) / (p.share * p.L),
    "09.1": lambda p: p.L / np.tan(np.radians(p.degrees)),
    "09.2": lambda p: np.arctan(2 * p.L / p.width),
    "10.2": lambda p: lambda t: scipy.linalg.expm(np.array([[0, 1], [0, -p.c / p.m]]) * t),
    "10.3": lambda p: np.sqrt((p.k12 + p.k2) / p.m2),  # cart 2 absorbs
    "11.2": lambda p: np.roots([p.m * p.L**2, p.b, -p.m * G * p.L * np.sin(p.angle)]).real.max(),
    "11.3": lambda p: [
        [np.cos(p.heading), 0],
        [np.sin(p.heading), 0],
        [np.tan(p.steer) / p.L, p.speed / p.L * (1 + np.tan(p.steer) ** 2)],
    ],
    "11.4": beside,
    "12.1": lambda p: (p.sigma / p.b) ** 2,
    "12.2": lambda p: np.cbrt(3 * (p.m * p.d) ** 2 / p.q),
    "12.3": lambda p: lambda kp, kd: np.sqrt([p.q / (2 * kp * kd), p.q / (2 * p.m * kd)]),
    "12.4": lambda p: lambda z, h: z * np.sqrt(p.q / h),
    "13.1": lambda p: np.hypot(p.sigma, p.sigma) / p.h,
    "13.2": lambda p: np.sqrt(p.nees / 2),
    "13.3": lambda p: (
        lambda x, P, z: [(x * p.sigma**2 + z * P) / (P + p.sigma**2), 1 / (1 / P + 1 / p.sigma**2)]
    ),
    "14.1": lambda p: np.log(p.error_coarse / p.error_fine) / np.log(p.coarse / p.fine),
    "14.2": lambda p: np.sqrt(8 * p.error / 1000 / p.largest),
    "14.3": lambda p: lambda times, values, t: np.interp(t, times, values),
    "14.4": lambda p: lambda times, angles: np.diff(np.unwrap(angles)) / np.diff(times),
    "15.2": lambda p: p.d / p.v_max + p.v_max / p.a_max,
    "15.3": lambda p: (
        lambda s, v, a: [-p.A * (np.cos(s) * v**2 + np.sin(s) * a), 2 * p.B * (v**2 + s * a)]
    ),
    "15.4": lambda p: lambda z, k, ds: z + 2 * ds * np.sqrt(p.grip**2 - (k * z) ** 2),
    "16.1": lambda p: np.linalg.solve([[p.a1, p.b1], [p.a2, p.b2]], [1, -1]),
    "16.3": lambda p: (
        lambda s: p.m * p.L * np.array([2 * p.L * p.A * s, 2 * p.L * p.A, G * np.sin(p.A * s**2)])
    ),
    "17.1": lambda p: p.quickest / np.sqrt(1 - p.kept),
    "17.2": lambda p: (
        np.array([p.a * p.b * p.s, p.q * (p.r + p.b**2 * p.s) + p.a**2 * p.s * p.r])
        / (p.r + p.b**2 * p.s)
    ),
    "17.3": lambda p: lambda a, jounce: (p.M + p.m) * a + p.M * p.rope / G * jounce,
    "81.1": lambda p: (p.sigma / p.wanted) ** 2,
    "81.2": lambda p: np.diag([p.sp**2, 0]) + p.sv**2 * np.outer([p.T, 1], [p.T, 1]),
    "82.1": lambda p: [G + p.reach * p.rate**2, 2 * p.reach * p.rate],
}


@pytest.mark.parametrize("id", RIGHT)
@pytest.mark.parametrize("student", ["Ada", "Bob"])
def test_solutions_are_the_closed_forms(id, student):
    task = next(task for task in EXERCISES if task.id == id)
    p = task.parameters(student)
    found, expected = task.solution(p), RIGHT[id](p)
    if task.inputs is None:
        np.testing.assert_allclose(found, expected, rtol=1e-6)
        return
    for arguments in task.inputs(p, task.rng(student)):
        np.testing.assert_allclose(found(*arguments), expected(*arguments), rtol=1e-6, atol=1e-9)


def test_a_force_gives_the_cart_its_acceleration():
    task = next(task for task in EXERCISES if task.id == "08.3")
    p = task.parameters("Ada")
    model = sb.CartPole(m_cart=p.m_cart, m_pole=p.m_pole, L=p.L)
    for theta, omega, a in task.inputs(p, task.rng("Ada")):
        force = task.solution(p)(theta, omega, a)
        rate = model.dynamics(np.array([0.0, theta, 0.0, omega]), np.array([force, 0.0]))
        assert rate[2] == pytest.approx(a, rel=1e-9, abs=1e-9)


def test_gains_through_a_lag_have_the_damping_that_is_asked_for():
    task = next(task for task in EXERCISES if task.id == "11.5")
    p = task.parameters("Ada")
    kp, kd = task.solution(p)
    inertia, weight = p.m * p.L**2, p.m * G * p.L
    loop = [inertia * p.lag, inertia + p.b * p.lag, p.b - weight * p.lag + kd, kp - weight]
    values = np.roots(loop)
    assert (-values.real >= 0.6 * np.abs(values)).all() and (-1 / values.real <= p.tau).all()


def test_one_round_is_enough_in_a_wide_room():
    task = next(task for task in EXERCISES if task.id == "09.5")
    p = task.parameters("Ada")
    turn = np.tan(np.radians(p.degrees)) / p.L
    p.room = 2.0
    p.step = p.room * np.sin(turn * p.room)
    assert not task.judge((p.room, 1), p)


def test_the_hand_is_where_it_is_asked_to_be():
    tasks = {task.id: task for task in EXERCISES}
    p = tasks["93.2"].parameters("Ada")
    for (s,) in tasks["93.2"].inputs(p, tasks["93.2"].rng("Ada")):
        q1, q2 = tasks["93.2"].solution(p)(s)
        hand = p.l1 * np.exp(1j * q1) + p.l2 * np.exp(1j * (q1 + q2))
        assert q2 < 0
        assert hand == pytest.approx(complex(p.xa, p.ya) * (1 - s) + complex(p.xb, p.yb) * s)
    p = tasks["16.6"].parameters("Ada")
    q1, q2 = tasks["16.6"].solution(p)
    assert 0.6 * np.exp(1j * q1) + 0.5 * np.exp(1j * (q1 + q2)) == pytest.approx(complex(p.x, p.y))
    assert np.sign(q2) == p.side


@pytest.mark.parametrize("task", EXERCISES, ids=lambda task: task.id)
def test_two_students_have_two_pendulums(task):
    ada, bob = (vars(task.parameters(name)) for name in ("Ada", "Bob"))
    assert ada.keys() == bob.keys() and ada != bob
    assert vars(task.parameters(" ada ")) == ada


def test_notebooks_announce_the_exercises_as_they_are():
    announced = {}
    for path in SOLVED:
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            heading = re.match(r"## (\d+)\. (.*) \((.*), (\d+) minutes\)", "".join(cell["source"]))
            if heading:
                number, *rest = heading.groups()
                announced[f"{path.stem[:2]}.{number}"] = [text.replace("$", "") for text in rest]
    assert announced == {task.id: [task.title, task.level, str(task.minutes)] for task in EXERCISES}


def test_ids_are_unique_and_named_after_their_chapter():
    ids = [task.id for task in EXERCISES]
    assert len(set(ids)) == len(ids)
    assert all(re.fullmatch(r"\d\d\.\d+", id) for id in ids)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: sb.exercise("07.99", "Ada"), ValueError, "has the exercises 07.1, 07.2"),
        (lambda: sb.exercise("98.1", "Ada"), ValueError, "must name an exercise"),
        (lambda: sb.exercise("../x", "Ada"), ValueError, "must name an exercise"),
        (lambda: sb.exercise(7.2, "Ada"), TypeError, "must be a text"),
        (lambda: sb.exercise("07.2", ""), TypeError, "your name or number"),
        (lambda: sb.grade("07.2", 1.0, None), TypeError, "your name or number"),
    ],
)
def test_bad_input(call, error, words):
    with pytest.raises(error, match=words):
        call()


# ---- numbers ----


def verdict(answer, wanted, slips=()):
    task = Exercise("00.0", "t", "compute", 1, dict, lambda p: wanted, tuple(slips), rtol=1e-3)
    return compare(answer, wanted, task, lambda slip: slip(None))


@pytest.mark.parametrize(
    ("answer", "wanted", "words"),
    [
        (2.0005, 2.0, ""),
        (np.float32(2.0), 2.0, ""),
        (2.1, 2.0, "that is not it"),
        (-2.0, 2.0, "sign"),
        (4.0, 2.0, "1/2 missing"),
        (1.0, 2.0, "1/2 too many"),
        (np.degrees(2.0), 2.0, "degrees or radians"),
        (np.radians(2.0), 2.0, "degrees or radians"),
        (2000.0, 2.0, "thousand times too large"),
        ([2.0], 2.0, "must have shape"),
        ("2", 2.0, "must be a number, got a text"),
        (2 + 1j, 2.0, "must be a number"),
        (np.complex128(2.0), 2.0, ""),
        (np.array([1 + 0j, 2 - 0j]), [1.0, 2.0], ""),
        (np.array([1 + 0j, 2 + 1e-9j]), [1.0, 2.0], "must be an array of shape (2,), got"),
        (np.nan, 2.0, "must be finite"),
        ({}, 2.0, "got a value of type dict"),
        (np.array(2.0), 2.0, ""),
        (Fraction(2), 2.0, ""),
        (10**30, 1e30, ""),
        (True, 1.0, "got a value of type bool"),
        ([None], 2.0, "must be a number, got a list of other things"),
        (iter([2.0]), 2.0, "must be a number"),
        ([[1, 3], [2, 4]], [[1, 2], [3, 4]], "transposed"),
        ([[1, 4], [2, 5], [3, 6]], [[1, 2, 3], [4, 5, 6]], "is it transposed"),
        ([1.0, -2.0], [1.0, 2.0], "signs"),
        ([1.0, 2.0, 3.0], [1.0, 2.0], "shape"),
        (1.0, [1.0, 2.0], "give 2 numbers"),
        ([1.0, 2.0], 1.0, "give one number"),
        (" Stable ", "stable", ""),
        ("unstable", "stable", "that is not it"),
        (1.0, "stable", "must be a text, got a number"),
    ],
)
def test_comparison(answer, wanted, words):
    message = verdict(answer, wanted)
    assert words in message if words else message == ""


def test_a_rough_reading_is_not_taken_for_degrees():
    task = Exercise("00.0", "t", "read off", 1, dict, lambda p: 88.0, rtol=0.25)
    assert compare(np.log10(88.0), 88.0, task, lambda slip: slip(None)) == "that is not it"


def test_a_limit_that_is_met_to_the_last_digit_is_met():
    assert not beyond(0.1 + 0.2, 0.3)
    assert beyond(0.301, 0.3)
    assert not beyond(-0.3, -0.1 - 0.2)
    budget = sb.exercise("16.5", "Mira").budget
    assert sb.grade("16.5", (0.7 * budget, 0.3 * budget), "Mira")


def test_a_slip_has_its_own_hint_before_the_general_ones():
    slip = Slip("where is the half?", lambda p: 4.0)
    assert verdict(4.0, 2.0, [slip]) == "where is the half?"


# ---- functions ----


def right(theta, omega, u):
    p = sb.exercise("07.3", "Ada")
    return (u - p.m * 9.8 * p.L * np.cos(theta) - p.b * omega) / (p.m * p.L**2)


def raises(theta, omega, u):
    raise KeyError("lost")


def pair(theta, omega, u):
    return [1.0, 2.0]


def test_functions_are_judged():
    assert sb.grade("07.3", right, "Ada")
    assert "raised KeyError" in sb.grade("07.3", raises, "Ada").message
    assert "must return shape ()" in sb.grade("07.3", pair, "Ada").message
    assert "returns None" in sb.grade("07.3", lambda *a: None, "Ada").message
    assert "must be a function, got a number" in sb.grade("07.3", 3.0, "Ada").message
    assert "call it" in sb.grade("07.2", right, "Ada").message


def test_a_function_that_changes_its_argument_is_told():
    def energy(x):
        x *= 2
        return 0.0

    assert "changes its argument" in sb.grade("07.4", energy, "Ada").message


def test_a_loop_without_end_is_ended(monkeypatch):
    monkeypatch.setattr(sandbox, "TIMEOUT", 1.0)

    def forever(theta, omega, u):
        while True:
            pass

    start = time.monotonic()
    assert "loop without an end" in sb.grade("07.3", forever, "Ada").message
    assert time.monotonic() - start < 20


def interrupt(text):
    raise KeyboardInterrupt


def test_numbers_are_judged_by_one_process_and_by_another_where_it_is_gone(monkeypatch):
    gains, idle = next(e for e in EXERCISES if e.id == "08.5").solution, sandbox._IDLE
    p = next(e for e in EXERCISES if e.id == "08.5").parameters("Ada")
    assert sb.grade("08.5", gains(p), "Ada")
    first = idle[os.getpid()]._child
    assert not sb.grade("08.5", -gains(p), "Ada") and idle[os.getpid()]._child is first
    assert sb.grade("07.3", right, "Ada") and idle[os.getpid()]._child is first  # not for functions
    first.kill()
    first.wait()
    assert sb.grade("08.5", gains(p), "Ada") and idle[os.getpid()]._child is not first
    with monkeypatch.context() as interrupted, pytest.raises(KeyboardInterrupt):
        interrupted.setattr(sandbox.json, "loads", interrupt)
        sb.grade("08.5", -gains(p), "Ada")
    assert os.getpid() not in idle and sb.grade("08.5", gains(p), "Ada")  # nobody else's verdict
    monkeypatch.setattr(sandbox, "TIMEOUT", 0.0)
    assert "was not done after" in sb.grade("08.5", gains(p), "Ada").message
    assert os.getpid() not in idle


def test_where_there_are_no_processes_a_function_is_called_here(monkeypatch):
    monkeypatch.setattr(sandbox.sys, "platform", "emscripten")
    monkeypatch.delattr(sandbox.subprocess, "Popen")
    assert sb.grade("07.3", right, "Ada")
    assert "raised KeyError" in sb.grade("07.3", raises, "Ada").message
    assert "must return shape ()" in sb.grade("07.3", pair, "Ada").message


def test_a_process_that_ends_itself_is_explained():
    def leave(theta, omega, u):
        import os

        os._exit(3)

    assert "ended its process" in sb.grade("07.3", leave, "Ada").message


def test_what_cannot_travel_is_explained(tmp_path):
    with (tmp_path / "file").open("w") as file:
        result = sb.grade("07.3", lambda theta, omega, u: file.tell(), "Ada")
    assert "process of its own" in result.message


def test_what_a_function_prints_does_not_disturb(capfd):
    def loud(theta, omega, u):
        print("x" * 1000)
        return right(theta, omega, u)

    assert sb.grade("07.3", loud, "Ada")
    assert capfd.readouterr().out == ""


def test_what_a_function_does_to_its_process_does_not_touch_the_judge():
    def forges(theta, omega, u):
        import os

        for stream in range(1, 10):
            with suppress(OSError):
                os.write(stream, b'{"value": 0.0, "trouble": ""}\n')
        return 0.0

    def patches(theta, omega, u):
        from statebook.grading import grade

        np.abs = lambda *a, **k: 0.0
        grade.compare = lambda *a: ""
        return 0.0

    def speaks(theta, omega, u):
        import os

        os.write(1, b"out")
        os.write(2, b"err")
        return right(theta, omega, u)

    assert not sb.grade("07.3", forges, "Ada")
    assert not sb.grade("07.3", patches, "Ada")
    assert sb.grade("07.3", speaks, "Ada")


def test_what_a_function_leaves_running_does_not_hold_the_judge():
    def leaves(theta, omega, u):
        import threading

        threading.Thread(target=threading.Event().wait).start()
        return right(theta, omega, u)

    assert sb.grade("07.3", leaves, "Ada")


class Unspeakable(Exception):
    def __str__(self):
        raise RuntimeError


def test_odd_functions_get_their_sentence():
    buffer = np.zeros(())

    def own_buffer(theta, omega, u):
        buffer[...] = right(theta, omega, u)
        return buffer

    def unspeakable(theta, omega, u):
        raise Unspeakable

    def long_winded(theta, omega, u):
        raise ValueError("y" * 10**7)

    def deep(theta, omega, u):
        return deep(theta, omega, u)

    cached = functools.lru_cache(lambda theta, omega, u: float(right(theta, omega, u)))
    for function in (own_buffer, cached, functools.partial(right)):
        assert sb.grade("07.3", function, "Ada")
    for function, words in [
        (unspeakable, "raised Unspeakable"),
        (deep, "RecursionError"),
        (lambda *a: input(), "EOFError"),
        (lambda *a: "1", "got a text"),
        (lambda *a: 1j, "type complex"),
        (lambda *a: (1.0 for _ in a), "type generator"),
        (lambda *a: range(10**12), "entries at most"),
        (lambda a: a, "takes 1 positional"),
        (lambda *a: np.nan, "finite"),
    ]:
        assert words in sb.grade("07.3", function, "Ada").message
    assert len(sb.grade("07.3", long_winded, "Ada").message) < 300
    assert "entries at most" in sb.grade("07.2", range(10**12), "Ada").message


@pytest.mark.parametrize("value", [1e300, -1e12, np.inf])
def test_a_huge_torque_is_told_at_once(value):
    assert "and the limit is" in sb.grade("07.6", lambda x, t: value, "Ada").message


def test_a_name_counts_however_it_is_typed():
    one, other = (sb.exercise("07.2", name) for name in ("Jos\u00e9  Ruiz", " jose\u0301 ruiz"))
    assert one == other
    assert sb.exercise("07.2", np.int64(7)) == sb.exercise("07.2", 7)
    assert sb.exercise("07.2", "\ud800").L > 0


# ---- copies for students ----


def cell(source, kind="code", **metadata):
    base = {"cell_type": kind, "source": source, "metadata": metadata}
    return base | (
        {"outputs": [{"text": "secret"}], "execution_count": 1} if kind == "code" else {}
    )


def test_solutions_go_with_all_that_belongs_to_them():
    picture = cell("why", "markdown", tags=["solution"]) | {"attachments": {"a.png": {}}}
    marked = cell(
        "x = 0\n### BEGIN SOLUTION\nx = 1\n### END SOLUTION\nprint(x)", covers={"1": ["a"]}
    )
    copy = without_solutions({"cells": [cell("task", "markdown"), picture, marked]})
    assert [c["source"] for c in copy["cells"]] == ["task", "x = 0\nprint(x)"]
    text = json.dumps(copy)
    assert not re.search("secret|why|a.png|SOLUTION|covers", text)


def test_a_mark_without_its_partner_is_refused():
    with pytest.raises(ValueError, match="must have pairs"):
        without_solutions({"cells": [cell("### BEGIN SOLUTION\nx = 1")]})


def test_a_policy_under_limits_returns_one_number_for_each():
    law = Watched(lambda x, t: (3 * x[0], t), [1.0, 2.0])
    np.testing.assert_array_equal(law(np.array([0.5]), -1.0), [1.0, -1.0])
    np.testing.assert_array_equal(law.asked, [1.5, 1.0])
    for answer, words in ((0.5, r"2 finite numbers, got \[0.5\]"), ((1.0, np.inf), "2 finite")):
        with pytest.raises(ValueError, match=words):
            Watched(lambda x, t, answer=answer: answer, [1.0, 2.0])(np.zeros(1), 0.0)


def test_a_car_is_parked_from_the_first_sample_of_its_rest_on():
    times = np.linspace(0.0, 4.0, 41)
    x = np.minimum(times - 2.0, 0.0)
    run = SimpleNamespace(times=times, states=np.stack([x, 0 * x, 0 * x]))
    assert ch92._parked(run) == pytest.approx(2.0)


def test_a_hand_out_of_exercises_alone_keeps_their_folder(tmp_path):
    kept = tmp_path / "workbook" / "exercises" / SOLVED[0].name
    kept.parent.mkdir(parents=True)
    kept.write_bytes(SOLVED[0].read_bytes())
    (written,) = hand_out(tmp_path / "workbook", tmp_path / "a" / "course")
    assert written == tmp_path / "a" / "course" / "exercises" / SOLVED[0].name and written.is_file()


def test_hand_out_holds_no_solution(tmp_path):
    written = hand_out(WORKBOOK, tmp_path / "course")
    exercises = [path for path in written if path.parent.name == "exercises"]
    assert len(exercises) == len(SOLVED) > 0
    assert (tmp_path / "course" / "07_pendulum.ipynb") in written
    for path, solved in zip(exercises, SOLVED, strict=True):
        text = path.read_text(encoding="utf-8")
        assert "SOLUTION" not in text and "solution" not in text.replace('"solution": ', "")
        cells = json.loads(solved.read_text(encoding="utf-8"))["cells"]
        secret = ["solution" in c["metadata"].get("tags", []) for c in cells]
        lines = [{line.strip() for line in "".join(c["source"]).splitlines()} for c in cells]
        # A cell to debug shares most of its lines with its solution: those are no secret.
        shown = set().union(*(found for found, s in zip(lines, secret, strict=True) if not s))
        for found in (found for found, s in zip(lines, secret, strict=True) if s):
            longest = max(found - shown, key=len)
            assert json.dumps(longest, ensure_ascii=False)[1:-1] not in text
    assert [p.name for p in tmp_path.iterdir()] == ["course"]


@pytest.mark.parametrize("path", SOLVED, ids=lambda path: path.stem)
def test_the_copy_runs_and_every_answer_is_still_open(path):
    copy = without_solutions(json.loads(path.read_text(encoding="utf-8")))
    space: dict = {}
    results = []
    for c in copy["cells"]:
        if c["cell_type"] == "code":
            source = c["source"].replace('me = ""', 'me = "Ada"')
            exec(compile(source, path.name, "exec"), space)
            if "sb.grade" in source:
                results.append(space["result"])
    ids = [task.id for task in EXERCISES if task.id[:2] == path.stem[:2]]
    assert [result.id for result in results] == ids
    assert not any(results)
    # What is handed out to be mended has a hint of its own.
    assert "that is not it" not in [result.message for result in results]


@pytest.mark.parametrize("path", SOLVED, ids=lambda path: path.stem)
def test_nbgrader_finds_the_points_and_leaves_the_rest_to_the_student(path):
    copy = without_solutions(json.loads(path.read_text(encoding="utf-8")))
    cells = [c for c in copy["cells"] if "nbgrader" in c["metadata"]]
    marks = [c["metadata"]["nbgrader"] for c in cells]
    # nbgrader empties a "solution" cell without marks, and grades a cell that is locked.
    assert all(m["grade"] and m["locked"] and not m["solution"] for m in marks)
    assert all(
        c["cell_type"] == "code" and m["schema_version"] == 3
        for c, m in zip(cells, marks, strict=True)
    )
    assert len({m["grade_id"] for m in marks}) == len(marks)
    tasks = [task for task in EXERCISES if task.id[:2] == path.stem[:2]]
    assert [m["points"] for m in marks] == [task.points for task in tasks]
    # A number as the last expression is the cell's part of its points.
    assert all(c["source"].splitlines()[-1] == "result.points" for c in cells)


def test_page_on_teaching_shows_what_happens():
    page = WORKBOOK.parent / "book" / "teach.md"
    results = doctest.testfile(str(page), module_relative=False)
    assert results.attempted and not results.failed


def test_students_work_is_not_overwritten(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match="must be new or empty"):
        hand_out(WORKBOOK, tmp_path)
    with pytest.raises(ValueError, match="must not lie in"):
        hand_out(WORKBOOK, WORKBOOK / "course")
    with pytest.raises(ValueError, match="must hold the workbook's notebooks"):
        hand_out(tmp_path, tmp_path.parent / "course")
    with pytest.raises(SystemExit, match=r"students: .* must be new or empty"):
        main([str(tmp_path), "--workbook", str(WORKBOOK)])
    assert (tmp_path / "notes.txt").read_text() == "mine"
