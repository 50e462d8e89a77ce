"""Grade an answer: right, or what is wrong with it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from statebook.grading.exercise import Exercise, Parameters, Rubric, find_exercise, student_named
from statebook.grading.sandbox import AnswerError, Apart, as_array, kind, told

# A wrong number that is the right one times one of these comes from a slip of this kind.
_FACTORS = {
    -1.0: "look at the sign",
    0.5: "you are off by a factor of two: is there a 1/2 too many?",
    2.0: "you are off by a factor of two: is there a 1/2 missing?",
    np.pi / 180: "degrees or radians?",
    180 / np.pi: "degrees or radians?",
    1e3: "the unit: it is a thousand times too large",
    1e-3: "the unit: it is a thousand times too small",
}


@dataclass(frozen=True)
class Grade:
    """What came of grading an answer; true where the answer is right.

    Attributes
    ----------
    id : str
        The exercise.
    right : bool
    message : str
        What is wrong with it, or that nothing is.
    points : int
    """

    id: str
    right: bool
    message: str
    points: int

    def __bool__(self) -> bool:
        return self.right

    def __repr__(self) -> str:
        return f"{self.id} {'right' if self.right else 'not yet'}: {self.message}"


def grade(id: str, answer: Any, student: str | int) -> Grade:
    """Grade an answer to an exercise, offline.

    A function runs in a process of its own, for 30 seconds at most, so nothing that it does
    disturbs the notebook or the judge. The checkers can be read, in ``statebook_exercises``:
    whoever wants to cheat can, and learns something on the way.

    Parameters
    ----------
    id : str
        Chapter and number, as "07.2".
    answer : object
        A number, an array, a text or a function, as the exercise says.
    student : str or int
        Your name or number, as in `exercise`: it decides the parameters.

    Returns
    -------
    Grade

    Raises
    ------
    TypeError, ValueError
        There is no such exercise, or student is empty.

    Examples
    --------
    >>> L = __import__("statebook").exercise("07.2", "Ada").L
    >>> grade("07.2", 2 * np.pi * (L / 9.8) ** 0.5, "Ada")
    07.2 right: yes (1 of 1 points)
    >>> grade("07.2", None, "Ada")
    07.2 not yet: there is no answer yet: replace None
    """
    task = find_exercise(id)
    p = task.parameters(student_named(student))
    try:
        trouble = _trouble(task, answer, p, student)
    except AnswerError as error:
        trouble = str(error)
    except ModuleNotFoundError:
        raise  # no fault of the answer
    except Exception as error:  # whatever an answer is, the student gets a sentence
        trouble = f"this answer does not work ({told(error)})"
    rows = f"\n{trouble}" if isinstance(trouble, Rubric) else ""
    points = trouble.points if isinstance(trouble, Rubric) else 0 if trouble else task.points
    right, earned = points == task.points, f"{points} of {task.points} points"
    message = (f"yes ({earned})" if right else earned if rows else str(trouble)) + rows
    return Grade(id, right, message, points)


def _trouble(task: Exercise, answer: Any, p: Parameters, student: str | int) -> str | Rubric:
    if answer is None or answer is ...:
        return f"there is no answer yet: replace {answer!r}"
    wanted = task.solution(p)
    if callable(wanted) and not callable(answer):
        return f"the answer must be a function, got {kind(answer)}"
    if callable(answer) and not callable(wanted):
        return f"the answer must be {kind(wanted)}, got a function: call it"
    if callable(wanted):
        with Apart(answer) as function:
            try:
                trouble = (task.judge or partial(_compared, task, student))(function, p)
            except Exception:
                if not function.trouble:
                    raise
            return function.trouble or trouble
    if task.judge is not None:
        value = as_array(answer)
        if trouble := _not_like(value, np.asarray(wanted, dtype=float), answer):
            return trouble
        with Apart(partial(_judged, task.id, student, value), ours=True) as verdict:
            return str(verdict.reply())
    return compare(answer, wanted, task, lambda slip: slip(p))


def _judged(id: str, student: str | int, answer: np.ndarray) -> str:
    task = find_exercise(id)
    assert task.judge is not None
    return str(task.judge(answer, task.parameters(student)))


def _compared(task: Exercise, student: str | int, function: Apart, p: Parameters) -> str:
    """Compare a function with the solution at the exercise's inputs."""
    assert task.inputs is not None
    points = task.inputs(p, task.rng(student))

    def values(called: Callable[..., Any]) -> np.ndarray:
        return np.stack([np.asarray(called(*point), dtype=float) for point in points])

    wanted, found = values(task.solution(p)), []
    for point in points:
        found.append(function(*point))
        if np.shape(found[-1]) != wanted.shape[1:]:
            return f"your function must return shape {wanted.shape[1:]}, got {np.shape(found[-1])}"
    return compare(np.stack(found), wanted, task, lambda slip: values(slip(p)))


def compare(
    answer: Any, wanted: Any, task: Exercise, slipped: Callable[[Callable[..., Any]], Any]
) -> str:
    """Return what is wrong with an answer of numbers or a text, or nothing."""
    if isinstance(wanted, str):
        if not isinstance(answer, str):
            return f"the answer must be a text, got {kind(answer)}"
        same = answer.strip().casefold()
        if same == wanted.casefold():
            return ""
        hints = (s.hint for s in task.slips if slipped(s.answer).casefold() == same)
        return next(hints, "that is not it")
    value, wanted = as_array(answer), np.asarray(wanted, dtype=float)
    if trouble := _not_like(value, wanted, answer):
        return trouble
    exact = min(task.rtol, 0.02)  # a figure may be read off roughly; no factor is a coincidence
    guesses = chain(
        [("", wanted, task.rtol)],
        ((slip.hint, slipped(slip.answer), task.rtol) for slip in task.slips),
        [("is it transposed?", wanted.T, task.rtol)],
        ((hint, factor * wanted, exact) for factor, hint in _FACTORS.items()),
        [("look at the signs", np.copysign(wanted, value), task.rtol)],
    )
    said = (hint for hint, guess, rtol in guesses if _close(value, guess, rtol))
    return next(said, "that is not it")


def _not_like(value: np.ndarray, wanted: np.ndarray, answer: Any) -> str:
    """Return what is wrong with the type or shape of an answer, or nothing."""
    if value.dtype.kind not in "iuf":
        return f"the answer must be {kind(wanted)}, got {kind(answer)}"
    if value.shape != wanted.shape:
        turned = wanted.ndim == 2 and value.shape == wanted.shape[::-1]
        count = " rows of ".join(map(str, wanted.shape))  # "" for a number
        also = "is it transposed?" if turned else f"give {count or 'one'} number{'s' * bool(count)}"
        return f"the answer must have shape {wanted.shape}, got {value.shape}: {also}"
    return "" if np.isfinite(value).all() else "the answer must be finite"


def _close(value: np.ndarray, wanted: Any, rtol: float) -> bool:
    wanted = np.asarray(wanted, dtype=float)
    room = rtol * np.abs(wanted).max(initial=0.0)
    return value.shape == wanted.shape and bool(np.all(np.abs(value - wanted) <= room))
