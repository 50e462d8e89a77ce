"""Faults planted in outputs, kind by kind, and noise that is none.

    python tests/nbregress/planted.py [COUNT] [NOTEBOOK ...]

plants COUNT faults of each kind (default 20), and one in every number that the notebooks print,
and prints how many were caught. The test command plants a few.
"""

from __future__ import annotations

import base64
import copy
import io
import json
import math
import random
import re
import sys
import warnings
import wave
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.dates
import matplotlib.ticker
import numpy as np
from matplotlib.colors import LogNorm, PowerNorm, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.offsetbox import AnchoredText

from nbregress.comparison import Comparison
from nbregress.figures import figure_bundle
from nbregress.numbers import split_numbers
from nbregress.outputs import outputs_differences
from nbregress.settings import Settings
from nbregress.values import data_bundle

try:
    import pandas as pd
except ImportError:  # its kinds of faults are planted where it is
    pd = None

T = np.linspace(0.0, 10.0, 400)
Y, X = np.mgrid[-1:1:15j, -1:1:16j]
#: A kind of fault: from a random generator, the cell's output before and after.
Plant = Callable[[random.Random], tuple[Any, Any]]
FAULTS: dict[str, Plant] = {}
NOISE: dict[str, Plant] = {}


def differences(old: Any, new: Any) -> list[str]:
    """Compare two outputs of a cell: a text, a figure, an object, or a bundle by MIME type."""
    pair = [json.loads(json.dumps(outputs(value))) for value in (old, new)]
    return outputs_differences(*pair, Comparison(Settings()))


def outputs(value: Any) -> list[dict[str, Any]]:
    """The outputs of a cell that prints a text, or shows a figure or an object."""
    if isinstance(value, str):
        return [{"output_type": "stream", "name": "stdout", "text": value}]
    if isinstance(value, Figure):
        data = {**figure_bundle(value), "image/png": "AAAA", "text/plain": "<Figure>"}
    elif isinstance(value, dict) and any("/" in str(key) for key in value):
        data = value
    else:
        data = {**(data_bundle(value) or {}), "text/plain": repr(value)}
    return [{"output_type": "display_data", "data": data, "metadata": {}}]


def plant(table: dict[str, Plant], name: str) -> Callable[[Plant], Plant]:
    def enter(function: Plant) -> Plant:
        table[name] = function
        return function

    return enter


def texts(table: dict[str, Plant], name: str, old: str, new: str, *numbers: Any) -> None:
    """A kind of fault in a text, with random numbers in both of its forms."""

    def make(rng: random.Random) -> tuple[str, str]:
        values = [number(rng) for number in numbers]
        return old.format(*values), new.format(*values)

    table[name] = make


def axes(draw: Callable[..., Any], name: str, change: Callable[[random.Random], Any]) -> None:
    """A kind of fault in a figure: drawn without a change, and with one."""

    def make(rng: random.Random) -> tuple[Figure, Figure]:
        figures = Figure(), Figure()
        for figure, value in zip(figures, (None, change(rng)), strict=True):
            draw(figure.subplots(), value)
        return figures

    FAULTS[name] = make


def near(low: float, high: float) -> Callable[[random.Random], float]:
    return lambda rng: rng.uniform(low, high)


# ---- numbers ----


@plant(FAULTS, "a step of a short number")
def _(rng: random.Random) -> tuple[str, str]:
    places = rng.randint(1, 4)
    value = rng.randint(1, 9998)  # of more digits, a step may be within the tolerance
    shown = [f"gain = {v / 10**places:.{places}f} dB" for v in (value, value + 1)]
    return shown[0], shown[1]


@plant(FAULTS, "a step of a number with an exponent")
def _(rng: random.Random) -> tuple[str, str]:
    mantissa, power = rng.randint(10, 98), rng.randint(-20, 20)
    return f"{mantissa / 10:.1f}e{power:+03d}", f"{(mantissa + 1) / 10:.1f}e{power:+03d}"


@plant(FAULTS, "a small number of another size")
def _(rng: random.Random) -> tuple[str, str]:
    power = rng.randint(9, 300)
    return f"C = 4.7e-{power} F", f"C = {rng.uniform(4.71, 9.9):.2f}e-{power} F"


@plant(FAULTS, "the smaller part of a complex number")
def _(rng: random.Random) -> tuple[complex, complex]:
    size, small = 10 ** rng.uniform(0, 6), 10 ** rng.uniform(-3, 0)
    return np.array([size + small * 1j]), np.array([size + small * 1.1j])


@plant(FAULTS, "the smaller part of a printed complex number")
def _(rng: random.Random) -> tuple[str, str]:
    size, small = 10 ** rng.uniform(0, 6), 10 ** rng.uniform(-3, 0)
    return str(size + small * 1j), str(size + small * 1.1j)


@plant(FAULTS, "an entry of an array, beyond the printed digits")
def _(rng: random.Random) -> tuple[Any, Any]:
    values = np.array([rng.uniform(1, 2) for _ in range(rng.randint(2, 5000))])
    changed = values.copy()
    changed[rng.randrange(values.size)] *= 1.005
    return values, changed


@plant(FAULTS, "an entry of a short array")
def _(rng: random.Random) -> tuple[Any, Any]:
    values = np.array([10 ** rng.uniform(-6, 3) for _ in range(rng.randint(2, 60))])
    changed = values.copy()
    changed[rng.randrange(values.size)] *= 1 + 10 ** rng.uniform(-4, 0)
    return values, changed


@plant(FAULTS, "an entry of a printed array")
def _(rng: random.Random) -> tuple[str, str]:
    values = [rng.randint(1, 99) * 10.0 for _ in range(rng.randint(2, 12))]
    changed = list(values)
    changed[rng.randrange(len(values))] += 1.0
    return str(np.array(values)), str(np.array(changed))


@plant(FAULTS, "a list with an array in it")
def _(rng: random.Random) -> tuple[Any, Any]:
    value = rng.uniform(1, 2)
    return [np.array([value, 2.0]), 3.0], [np.array([value * 1.0005, 2.0]), 3.0]


def replaced(name: str, *pairs: tuple[float, float]) -> None:
    """A kind of fault: of one to three thousand numbers, one is another."""

    @plant(FAULTS, name)
    def _(rng: random.Random) -> tuple[Any, Any]:
        values = np.array([rng.uniform(-9, 9) for _ in range(rng.choice([1, 2, 30, 3000]))])
        changed, k = values.copy(), rng.randrange(values.size)
        old, new = rng.choice(pairs)
        values[k], changed[k] = (v if v else values[k] for v in (old, new))
        return values, changed


INF, NAN = math.inf, math.nan
replaced("no number in place of a number", (0, NAN), (NAN, 0), (0, INF), (-INF, 0))
replaced("sign of an infinity", (INF, -INF), (-INF, INF), (INF, NAN), (NAN, -INF))


@plant(FAULTS, "a mask")
def _(rng: random.Random) -> tuple[Any, Any]:
    values, size = rng.uniform(1, 2), rng.randint(3, 50)
    places = rng.sample(range(size), 2)
    return tuple(np.ma.array(np.full(size, values), mask=np.arange(size) == k) for k in places)


class Quantity(np.ndarray):
    """Numbers with a unit, as several packages have them."""

    unit = "m"

    def __repr__(self) -> str:
        return f"<Quantity {np.asarray(self)} {self.unit}>"


@plant(FAULTS, "a unit of an array")
def _(rng: random.Random) -> tuple[Any, Any]:
    pair = [np.full(rng.randint(1, 9), 1.5).view(Quantity)] * 2
    pair[1] = pair[0].copy()
    pair[1].unit = rng.choice(["km", "m/s", "s"])
    return pair[0], pair[1]


def frames(name: str, change: Callable[[Any], Any]) -> None:
    """A kind of fault in a data frame."""

    @plant(FAULTS, name)
    def _(rng: random.Random) -> tuple[Any, Any]:
        rows = rng.randint(2, 300)
        frame = pd.DataFrame(
            {"t": np.arange(rows) * rng.random(), "kind": rng.choices("ab", k=rows)}
        )
        return frame, change(frame.copy())


if pd is not None:
    frames("order of rows", lambda f: f.iloc[::-1])
    frames("name of an index", lambda f: f.rename_axis(index="k"))
    frames("name of the columns", lambda f: f.rename_axis(columns="signal"))
    frames("integers that become floats", lambda f: f.set_index(f.index * 1.0))
    frames("unused category", lambda f: f.astype({"kind": pd.CategoricalDtype(["a", "b", "c"])}))

texts(FAULTS, "a short version", '"{}.1"', '"{}.2"', lambda rng: rng.randint(0, 9))
texts(FAULTS, "a hash", "commit {}e{}345", "commit {}e{}346", *[lambda r: r.randint(10, 99)] * 2)
texts(FAULTS, "a sign", "x = {:.3f}", "x = -{:.3f}", near(0.1, 9))
texts(FAULTS, "a unit", "x = {:.3f} m", "x = {:.3f} mm", near(0.1, 9))
texts(FAULTS, "a word", "stable: {:.3f}", "unstable: {:.3f}", near(0.1, 9))
texts(
    FAULTS,
    "a date that is a result",
    "20{:02d}-03-01",
    "20{:02d}-03-02",
    lambda r: r.randint(0, 20),
)
texts(
    FAULTS, "an indentation", "if {}:\n    a\n    b", "if {}:\n    a\nb", lambda r: r.randint(1, 9)
)
texts(FAULTS, "an integer", "n = 1{}", "n = 2{}", lambda rng: rng.randint(0, 99))
texts(
    FAULTS,
    "another column",
    "name   low  high\na      {0:.2f}\nb      2.50  3.50\n",
    "name   low  high\na            {0:.2f}\nb      2.50  3.50\n",
    near(1, 9),
)
texts(
    FAULTS,
    "a duration that is a result",
    "settling time: {:.2f} s",
    "settling time: 1{:.2f} s",
    near(1, 9),
)

# ---- figures ----


def curve(ax: Any, change: Any, base: float = 0.0, size: float = 1.0) -> None:
    y = base + size * np.sin(T)
    if change is not None:
        y[change] += 0.01 * size
    ax.plot(T, y)


axes(curve, "one point of a curve", lambda rng: rng.randrange(400))
axes(lambda ax, c: curve(ax, c, 1e6), "on a large offset", lambda rng: rng.randrange(400))
axes(lambda ax, c: curve(ax, c, 101325.0, 0.4), "pressure", lambda rng: rng.randrange(400))


def long_curve(ax: Any, change: Any) -> None:
    y = np.sin(np.linspace(0, 30, 10_000))
    if change is not None:
        y[change] += 0.004  # 0.2 % of the range
    ax.plot(y)


axes(long_curve, "one point of ten thousand", lambda rng: rng.randrange(10_000))


def beside_an_outlier(ax: Any, change: Any) -> None:
    y = 1e-3 * np.sin(T)
    y[7] = 1e4
    if change is not None:
        y[change] += 1e-4
    ax.plot(T, y)
    ax.set_ylim(-2e-3, 2e-3)


axes(beside_an_outlier, "a small signal beside an outlier", lambda rng: rng.randrange(10, 400))


def dates(ax: Any, change: Any) -> None:
    days = np.datetime64("2024-03-01T00:00") + np.arange(30) * np.timedelta64(1, "D")
    ax.plot(days + np.timedelta64(0 if change is None else change, "h"), np.sin(np.arange(30)))


axes(dates, "hours on an axis of dates", lambda rng: rng.randint(1, 6))
axes(
    lambda ax, c: ax.contour(X, Y, (X if c is None else -X) + X**2 + Y**2 / 3),
    "mirrored contours",
    lambda rng: True,
)


def simple(name: str, draw: Callable[[Any, Any], Any], old: Any, *new: Any) -> None:
    """A fault for which a figure is drawn with one value, and with another."""
    axes(lambda ax, c: draw(ax, old if c is None else c), name, lambda rng: rng.choice(new))


simple("a table", lambda ax, v: ax.table([["a", v]]), "0.97", "0.96", "b")
simple("anchored text", lambda ax, v: ax.add_artist(AnchoredText(v, 1)), "n = 5", "n = 6")
simple("a title", lambda ax, v: ax.set_title(v), "R = 0.97", "R = 0.96", "R = 1.0")


def two_legends(ax: Any, label: str) -> None:
    (line,) = ax.plot([0, 1], label="a")
    ax.add_artist(ax.legend([line], [label], loc=1))
    ax.legend([line], ["second"], loc=2)


simple("a second legend", two_legends, "first", "1st", "none")
simple("scale of arrows", lambda ax, v: ax.quiver(X, Y, Y, X, scale_units="xy", scale=v), 5, 6, 9)


def key(ax: Any, value: tuple[float, str]) -> None:
    ax.quiverkey(ax.quiver(X, Y, Y, X), 0.5, 0.9, *value)


simple("key of arrows", key, (1.0, "1 m/s"), (2.0, "1 m/s"), (1.0, "2 m/s"))
simple("moved ticks", lambda ax, v: ax.set_xticks(v), [0, 0.5, 1], [0, 0.4, 1], [0, 1])
simple(
    "format of ticks",
    lambda ax, v: ax.yaxis.set_major_formatter(v),
    matplotlib.ticker.PercentFormatter(1.0),
    matplotlib.ticker.PercentFormatter(100.0),
    matplotlib.ticker.EngFormatter("V"),
    matplotlib.ticker.FormatStrFormatter("%.2f"),
)
simple("norm of an image", lambda ax, v: ax.imshow(1.5 + X, norm=v), None, LogNorm())
C1, C2 = ["r", "b", "b"], ["r", "r", "b"]
NORMS = TwoSlopeNorm(1.5, 0, 3), TwoSlopeNorm(1.6, 0, 3), PowerNorm(0.5), PowerNorm(0.7)
simple("shape of a norm", lambda ax, v: ax.imshow(1.5 + X, norm=v), *map(copy.copy, NORMS))


def symmetric(ax: Any, threshold: float) -> None:
    ax.plot(T, T - 5)
    ax.set_yscale("symlog", linthresh=threshold)


simple("threshold of a scale", symmetric, 1.0, 2.0, 0.1)


def crossed(ax: Any, order: int) -> None:
    lines = ax.plot(T, T) + ax.plot(T, -T) + ax.plot(T, T**2, "--")
    ax.legend(lines[::order], ["a", "b", "c"])


simple("legend of other lines", crossed, 1, -1)
simple("classes shown by colour", lambda ax, v: ax.scatter([0, 1, 2], [0, 1, 2], c=v), C1, C2)
simple("bars of one colour", lambda ax, v: ax.bar([0, 1, 2], [1, 2, 3], color=v), C1, C2)


def labelled(ax: Any, fmt: str) -> None:
    ax.clabel(ax.contour(X, Y, X * Y, levels=[-0.3, 0.3]), fmt=fmt)


simple("format of contour labels", labelled, "%1.1f", "%1.2f", "%1.1f m")


def note(ax: Any, arrow: bool) -> None:
    ax.annotate("here", (0, 0), (1, 1), arrowprops={"arrowstyle": "->"} if arrow else None)


simple("a removed arrow", note, True, False)


def band(ax: Any, label: str | None) -> None:
    ax.plot(T, np.sin(T), label="mean")
    ax.fill_between(T, np.sin(T) - 0.1, np.sin(T) + 0.1, label=label)
    ax.legend()


simple("a band in the legend", band, "95 %", "90 %", "_nothing")


@plant(FAULTS, "layout of subplots")
def _(rng: random.Random) -> tuple[Figure, Figure]:
    figures = Figure(), Figure()
    shapes = rng.choice([((2, 2), (1, 4)), ((1, 2), (2, 1)), ((3, 1), (1, 3))])
    for figure, shape in zip(figures, shapes, strict=True):
        for ax in np.ravel(figure.subplots(*shape)):
            ax.plot([0, 1])
    return figures


@plant(FAULTS, "direction and limits of a polar plot")
def _(rng: random.Random) -> tuple[Figure, Figure]:
    figures = Figure(), Figure()
    for number, figure in enumerate(figures):
        ax = figure.subplots(subplot_kw={"projection": "polar"})
        ax.plot(T, T)
        if number:
            change = rng.choice(["direction", "offset", "limit"])
            if change == "direction":
                ax.set_theta_direction(-1)
            elif change == "offset":
                ax.set_theta_offset(1.0)
            else:
                ax.set_rlim(0, 5)
    return figures


# ---- rich outputs ----


def number_in(name: str, mime: str, template: str) -> None:
    @plant(FAULTS, name)
    def _(rng: random.Random) -> tuple[Any, Any]:
        value = rng.randint(10, 98) / 100
        pair = [{mime: template.replace("@", f"{v:.2f}")} for v in (value, value + 0.01)]
        return pair[0], pair[1]


number_in("a cell of a table in HTML", "text/html", "<table><tr><td>a</td><td>@</td></tr></table>")
number_in("a number in LaTeX", "text/latex", r"$\frac{@}{s + 1}$")
number_in("a number in Markdown", "text/markdown", "*K* = @")
number_in("a chart in HTML", "text/html", '<script>draw({"id": "p1001", "y": [1.0, @]});</script>')
number_in("a path in SVG", "image/svg+xml", '<svg><path id="a1" d="M 1 2 L @ 3"/></svg>')
PLOTLY, VEGA = "application/vnd.plotly.v1+json", "application/vnd.vegalite.v5+json"
WIDGET = "application/vnd.nbregress.widget+json"


def tree(name: str, mime: str, make: Callable[[float], Any]) -> None:
    @plant(FAULTS, name)
    def _(rng: random.Random) -> tuple[Any, Any]:
        value = rng.uniform(0.1, 0.9)
        return {mime: make(value)}, {mime: make(value * 1.01)}


def encoded(value: float) -> dict[str, Any]:
    raw = np.array([1.0, value, 3.0]).tobytes()
    y = {"dtype": "f8", "bdata": base64.b64encode(raw).decode()}
    return {"data": [{"type": "scatter", "y": y, "uid": "x"}], "layout": {}}


tree("an array of plotly", PLOTLY, encoded)
tree("data of Vega", VEGA, lambda v: {"datasets": {"data-" + "a" * 32: [{"x": 1, "y": v}]}})
tree("a choice of a widget", WIDGET, lambda v: {"_options_labels": ["off", f"{v:.3f}"]})


def sound(values: Any) -> dict[str, str]:
    file = io.BytesIO()
    with wave.open(file, "wb") as out:
        out.setparams((1, 2, 8000, 0, "NONE", ""))
        out.writeframes((values * 30_000).astype("<i2").tobytes())
    data = base64.b64encode(file.getvalue()).decode()
    return {"text/html": f'<audio><source src="data:audio/wav;base64,{data}"/></audio>'}


@plant(FAULTS, "a sound")
def _(rng: random.Random) -> tuple[Any, Any]:
    pitch = rng.uniform(10, 90)
    return sound(np.sin(pitch * T)), sound(np.sin((pitch + rng.uniform(0.1, 5)) * T))


tree("a widget's value", WIDGET, lambda v: {"model": "FloatSliderModel", "value": v})


# ---- noise: what must pass ----


def last_digits(values: Any, rng: random.Random) -> Any:
    return values * (
        1 + 1e-15 * np.random.default_rng(rng.randrange(999)).standard_normal(values.shape)
    )


@plant(NOISE, "last digits of an array")
def _(rng: random.Random) -> tuple[Any, Any]:
    values = np.sin(np.arange(rng.randint(1, 3000)) + rng.random())
    return values, last_digits(values, rng)


@plant(NOISE, "rounding beside larger numbers")
def _(rng: random.Random) -> tuple[Any, Any]:
    pair = [np.array([1.0, rng.uniform(-4e-16, 4e-16), 2.0]) for _ in range(2)]
    return pair[0], pair[1]


@plant(NOISE, "rounding beside larger numbers, printed")
def _(rng: random.Random) -> tuple[str, str]:
    pair = [str([1.0, rng.uniform(-4e-16, 4e-16), 2.0]) for _ in range(2)]
    return pair[0], pair[1]


@plant(NOISE, "last digits of a curve")
def _(rng: random.Random) -> tuple[Figure, Figure]:
    figures, base = (Figure(), Figure()), rng.choice([0.0, 1.0, 1e6])
    for k, figure in enumerate(figures):
        y = base + np.sin(T)
        figure.subplots().plot(T, last_digits(y, rng) if k else y)
    return figures


texts(
    NOISE,
    "an address",
    "<A at 0x7f{}aa81c2d90>",
    "<A at 0x7f3aa81c2d91>",
    lambda r: r.randint(0, 9),
)
texts(
    NOISE, "a home folder", "/home/ann{}/x.csv", "/Users/bob/x.csv", lambda rng: rng.randint(0, 9)
)
texts(
    NOISE, "a process", "ipykernel_1{}/12.py:3", "ipykernel_2/3456.py:3", lambda r: r.randint(0, 9)
)
texts(NOISE, "a wall time", "Wall time: {:.2f} s", "Wall time: 12 µs", near(1, 9))
texts(
    NOISE,
    "a progress bar",
    "99%|#| 9/9 [00:0{}<00:00]",
    "99%|##| 9/9 [00:03<00:01, 3it/s]",
    lambda r: 5,
)
texts(NOISE, "an overwritten line", "{} %\rdone", "done", lambda rng: rng.randint(1, 99))


texts(
    NOISE,
    "a scalar of another NumPy",
    "[np.float64({0:.3f}), np.True_]",
    "[{0:.3f}, True]",
    near(1, 9),
)
texts(
    NOISE,
    "a progress bar of a notebook",
    "\u20073/3\u2007[00:00&lt;00:00,\u2007{:.2f}it/s]",
    "\u20073/3\u2007[00:01&lt;00:00,\u200735.83it/s]",
    near(1, 9),
)


@plant(NOISE, "rounding of a sound")
def _(rng: random.Random) -> tuple[Any, Any]:
    values = np.sin(rng.uniform(10, 90) * T)
    return sound(values), sound(last_digits(values, rng))


@plant(NOISE, "identifiers in HTML")
def _(rng: random.Random) -> tuple[Any, Any]:
    page = '<style>#T_{0}_row0 {{color: red}}</style><table id="T_{0}"><td id="T_{0}_row0">1.5</td>'
    pair = [{"text/html": page.format(f"{rng.randrange(16**5):05x}")} for _ in range(2)]
    return pair[0], pair[1]


def caught(table: dict[str, Plant], name: str, count: int, seed: int = 1) -> int:
    """How many of `count` differences of a kind are seen."""
    rng = random.Random(f"{seed} {name}")
    return sum(bool(differences(*table[name](rng))) for _ in range(count))


def steps_in_notebook(path: Path) -> tuple[int, int]:
    """Of the numbers that a notebook prints, how many a step of the last digit is seen in."""
    seen = count = 0
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        for number, output in enumerate(cell.get("outputs", ())):
            if output.get("output_type") != "stream":
                continue
            text = "".join(output["text"])
            for match in re.finditer(r"(?<![\w.])\d+\.\d{1,4}(?![\w.])", text):
                last = match.end() - 1
                digit = str((int(text[last]) + 1) % 10)
                changed = copy.deepcopy(cell["outputs"])
                changed[number]["text"] = text[:last] + digit + text[last + 1 :]
                if split_numbers(text)[1] == split_numbers(changed[number]["text"])[1]:
                    continue  # a version or a time: part of a word, which is compared
                count += 1
                seen += bool(outputs_differences(cell["outputs"], changed, Comparison(Settings())))
    return seen, count


def main(arguments: list[str]) -> None:
    warnings.simplefilter("ignore")
    count = int(arguments[0]) if arguments else 20
    total = 0
    for table, title in ((FAULTS, "faults caught"), (NOISE, "noise reported")):
        found = {name: caught(table, name, count) for name in table}
        for name, n in found.items():
            print(f"{n:4d} of {count}  {name}")
        total = sum(found.values())
        print(f"{title}: {total} of {count * len(found)} in {len(found)} kinds\n")
    results = [steps_in_notebook(Path(name)) for name in arguments[1:]]
    if results:
        print(
            f"steps of {sum(n for _, n in results)} numbers in {len(results)} notebooks: "
            f"{sum(n for n, _ in results)} caught"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
