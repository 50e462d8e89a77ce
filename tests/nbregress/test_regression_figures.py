"""Figures: compared by their data, not by their picture."""

import base64
import copy
import io
import json

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch
from PIL import Image

from nbregress.comparison import Comparison
from nbregress.figures import digest
from nbregress.pictures import pictures_difference
from nbregress.settings import Settings
from nbregress.summary import difference, summarize
from nbregress.trees import figures_differences
from nbregress.values import array_digest, data_bundle

T = np.linspace(0.0, 10.0, 1000)
SINE, COSINE, ROOT = np.sin(T), np.cos(T), np.sqrt(T)
Y, X = np.mgrid[-1:1:20j, -1:1:21j]
PRODUCT = X * Y


def draw(
    *,
    curve=SINE,
    other=COSINE,
    label="sine",
    title="Energy",
    xlabel="t [s]",
    yscale="linear",
    xlim=None,
    extra=False,
    legend=True,
    text="start",
    spot=(0.3, 0.2),
    bars=(1.0, 2.0, 3.0),
    names=("a", "b", "c"),
    field=X,
    values=PRODUCT,
    levels=(-0.3, 0.1, 0.4),
    segment=(1.0, 0.5),
    scatter=ROOT,
    radius=0.5,
    upper=SINE,
    arrow=(0.5, 0.6),
    **style,
):
    """A figure with most kinds of artists; the rest of the arguments is style alone."""
    figure = Figure(**style.get("figure", {}))
    axes = figure.subplots(2, 4)
    ax = axes[0, 0]
    ax.plot(T, curve, label=label, **style.get("line", {}))
    ax.plot(T, other, label="cosine", **style.get("line", {}))
    if extra:
        ax.plot(T, T)
    ax.set(title=title, xlabel=xlabel, yscale=yscale)
    if xlim:
        ax.set_xlim(xlim)
    if legend:
        ax.legend(loc=style.get("loc", "best"))
    ax.text(1.0, 0.5, text, **style.get("font", {}))
    ax.annotate("here", spot, (1.0, 1.0), arrowprops={"arrowstyle": "->"})
    axes[0, 1].bar(names, bars, **style.get("patch", {}))
    axes[0, 1].axhline(1.5, linestyle="--")
    axes[0, 2].quiver(X, Y, Y, field)
    axes[0, 2].streamplot(X[0], Y[:, 0], Y, -X, density=0.4)
    mesh = axes[0, 3].pcolormesh(X, Y, values, **style.get("mesh", {}))
    figure.colorbar(mesh, label="height")
    axes[1, 0].contour(X, Y, X * Y, levels=levels)
    axes[1, 0].vlines([0.0, 1.0], 0.0, segment)
    axes[1, 1].scatter(T, scatter, **style.get("marker", {}))
    axes[1, 1].imshow(values)
    axes[1, 2].add_patch(Circle((0.0, 0.0), radius))
    axes[1, 2].add_patch(FancyArrowPatch((0.0, 0.0), arrow))
    axes[1, 3].fill_between(T, 0.0, upper, alpha=style.get("alpha", 1.0))
    return digest(figure)


def compare(stored, new, **tolerance):
    # Through JSON, as in a notebook file.
    stored, new = (json.loads(json.dumps(item)) for item in (stored, new))
    return figures_differences(stored, new, Comparison(Settings(**tolerance)), "figure")


def off_by_one_per_cent(values, index):
    changed = values.copy()
    changed[index] *= 1.01
    return changed


@pytest.fixture(scope="module")
def base():
    return draw()


NOISE = 1.0 + 1e-13 * np.random.default_rng(0).standard_normal(T.size)

SAME = {
    "nothing changed": {},
    "last-digit noise": {"curve": np.sin(T) * NOISE, "other": np.cos(T) + 1e-15},
    "noise in a mesh": {"values": X * Y * (1.0 + 1e-14)},
    "colour and width": {"line": {"color": "black", "linewidth": 3.0, "alpha": 0.5}},
    "size and resolution": {"figure": {"figsize": (12, 3), "dpi": 30}},
    "layout": {"figure": {"layout": "constrained"}},
    "font": {"font": {"fontsize": 20, "family": "serif", "color": "red"}},
    "place of the legend": {"loc": "lower left"},
    "colour of bars": {"patch": {"color": "grey", "hatch": "/"}},
    "colour map": {"mesh": {"cmap": "gray"}},
    "marker colour": {"marker": {"color": "red"}},
    "transparency": {"alpha": 0.3},
}

DIFFERENT = {
    "one point": ({"curve": off_by_one_per_cent(np.sin(T), 437)}, "'sine', y: point 438 of 1000"),
    "swapped curves": ({"curve": np.cos(T), "other": np.sin(T)}, "line 1 'sine', y"),
    "two swapped points": ({"curve": np.sin(np.where(T == T[3], T[4], T))}, "'sine', y"),
    "phase": ({"curve": np.sin(T + 1e-3)}, "'sine', y"),
    "sign": ({"curve": -np.sin(T)}, "'sine', y"),
    "another length": ({"scatter": np.sqrt(T) * np.where(T < 5, 1, np.nan)}, "points 1, y: gaps"),
    "label of a curve": ({"label": "sinus"}, "line 1 'sinus', label"),
    "title": ({"title": "Power"}, "title: 'Power', stored 'Energy'"),
    "axis label": ({"xlabel": "t [ms]"}, "axes 1 'Energy', x, label: 't [ms]', stored 't [s]'"),
    "scale": ({"yscale": "symlog"}, "has a new scale: 'symlog'"),
    "limits": ({"xlim": (0.0, 5.0)}, "x: has a new limits: '0 5'"),
    "additional line": ({"extra": True}, "shows line 1 'sine', line 2 'cosine', line 3"),
    "no legend": ({"legend": False}, "has no legend"),
    "text": ({"text": "end"}, "'end', stored 'start'"),
    "place of a text": ({"spot": (0.3, 0.3)}, "text 2, to y"),
    "bar": ({"bars": (1.0, 2.0, 3.1)}, "rectangles 1, height: point 3 of 3"),
    "category": ({"names": ("a", "b", "d")}, "x, ticks 3: 'd', stored 'c'"),
    "arrows of a field": ({"field": -X}, "arrows 1, v"),
    "mesh": ({"values": off_by_one_per_cent(X * Y, (3, 4))}, "mesh 1, values: point 68 of 420"),
    "levels": ({"levels": (-0.3, 0.1, 0.5)}, "contours 1, levels: point 3 of 3: 0.5, stored 0.4"),
    "segment": ({"segment": (1.0, 0.6)}, "segments 1, y"),
    "scattered point": ({"scatter": off_by_one_per_cent(np.sqrt(T), 500)}, "points 1, y: point"),
    "circle": ({"radius": 0.55}, "ellipses 1, width"),
    "arrow": ({"arrow": (0.5, 0.7)}, "arrows 1, to y"),
    "area": ({"upper": SINE + 0.1}, "area 1, y"),
}


@pytest.mark.parametrize("change", SAME.values(), ids=SAME)
def test_agree(base, change):
    assert compare(base, draw(**change)) == []


@pytest.mark.parametrize(("change", "message"), DIFFERENT.values(), ids=DIFFERENT)
def test_differ(base, change, message):
    messages = compare(base, draw(**change))
    assert any(message in m for m in messages), messages


def test_every_single_point_counts():
    values = 2.0 + np.sin(3.0 * T)
    stored = summarize(values)
    for index in range(T.size):
        message = difference(
            stored, summarize(off_by_one_per_cent(values, index)), rtol=1e-5, atol=1e-12
        )
        assert message and f"point {index + 1} of 1000" in message


@pytest.mark.parametrize("level", [3e-10, 2e-5, 3.0])
def test_a_line_that_is_flat_but_for_rounding_of_what_is_beside_it(level):
    """A voltage of 2e-5 is a difference of sixties: their last digits are no range."""
    noise = np.random.default_rng(1).choice([-7e-15, 0.0, 7e-15], size=(2, 1000))
    stored, new = (summarize(level + row, beside=110.0) for row in noise)
    assert not difference(stored, new, rtol=1e-5, atol=0.0)
    assert not difference(summarize(level + noise[0]), new, rtol=1e-5, atol=0.0)
    for step in (1e-6, level + 1e-6):
        moved = summarize(step + level + noise[1], beside=110.0)
        assert difference(stored, moved, rtol=1e-9, atol=0.0)
    moved = level + noise[1]
    moved[137] += 1e-4
    assert difference(stored, summarize(moved, beside=110.0), rtol=1e-5, atol=0.0)


def test_a_change_within_the_tolerance_is_none():
    stored, new = summarize(np.sin(T)), summarize(np.sin(T) * 1.0003)
    assert difference(stored, new, rtol=1e-5, atol=1e-12)
    assert not difference(stored, new, rtol=1e-3, atol=1e-12)


@pytest.mark.parametrize(
    ("stored", "new"),
    [
        (T, T[:-1]),
        (T, np.where(T > 9.0, np.nan, T)),
        ([1.0, np.nan], [np.nan, 1.0]),
        ([1.0, np.inf], [1.0, -np.inf]),
        (T[:12], T[:13]),
        ([], [0.0]),
        (T, T[::-1]),
        (np.zeros(100), np.ones(100)),
    ],
)
def test_summaries_differ(stored, new):
    assert difference(summarize(stored), summarize(new), rtol=1e-5, atol=1e-12)
    assert difference(summarize(new), summarize(stored), rtol=1e-5, atol=1e-12)
    assert not difference(summarize(stored), summarize(stored), rtol=0.0, atol=0.0)


def test_logarithmic_axes_compare_decades():
    def figure(values):
        ax = (figure := Figure()).subplots()
        ax.loglog(T[1:], values)
        return digest(figure)

    errors = T[1:] ** -4
    small = errors.copy()
    small[900] *= 1.02  # invisible next to the largest error on a linear axis
    assert compare(figure(errors), figure(errors * (1.0 + 1e-12))) == []
    assert any("y: point 901 of 999" in m for m in compare(figure(errors), figure(small)))
    # Rounding noise at the foot of a convergence plot.
    noise = np.where(T[1:] > 9.0, 3e-16, errors)
    assert compare(figure(noise), figure(np.where(noise < 1e-12, 7e-17, noise))) == []


def test_many_unlabelled_lines_are_taken_together():
    def figure(change=0.0):
        ax = (figure := Figure()).subplots()
        for k in range(40):
            ax.plot(T[:100], np.sin(T[:100] + k) + (change if k == 23 else 0.0))
        return digest(figure)

    assert len(json.dumps(figure())) < 1500
    assert compare(figure(), figure(1e-3))


def test_three_dimensional_axes():
    def figure(height=1.0, scale=1.0):
        ax = (figure := Figure()).add_subplot(projection="3d")
        ax.plot(T, np.sin(T), scale * np.cos(T))
        ax.plot_surface(X, Y, height * X * Y)
        ax.scatter([0.0], [0.0], [height])
        return digest(figure)

    assert compare(figure(), figure()) == []
    assert any("line 1, z" in m for m in compare(figure(), figure(scale=1.1)))
    assert any("solid" in m for m in compare(figure(), figure(height=1.1)))


def test_places_of_contour_labels_do_not_count():
    def figure(width, values=PRODUCT):
        ax = (figure := Figure(figsize=(width, 3))).subplots()
        ax.clabel(ax.contour(X, Y, values, levels=[-0.3, 0.1, 0.4]))
        return digest(figure)

    assert compare(figure(3), figure(12)) == []
    assert any("contours 1, lengths" in m for m in compare(figure(3), figure(3, 1.1 * PRODUCT)))


def test_other_kinds_of_figures():
    figure = Figure()
    top, bottom = figure.subfigures(2)
    top.suptitle("top")
    top.subplots(subplot_kw={"projection": "polar"}).plot(T, T)
    ax = bottom.subplots()
    ax.axline((0.0, 0.0), slope=1.0)
    ax.twinx().step(T, T)
    ax.inset_axes((0.5, 0.5, 0.4, 0.4)).hist(np.sin(T), histtype="step")
    ax.barbs(X, Y, X, Y)
    ax.hexbin(T, T, gridsize=5)
    ax.errorbar([1.0], [1.0], [0.1])
    ax.pie([1.0, 2.0])
    ax.plot(np.array(["2024-01-01", "2024-01-02"], dtype="datetime64[D]"), [1.0, 2.0])
    first = digest(figure)
    assert compare(first, digest(figure)) == []
    changed = copy.deepcopy(first)
    changed["subfigures"][0]["title"] = "bottom"
    assert compare(first, changed)


def test_missing_axes():
    one, two = Figure(), Figure()
    one.subplots()
    two.subplots(1, 2)
    assert compare(digest(one), digest(two)) == ["figure: shows axes 1, axes 2; stored axes 1"]


def test_the_digest_does_not_depend_on_having_been_drawn(tmp_path):
    figure = Figure(layout="constrained")
    ax = figure.subplots()
    ax.plot(T, np.sin(T), label="sine")
    ax.legend()
    figure.suptitle("title")
    before = digest(figure)
    figure.savefig(tmp_path / "figure.png")
    assert compare(before, digest(figure)) == []


def test_a_typical_digest_is_small(base):
    assert len(json.dumps(base)) < 8000, matplotlib.__version__


def test_the_same_numbers_written_in_another_way_do_not_differ():
    assert difference("0 0", "0.0 -0", rtol=1e-5, atol=0.0) is None
    assert difference("0 0", "0 1e-300", rtol=1e-5, atol=0.0)


def test_the_narrower_of_two_views_decides():
    near, far = "~0.5 0 10.0055", "~0.6 0 10"
    for stored, new in ((near, far), (far, near)):
        assert difference(stored, new, rtol=1e-2, atol=0.0)
        assert difference(stored, new, rtol=1.2e-2, atol=0.0) is None


def test_a_hundred_complex_numbers_are_written_out():
    values = np.exp(1j * np.arange(100.0))
    (text,) = array_digest(values)["data"].values()
    parts = np.array(text.split(), dtype=float)
    np.testing.assert_allclose(parts[::2] + 1j * parts[1::2], values, atol=1e-7)
    (text,) = array_digest(np.append(values, 1.0))["data"].values()
    assert text.startswith("202 | ")


class Labels(list):
    """What a data frame and pandas' index are to a digest, where pandas is not installed."""

    dtype, name = np.dtype(object), None
    names = property(lambda self: [self.name])


def series(values):
    def to_frame(self):
        return frame([values])

    members = {"__module__": "pandas", "ndim": 1, "iloc": None, "to_frame": to_frame}
    return type("Series", (), members)()


def frame(columns):
    array = np.stack(columns, axis=1)
    members = {"__module__": "pandas", "ndim": 2, "iloc": array, "shape": array.shape}
    labels = {"index": Labels(range(len(array))), "columns": Labels(range(array.shape[1]))}
    return type("DataFrame", (), {**members, **labels})()


def test_every_column_of_a_data_frame_is_kept():
    rows = np.arange(5.0), np.arange(5.0) ** 2, -np.arange(5.0)
    (digest,) = data_bundle(frame(rows)).values()
    assert digest["type"] == "DataFrame" and digest["names"] == ["0", "1", "2"]
    assert digest["columns"] == [array_digest(row) for row in rows]
    (digest,) = data_bundle(series(rows[1])).values()
    assert digest["type"] == "Series" and digest["columns"] == [array_digest(rows[1])]


def png(pixels):
    file = io.BytesIO()
    Image.fromarray(pixels.astype(np.uint8)).save(file, format="png")
    return base64.b64encode(file.getvalue()).decode()


@pytest.mark.parametrize(
    ("share", "levels", "seen"),
    [(1.0, 1, True), (0.1, 1, False), (0.1, 20, True), (0.001, 30, True), (0.0002, 200, False)],
)
def test_how_much_a_picture_may_change(share, levels, seen):
    """Half a level on the average, and one pixel in 2000 by more than 24 of 255."""
    picture = np.full((100, 100, 3), 40)
    changed = picture.reshape(-1, 3).copy()
    changed[: round(share * len(changed))] += levels
    message = pictures_difference(png(picture), png(changed.reshape(picture.shape)))
    assert bool(message) == seen


@pytest.mark.parametrize("turn", [1e-17, -1e-16, 1e-3])
def test_a_box_turned_by_rounding_is_a_box(turn):
    def boxes(angle):
        figure = Figure()
        ax = figure.subplots()
        for width in (1.0, 2.0):
            across = np.array([[-1, 2, 2, -1], [-0.3, -0.3, 0.3, 0.3]]) * width + 0.1 * angle
            c, s = np.cos(angle), np.sin(angle)
            ax.fill(*(np.array([[c, -s], [s, c]]) @ across + 3 * angle))
        return digest(figure)

    assert bool(compare(boxes(0.0), boxes(turn))) == (turn == 1e-3)
