"""Figures that a reader moves: sliders over frames that are drawn once, and films."""

import base64
import gzip
import hashlib
import html
import io
import itertools
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from statebook import _validate
from statebook.times import increasing

MOST_FRAMES = 40
MOST_OF_TWO = 7  # values of each of two parameters
_SIZE = (4.8, 3.2)  # inches; its letters are legible on a phone
_STILL_DPI = 110


@dataclass(frozen=True, eq=False)
class Player:
    """Frames of a figure with a slider for each parameter, which works offline.

    Attributes
    ----------
    axes : tuple of (str, tuple of str)
        Each parameter's name and its values as they are shown.
    frames : tuple of str
        SVG of each frame, the last parameter running fastest.
    start : tuple of int
        Where each slider stands at first.
    caption, alt : str
        The line below, and what a reader who does not see it is told.
    seconds : float or None
        A film's duration; None without a button to play it.
    failures : tuple of str
        The values at which no frame could be drawn, and why.
    """

    axes: tuple[tuple[str, tuple[str, ...]], ...]
    frames: tuple[str, ...] = field(repr=False)
    start: tuple[int, ...]
    caption: str
    alt: str
    seconds: float | None = None
    failures: tuple[str, ...] = ()
    still: bytes = field(default=b"", repr=False)
    digests: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        ranges = [f"{name} {values[0]} to {values[-1]}" for name, values in self.axes]
        return "\n".join([f"{len(self.frames)} frames: {', '.join(ranges)}", *self.failures])

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, Any]:
        return {"text/html": self.to_html(), "text/plain": repr(self), **self.digests}

    def to_html(self) -> str:
        """Return the player as one piece of HTML that loads nothing.

        Without its script, as in a notebook that is not trusted, it is a captioned still.
        """
        parts, runs = _shared([frame.splitlines() for frame in self.frames])
        axes = [{"name": name, "values": values} for name, values in self.axes]
        data: dict[str, Any] = {"parts": parts, "frames": runs, "axes": axes}
        data |= {"start": self.start, "seconds": self.seconds}
        plain = json.dumps(data, separators=(",", ":")).encode()
        packed = base64.b64encode(gzip.compress(plain, mtime=0)).decode()
        name = "sb-" + hashlib.sha256(plain).hexdigest()[:12]
        picture = base64.b64encode(self.still).decode()
        return (
            f'<figure class="sb-player" id="{name}"><style>{_asset("player.css")}</style>'
            f'<div class="sb-stage"><img alt="{html.escape(self.alt)}"'
            f' src="data:image/png;base64,{picture}"></div>'
            f"<figcaption>{html.escape(self.caption)}</figcaption>"
            f'<script>{_asset("player.js")}(document.getElementById("{name}"),"{packed}");</script>'
            "</figure>"
        )


def explore(
    draw: Callable[..., Any],
    *,
    caption: str,
    alt: str,
    start: Mapping[str, Any] | None = None,
    **values: Sequence[Any],
) -> Player:
    """Let a reader move the parameters of a figure.

    Every frame is drawn once, so the sliders work in JupyterLab and on a static page alike.

    Parameters
    ----------
    draw : callable
        Draws one figure of Matplotlib with pyplot; called with one keyword a parameter.
    caption : str
        A line below the figure.
    alt : str
        What is to be seen, in words.
    start : mapping, optional
        The value of each parameter at which its slider stands at first; else the middle one.
    **values : sequence
        One parameter with at most 40 values, or two with at most 7 each.

    Returns
    -------
    Player
        A frame that could not be drawn says for which values, and why.

    Raises
    ------
    TypeError, ValueError
        There is no parameter, there are too many values, a start is not among them, or not one
        frame could be drawn.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> def wave(frequency):
    ...     t = np.linspace(0, 1, 50)
    ...     plt.plot(t, np.sin(2 * np.pi * frequency * t))
    >>> explore(wave, frequency=[1, 2, 3], caption="A sine.", alt="A sine wave.")
    3 frames: frequency 1 to 3
    """
    if not callable(draw):
        raise TypeError(f"draw must be a function that draws a figure, got {draw!r}")
    if len(values) not in (1, 2):
        raise ValueError(f"give one or two parameters with their values, got {len(values)}")
    lists = {name: list(sequence) for name, sequence in values.items()}
    most = MOST_FRAMES if len(lists) == 1 else MOST_OF_TWO
    for name, sequence in lists.items():
        if not 2 <= len(sequence) <= most:
            raise ValueError(f"{name} must have 2 to {most} values, got {len(sequence)}")
    strange = [name for name in start or {} if name not in lists]
    if strange:
        raise ValueError(f"start must name parameters among {', '.join(lists)}, got {strange[0]}")
    places = []
    for name, sequence in lists.items():
        value = (start or {}).get(name, sequence[len(sequence) // 2])
        if value not in sequence:
            raise ValueError(f"start must be among the values of {name}, got {value!r}")
        places.append(sequence.index(value))
    for text, content in (("caption", caption), ("alt", alt)):
        if not isinstance(content, str) or not content.strip():
            raise ValueError(f"{text} must say what the figure shows, got {content!r}")
    points = [dict(zip(lists, point, strict=True)) for point in itertools.product(*lists.values())]
    first = int(np.ravel_multi_index(places, [len(sequence) for sequence in lists.values()]))
    layouts: _Layouts = {}
    drawn = [
        _drawn(draw, point, layouts, still=number == first) for number, point in enumerate(points)
    ]
    failures = tuple(frame.failure for frame in drawn if frame.failure)
    if len(failures) == len(drawn):
        raise ValueError(f"draw must draw at least one frame; {failures[0]}")
    whole = next(frame for frame in drawn if not frame.failure)
    axes = tuple((name, tuple(map(_shown, sequence))) for name, sequence in lists.items())
    frames = tuple(frame.svg for frame in drawn)
    still = drawn[first].png or _drawn(draw, points[drawn.index(whole)], layouts, still=True).png
    kinds = {kind: [frame.digests.get(kind, {}) for frame in drawn] for kind in whole.digests}
    digests = {kind: {"frames": found} for kind, found in kinds.items()}
    return Player(axes, frames, tuple(places), caption, alt, None, failures, still, digests)


def film(
    draw: Callable[[float], Any],
    times: Any,
    *,
    caption: str,
    alt: str,
    seconds: float | None = None,
) -> Player:
    """Let a reader play a motion, or drag it to and fro.

    Parameters
    ----------
    draw : callable
        draw(t) draws the figure at one time, with pyplot.
    times : array, shape (K,), increasing [s]
        At most 40 of them.
    caption, alt : str
        As in explore.
    seconds : float > 0, optional
        How long the film takes; that of the motion if omitted.

    Returns
    -------
    Player

    Raises
    ------
    TypeError, ValueError
        As explore.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> def grow(t):
    ...     plt.plot([0, t], [0, t])
    >>> film(grow, [0.0, 0.5, 1.0], caption="Upwards.", alt="A line grows.")
    3 frames: time [s] 0 to 1
    """
    instants = increasing("times", times, minimum=2)
    length = instants[-1] - instants[0]
    seconds = _validate.positive("seconds", length if seconds is None else seconds)
    player = explore(lambda t: draw(t), caption=caption, alt=alt, t=instants.tolist())
    named = (("time [s]", player.axes[0][1]),)
    return replace(player, axes=named, seconds=seconds)


@dataclass(frozen=True, eq=False)
class _Frame:
    svg: str
    digests: Mapping[str, Any] = field(default_factory=dict)
    failure: str = ""
    png: bytes = b""


_Layouts = dict[tuple[Any, ...], list[Any]]


def _drawn(
    draw: Callable[..., Any], point: Mapping[str, Any], layouts: _Layouts, *, still: bool
) -> _Frame:
    """Draw one frame; a frame that fails says so."""
    import matplotlib.pyplot as plt
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    options: Any = {"figure.figsize": _SIZE, "svg.hashsalt": "statebook", "svg.fonttype": "path"}
    with plt.ioff(), plt.rc_context(options):
        before = set(plt.get_fignums())
        try:
            plt.figure()  # or draw would paint over a figure that is open
            draw(**point)
            figure = plt.gcf()
            words = _words(figure)
            if words in layouts:
                figure.set_layout_engine("none")
                for ax, place in zip(figure.axes, layouts[words], strict=True):
                    ax.set_position(place)
            file, picture = io.StringIO(), io.BytesIO()
            dpi, canvas = figure.dpi, FigureCanvasSVG(figure)
            undated: Any = {"Date": None, "Creator": None}
            canvas.print_svg(file, metadata=undated)  # type: ignore[no-untyped-call]
            figure.dpi = dpi
            layouts.setdefault(words, [ax.get_position(original=True) for ax in figure.axes])
            if still:
                figure.savefig(picture, format="png", dpi=_STILL_DPI, metadata={"Software": None})
            return _Frame(_slim(file.getvalue()), _digests(figure), png=picture.getvalue())
        except Exception as error:
            state = ", ".join(f"{name} = {_shown(value)}" for name, value in point.items())
            message = f"no figure at {state}: {type(error).__name__}: {error}"
            return _Frame(f"<p>{html.escape(message)}</p>", failure=message)
        finally:
            for number in set(plt.get_fignums()) - before:
                plt.close(number)


def _words(figure: Any) -> tuple[Any, ...]:
    """What decides where a figure's axes lie: frames that share it share their layout."""
    words = []
    for ax in figure.axes:
        labels = [text.get_text() for text in (ax.title, ax.xaxis.label, ax.yaxis.label)]
        widest = max((len(tick.get_text()) for tick in ax.get_yticklabels()), default=0)
        words.append((*(label and label.count("\n") for label in labels), widest))
    return tuple(words)


def _digests(figure: Any) -> dict[str, Any]:
    """What the notebook's extensions add to a figure, such as a digest of its data."""
    try:
        from IPython import get_ipython
    except ImportError:
        return {}
    formatter = getattr(get_ipython(), "display_formatter", None)
    found = formatter.mimebundle_formatter(figure) if formatter is not None else None
    return dict(found[0] if isinstance(found, tuple) else found or {})


def _slim(svg: str) -> str:
    """The drawing alone, with coordinates to a tenth of a point."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>\s*", "", svg, flags=re.DOTALL)
    # Not what scales: letters are drawn 64 times too large.
    places = r'(?: d="| x="| y="|translate\()[^")]*'
    svg = re.sub(places, lambda found: re.sub(r"-?\d+\.\d{2,}", _tenths, found[0]), svg)
    return re.sub(r'(<svg[^>]*?) (?:width|height)="[^"]*"', r"\1", svg, count=1)


def _tenths(number: re.Match[str]) -> str:
    return f"{float(number[0]):.1f}"


def _shared(frames: list[list[str]]) -> tuple[list[str], list[list[int]]]:
    """Lines that occur in any frame once, and each frame as runs (first, how many) of them."""
    number: dict[str, int] = {}
    runs = []
    for lines in frames:
        run: list[int] = []
        for line in lines:
            k = number.setdefault(line, len(number))
            if run and run[-2] + run[-1] == k:
                run[-1] += 1
            else:
                run += [k, 1]
        runs.append(run)
    return list(number), runs


def _shown(value: Any) -> str:
    """A value as a slider's label shows it."""
    return f"{value:.4g}" if isinstance(value, float | np.floating) else str(value)


@cache
def _asset(name: str) -> str:
    return files("statebook.plotting").joinpath(name).read_text(encoding="utf-8").strip()
