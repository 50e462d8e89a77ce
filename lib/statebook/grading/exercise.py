"""An exercise: its parameters for each student, its right answer, and the usual slips."""

import importlib
import importlib.util
import unicodedata
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Integral
from types import SimpleNamespace
from typing import Any

import numpy as np

LEVELS = ("read off", "compute", "derive", "debug", "design", "play", "project")

Parameters = SimpleNamespace


@dataclass(frozen=True)
class Slip:
    """A wrong answer that many give.

    Attributes
    ----------
    hint : str
        What to think about; it does not give the answer away.
    answer : callable
        answer(p), what the slip makes of the parameters p.
    """

    hint: str
    answer: Callable[[Parameters], Any]


@dataclass(frozen=True)
class Rubric:
    """What an answer earns, row by row, and the numbers to compare it by.

    Attributes
    ----------
    rows : tuple of (int, str, str)
        Points, what is asked, and what is wrong with it, or nothing.
    score : str
        Shown where nothing is wrong.
    """

    rows: tuple[tuple[int, str, str], ...]
    score: str

    @property
    def points(self) -> int:
        """Sum of the rows in which nothing is wrong."""
        return sum(points for points, _, trouble in self.rows if not trouble)

    def __str__(self) -> str:
        lines = [
            f"  {0 if trouble else points} of {points}  {asked}{trouble and f': {trouble}'}"
            for points, asked, trouble in self.rows
        ]
        whole = all(not trouble for _, _, trouble in self.rows)
        return "\n".join(lines + [f"  leaderboard: {self.score}"] * whole)


@dataclass(frozen=True)
class Exercise:
    """What a checker knows of one exercise.

    Attributes
    ----------
    id : str
        Chapter and number, as "07.2".
    title : str
    level : {"read off", "compute", "derive", "debug", "design", "play", "project"}
    minutes, points : int
    draw : callable
        draw(rng) returns a student's parameters by name, numbers that can be typed.
    solution : callable
        solution(p), the right answer.
    slips : tuple of Slip
    rtol : float
        Relative tolerance of numbers, against the largest entry of an array.
    inputs : callable, optional
        inputs(p, rng), tuples of arguments at which a function that is the answer is compared
        with the solution.
    judge : callable, optional
        judge(answer, p) returns what is wrong, or nothing: instead of a comparison with the
        solution, where many answers are right. It gets finite numbers in the solution's shape,
        or a function whose every call runs in a process of its own; the judge bounds such
        values before it simulates with them. Of a function it may return a `Rubric`, whose
        points add up to those of the exercise.
    """

    id: str
    title: str
    level: str
    minutes: int
    draw: Callable[[np.random.Generator], Mapping[str, Any]]
    solution: Callable[[Parameters], Any]
    slips: tuple[Slip, ...] = ()
    points: int = 1
    rtol: float = 1e-3
    inputs: Callable[[Parameters, np.random.Generator], list[tuple[Any, ...]]] | None = None
    judge: Callable[[Any, Parameters], str | Rubric] | None = None

    def parameters(self, student: str | int) -> Parameters:
        """Return a student's parameters: the same for the same name or number, anywhere."""
        return Parameters(**self.draw(self.rng(student)))

    def rng(self, student: str | int) -> np.random.Generator:
        """Return the random numbers of a student in this exercise."""
        # Python's hash differs from run to run; a name counts however it is typed.
        name = unicodedata.normalize("NFKC", " ".join(str(student).split()).casefold())
        code = zlib.crc32(name.encode(errors="backslashreplace"))
        return np.random.default_rng([code, zlib.crc32(self.id.encode())])


def find_exercise(id: str) -> Exercise:
    """Return the exercise of an id, as "07.2".

    Raises
    ------
    TypeError, ValueError
        id is no text, or there is no such exercise; the message lists those of its chapter.
    """
    if not isinstance(id, str):
        raise TypeError(f'id must be a text such as "07.2", got {id!r}')
    chapter = id.partition(".")[0]
    module = f"statebook_exercises.ch{chapter}"
    if not chapter.isdigit() or importlib.util.find_spec(module) is None:
        raise ValueError(f'id must name an exercise, such as "07.2", got {id!r}')
    exercises = {e.id: e for e in importlib.import_module(module).EXERCISES}
    if id not in exercises:
        raise ValueError(f"chapter {chapter} has the exercises {', '.join(exercises)}, got {id!r}")
    return exercises[id]


def exercise(id: str, student: str | int) -> Parameters:
    """Your parameters of an exercise.

    Parameters
    ----------
    id : str
        Chapter and number.
    student : str or int
        Your name or number: another one has other parameters.

    Returns
    -------
    types.SimpleNamespace
        Each parameter is an attribute.

    Raises
    ------
    TypeError, ValueError
        There is no such exercise, or student is empty.

    Examples
    --------
    >>> exercise("07.2", "Ada").L == exercise("07.2", " ada ").L != exercise("07.2", "Bob").L
    True
    """
    return find_exercise(id).parameters(student_named(student))


def student_named(student: Any) -> str | int:
    """Check a student's name or number."""
    named = isinstance(student, str | Integral) and not isinstance(student, bool)
    if not named or not str(student).strip():
        raise TypeError(f"student must be your name or number, got {student!r}")
    return student if isinstance(student, str) else int(student)
