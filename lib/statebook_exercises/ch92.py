"""Milestones of project 92: park a car in a bay that is too short for one go."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import statebook as sb
from statebook.grading.exercise import Exercise, Parameters, Rubric, Slip
from statebook_exercises.answers import Watched
from statebook_exercises.ch09 import BACK, FRONT, HALF_WIDTH, poses

CLOCK = 0.1  # [s]
LONG = 40.0  # a run on the bench [s]
SPEED = 1.0  # [m/s]
_FRAIL = "the error is not made up for"
PIECES = 12  # of a plan, at most
CLEAR = 0.1  # to everything [m]
TOUCH = 0.02  # nearer counts as touching, where the car is not what it should be [m]
KERB = 0.35  # beyond the car in its place [m]
# The car and the bay of the leaderboard, the same for all.
BENCH = Parameters(L=2.6, degrees=34.0, step=2.3, ahead=4.9, behind=0.7)


def _body(rng: np.random.Generator) -> dict[str, float]:
    low, high = [2.2, 0.6, 0.6, 1.6], [3.2, 1.1, 1.0, 2.0]
    names = ("L", "back", "front", "width")
    return dict(zip(names, rng.uniform(low, high).round(2).tolist(), strict=True))


def _corners(
    p: Parameters,
    middle: float = 0.0,
    wide: float = 0.5,
    turn: float = 1.0,
    overhang: float = 1.0,
) -> Callable[..., Any]:
    """Return the corners by pose; the arguments change a part."""

    def corners(x: Any, y: Any, theta: Any) -> np.ndarray:
        shift = middle * (p.L + p.front - p.back) / 2
        along = np.array([-p.back, p.L + p.front, p.L + p.front, -p.back]) * overhang - shift
        across = wide * p.width * np.array([-1, -1, 1, 1])
        c, s = np.cos(theta), turn * np.sin(theta)
        return np.stack([x + c * along - s * across, y + s * along + c * across])

    return corners


def _places(p: Parameters, rng: np.random.Generator) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in rng.uniform([-5, -5, -3], [5, 5, 3], size=(12, 3)).tolist()]


def _steered(rng: np.random.Generator) -> dict[str, float]:
    return {**_body(rng), "degrees": round(float(rng.uniform(29, 37)), 1)}


def _room(
    p: Parameters, side: float = 1.0, front: float = 1.0, at: Callable[[Any], Any] = np.tan
) -> float:
    """Where the car in front may begin, from the rear axle, for leaving in one turn [m]."""
    R, half = p.L / at(np.radians(p.degrees)), p.width / 2
    reach = np.hypot(R + side * half, p.L + front * p.front)
    return float(np.sqrt(reach**2 - (R - half) ** 2))


def _bay(rng: np.random.Generator) -> dict[str, float]:
    """A bay that is 0.15 to 0.3 m too short for one go."""
    L = round(float(rng.uniform(2.4, 2.9)), 2)
    p = Parameters(L=L, degrees=round(float(rng.uniform(32, 36)), 1))
    p.front, p.width = FRONT, 2 * HALF_WIDTH
    short = float(rng.uniform(0.15, 0.3))
    return {
        "L": L,
        "degrees": p.degrees,
        "step": round(float(rng.uniform(2.2, 2.5)), 2),
        "ahead": round(_room(p) - short, 2),
        "behind": 0.65,
    }


def _boxes(p: Parameters) -> np.ndarray:
    """The cars in front and behind, and the kerb, as (x, y) from and to."""
    side = [-p.step - HALF_WIDTH, -p.step + HALF_WIDTH]
    length = BACK + p.L + FRONT
    rear = -BACK - p.behind
    edge = -p.step - HALF_WIDTH - KERB
    return np.array(
        [
            [[p.ahead, p.ahead + length], side],
            [[rear - length, rear], side],
            [[rear - length, p.ahead + length], [edge - 0.5, edge]],
        ]
    )


def clearance(placed: np.ndarray, p: Parameters) -> np.ndarray:
    """Return the distance from the body to what stands around, at poses (3, N); 0 inside."""
    along, across = np.linspace(-BACK, p.L + FRONT, 41), np.linspace(-HALF_WIDTH, HALF_WIDTH, 19)
    sides = [np.stack([along, 0 * along + y]) for y in (-HALF_WIDTH, HALF_WIDTH)]
    ends = [np.stack([0 * across + x, across]) for x in (-BACK, p.L + FRONT)]
    body = np.concatenate(sides + ends, axis=1)[:, :, None]
    c, s = np.cos(placed[2]), np.sin(placed[2])
    points = np.stack([c * body[0] - s * body[1], s * body[0] + c * body[1]])
    points = points + placed[:2, None]
    least = np.full(placed.shape[1], np.inf)
    for box in _boxes(p):
        low, high = box[:, 0, None, None], box[:, 1, None, None]
        outside = np.maximum(np.maximum(low - points, points - high), 0.0)
        least = np.minimum(least, np.hypot(*outside).min(axis=0))
        # and from the box's corners to the body
        x, y = (v.reshape(4, 1) for v in np.meshgrid(box[0], box[1]))
        x, y = x - placed[0], y - placed[1]
        ahead = np.maximum(-BACK - (c * x + s * y), c * x + s * y - p.L - FRONT)
        beside = np.abs(c * y - s * x) - HALF_WIDTH
        corner = np.hypot(np.maximum(ahead, 0), np.maximum(beside, 0))
        least = np.minimum(least, corner.min(axis=0))
    return least


def parking(p: Parameters, reserve: float = 0.5, clear: float = CLEAR + 0.01) -> np.ndarray:
    """Return a plan as pieces (distance, steering), found by leaving the bay.

    Forward with the wheels to the left and back with them to the right, each until something is
    near, until an arc to the left and one to the right lead out.
    """
    phi = np.radians(p.degrees - reserve)
    R = p.L / np.tan(phi)
    out: list[tuple[float, float]] = []
    start = Parameters(**vars(p))

    def free(pieces: Sequence[tuple[float, float]]) -> bool:
        placed = poses(np.array(pieces), start)
        placed[1] -= p.step
        return bool(clearance(placed, p).min() >= clear)

    for k in range(PIECES - 3):
        place = np.array([0.0, -p.step, 0.0])
        if out:
            place = poses(np.array(out), start)[:, -1] - [0.0, p.step, 0.0]
        turned = np.arccos((np.cos(place[2]) + 1 + place[1] / R) / 2)
        rest = [(R * (turned - place[2]), phi), (R * turned, -phi)]
        if k % 2 == 0 and free([*out, *rest]):
            pieces = [*out, *rest]
            end = poses(np.array(pieces), start)[0, -1]
            back = [(-distance, angle) for distance, angle in reversed(pieces)]
            return np.array([(end, 0.0), *back, *[(0.0, 0.0)] * (PIECES - len(back) - 1)])
        side = 1 if k % 2 == 0 else -1
        lengths = np.arange(0.05, 2.0, 0.05)
        fits = [d for d in lengths if free([*out, (side * d, side * phi)])]
        out.append((side * float(max(fits, default=0.0)), side * phi))
    raise ValueError("no plan of this kind leads out of the bay")


def _ends(place: np.ndarray, p: Parameters, near: float, turned: float) -> str:
    """Return how far the car is from its place, where that is too far."""
    x, y, theta = place
    theta = float(sb.wrap_angle(theta))
    if np.hypot(x, y + p.step) <= near and abs(theta) <= np.radians(turned):
        return ""
    return (
        f"the car ends at x = {x:.2f} m, y = {y:.2f} m, turned by {np.degrees(theta):.1f} degrees;"
        f" its place is (0, {-p.step:g}, 0), to {near:g} m and {turned:g} degrees"
    )


def _nears(placed: np.ndarray, p: Parameters, clear: float) -> str:
    least = clearance(placed, p)
    x, y, _ = placed[:, int(np.argmin(least))]
    if least.min() >= clear:
        return ""
    return (
        f"it comes to {max(least.min(), 0):.2f} m from a car or the kerb, with the rear axle at"
        f" ({x:.2f}, {y:.2f}); {clear:g} m are asked for"
    )


def _judge_plan(answer: Any, p: Parameters) -> str:
    pieces = np.asarray(answer, dtype=float)
    most = float(np.degrees(np.abs(pieces[:, 1]).max()))
    if most > p.degrees + 1e-6:
        return f"the wheels turn by {most:.3g} degrees, and the limit is {p.degrees:g} degrees"
    driven = float(np.abs(pieces[:, 0]).sum())
    if driven > 60:
        return f"{driven:.3g} m of driving: 60 m are allowed"
    placed = poses(pieces, p)
    return _ends(placed[:, -1], p, 0.05, 2.0) or _nears(placed, p, CLEAR)


def follow(
    p: Parameters, plan: np.ndarray, gain: float = 1.0, v: float = 0.9
) -> Callable[..., Any]:
    """Return a policy that drives a plan and corrects what it sees of the errors."""
    spent = np.cumsum(np.abs(plan[:, 0])) / v
    joints = [poses(plan[: k + 1], p)[:, -1] for k in range(len(plan))]

    def policy(x: np.ndarray, t: float) -> np.ndarray:
        k = int(np.searchsorted(spent, t, side="right"))
        if k < len(plan):
            sign, phi = np.sign(plan[k, 0]), plan[k, 1]
            left = (spent[k] - t) * v * sign
            turned = joints[k][2] - left * np.tan(phi) / p.L
            half = -left * np.tan(phi) / p.L / 2
            chord, mean = -left * np.sinc(half / np.pi), joints[k][2] + half
            place = joints[k][:2] + chord * np.array([np.cos(mean), np.sin(mean)])
        else:
            sign, phi, place, turned = 0.0, 0.0, joints[-1][:2], joints[-1][2]
        c, s = np.cos(turned), np.sin(turned)
        ahead, beside = np.array([[c, s], [-s, c]]) @ (x[:2] - place)
        bend = np.tan(phi) / p.L - gain * (beside + 2 * sign * (x[2] - turned))
        most = np.radians(p.degrees)
        speed = np.clip(sign * v - gain * ahead, -SPEED, SPEED)
        return np.array([speed, np.clip(np.arctan(p.L * bend), -most, most)])

    return policy


def _errors(rng: np.random.Generator) -> dict[str, float]:
    """Errors of the steering's zero [degrees], of the wheelbase [%] and of the start [m]."""
    names = ("steering_error", "wheelbase_error", "start_error")
    drawn = rng.uniform([0.6, 1.0, 0.05], [1.0, 2.0, 0.1]).round(2).tolist()
    return dict(zip(names, drawn, strict=True))


def _run(law: Watched, L: float, offset: float, start: Sequence[float]) -> sb.Trajectory:
    zero = np.array([0.0, offset])
    return sb.simulate_clocked(
        sb.DubinsCar(L),
        start,
        lambda x, t: law(x, t) + zero,
        period=CLOCK,
        duration=LONG,
        samples=2,
        method="rk4",
    )


def _parked(run: sb.Trajectory) -> float:
    """Time from which on the car stands in its place [s]."""
    x, y, theta = run.states - run.states[:, -1:]
    moves = (np.hypot(x, y) > 0.01) | (np.abs(theta) > 0.005)
    return float(run.times[np.flatnonzero(moves)[-1] + 1]) if moves.any() else 0.0


def _rubric(answer: Any, p: Parameters) -> Rubric:
    law = Watched(answer, [SPEED, np.radians(BENCH.degrees)])
    run = _run(law, BENCH.L, 0.0, [0.0, 0.0, 0.0])
    others = []
    for zero, base in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        offset, L = zero * p.steering_error, BENCH.L * (1 + base * p.wheelbase_error / 100)
        start = [base * p.start_error, zero * p.start_error / 2, 0.0]
        tried = _run(law, L, np.radians(offset), start).states
        name = f"so too with the wheels {offset:+.2f} degrees off and a wheelbase of {L:.3f} m"
        trouble = _ends(tried[:, -1], BENCH, 0.12, 3.0) or _nears(tried, BENCH, TOUCH)
        others.append((1, name, trouble and f"{_FRAIL}: {trouble}"))
    away = _ends(run.states[:, -1], BENCH, 0.05, 2.0)
    limits = law.excess("m/s or rad")
    idle = away and "that counts where the car is parked"
    rows = (
        (3, f"after {LONG:g} s the car is in its place", away),
        (1, f"speed and steering keep {SPEED:g} m/s, {BENCH.degrees:g} degrees", limits or idle),
        (2, f"it stays {CLEAR:g} m from everything", _nears(run.states, BENCH, CLEAR) or idle),
        *others,
    )
    way = np.hypot(*np.diff(run.states[:2])).sum()
    spare = clearance(run.states, BENCH).min()
    return Rubric(rows, f"{_parked(run):.1f} s, {way:.1f} m driven, {spare:.2f} m clear")


def _reference(p: Parameters, **changed: float) -> Callable[..., Any]:
    return follow(BENCH, parking(BENCH, 2.0, 0.15), **changed)


def _faster(p: Parameters) -> Callable[..., Any]:
    law = _reference(p)
    return lambda x, t: law(x, t) * [2.0, 1.0]


EXERCISES = (
    Exercise(
        "92.1",
        "Where the corners are",
        "project",
        30,
        _body,
        _corners,
        (
            Slip(
                "the pose is that of the rear axle, not of the body's middle",
                lambda p: _corners(p, middle=1.0),
            ),
            Slip(
                "the axle is in the middle of the width: half of it to each side",
                lambda p: _corners(p, wide=1.0),
            ),
            Slip(
                "theta counts counter-clockwise: which corner goes up in a turn to the left?",
                lambda p: _corners(p, turn=-1.0),
            ),
            Slip("left and right are exchanged", lambda p: _corners(p, wide=-0.5)),
        ),
        points=2,
        inputs=_places,
    ),
    Exercise(
        "92.2",
        "Out in one turn",
        "project",
        60,
        _steered,
        _room,
        (
            Slip(
                "that is room to stand, none to turn: the outer front corner is farther from the"
                " centre than the axle, by half the width",
                lambda p: _room(p, side=-1.0),
            ),
            Slip("the body does not end at the front axle", lambda p: _room(p, front=0.0)),
            Slip(
                "L / sin(phi) is the front wheel's circle; the centre lies beside the rear axle",
                lambda p: _room(p, at=np.sin),
            ),
            Slip(
                "that counts from the front of the car; asked is from the rear axle",
                lambda p: _room(p) - p.L - p.front,
            ),
        ),
        points=2,
    ),
    Exercise(
        "92.3",
        "A plan for your bay",
        "project",
        150,
        _bay,
        parking,
        (
            Slip("the car ends at", lambda p: np.zeros((PIECES, 2))),
            Slip("the wheels turn by", lambda p: parking(p) * [1.0, 1.2]),
            Slip("from a car or the kerb", lambda p: parking(p, clear=0.04)),
            Slip("60 m are allowed", lambda p: np.full((PIECES, 2), [9.0, 0.0])),
        ),
        points=4,
        judge=_judge_plan,
    ),
    Exercise(
        "92.4",
        "Drive it, with errors",
        "project",
        180,
        _errors,
        _reference,
        (
            Slip("the car ends at x = 0.00 m, y = 0.00 m", lambda p: lambda x, t: [0.0, 0.0]),
            Slip("it asks for", _faster),
            Slip("from a car or the kerb", lambda p: follow(BENCH, parking(BENCH, 2.0, 0.03))),
            Slip(_FRAIL, lambda p: _reference(p, gain=0.0)),
        ),
        points=10,
        judge=_rubric,
    ),
)
