"""Figures with sliders: every frame is there, says what it is, and loads nothing."""

from __future__ import annotations

import base64
import gzip
import json
import re

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import statebook as sb
from statebook.plotting import Player, explore, film

WORDS = {"caption": "Figure 1. A sine.", "alt": "a sine wave & its <zeros>"}


@pytest.fixture(autouse=True)
def no_window():
    plt.switch_backend("agg")
    plt.close("all")  # others may have left some open
    yield
    assert plt.get_fignums() == []


def sine(frequency):
    t = np.linspace(0, 1, 40)
    plt.subplots()[1].plot(t, np.sin(2 * np.pi * frequency * t))


def unpacked(page: str) -> dict:
    """Return the data of a player's script."""
    return json.loads(
        gzip.decompress(base64.b64decode(re.search(r'"([\w+/=]{60,})"\);<', page)[1]))
    )


def frames_of(data: dict) -> list[str]:
    """Put the frames together as the script does."""
    return [
        "\n".join(
            line for k in range(0, len(runs), 2) for line in data["parts"][runs[k] :][: runs[k + 1]]
        )
        for runs in data["frames"]
    ]


def test_the_page_holds_every_frame():
    player = explore(sine, frequency=[1, 2, 3], **WORDS)
    data = unpacked(player.to_html())
    assert frames_of(data) == [frame.rstrip("\n") for frame in player.frames]
    assert len(set(player.frames)) == 3
    assert data["axes"] == [{"name": "frequency", "values": ["1", "2", "3"]}]
    assert data["start"] == [1]


@settings(deadline=None, max_examples=60)
@given(st.lists(st.lists(st.sampled_from("abcdefg"), min_size=1, max_size=9), min_size=1))
def test_any_frames_come_out_as_they_went_in(lines):
    frames = tuple(map("\n".join, lines))
    axes = (("x", tuple(map(str, range(len(frames))))),)
    data = unpacked(Player(axes, frames, (0,), "A caption.", "What is seen.").to_html())
    assert frames_of(data) == [*frames]
    assert len(data["parts"]) == len({line for frame in lines for line in frame})


def test_a_frame_shows_the_data_of_its_value():
    sizes = [1.0, 2.0]
    player = explore(lambda a: plt.plot([0, 1], [0, a]) and plt.ylim(0, 2), a=sizes, **WORDS)
    heights = []
    for frame in player.frames:
        lines = re.findall(r'd="M [\d.]+ ([\d.]+)\s+L [\d.]+ ([\d.]+)\s*" clip-path', frame)
        below, above = map(float, lines[-1])  # after the grid's
        heights.append(below - above)
    assert heights[1] == pytest.approx(2 * heights[0], abs=0.3)


def test_two_parameters_run_as_the_script_counts():
    seen = []

    def draw(a, b):
        seen.append((a, b))
        sine(a * b)

    player = explore(draw, a=[1, 2], b=[1, 2, 3], start={"b": 3}, **WORDS)
    assert seen == [(1, 1), (1, 2), (1, 3), (2, 1), (2, 2), (2, 3)]
    assert player.start == (1, 2)
    assert repr(player) == "6 frames: a 1 to 2, b 1 to 3"


def test_letters_keep_their_scale():
    frame = explore(sine, frequency=[1, 2], **WORDS).frames[0]
    scales = {float(x) for pair in re.findall(r"scale\(([^)]*)\)", frame) for x in pair.split()}
    assert scales
    assert min(map(abs, scales)) > 1e-3


def test_loads_nothing_and_is_a_captioned_still_without_its_script():
    page = explore(sine, frequency=range(40), **WORDS).to_html()
    still = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)
    assert 'src="data:image/png;base64,iVBOR' in still
    assert "a sine wave &amp; its &lt;zeros&gt;" in still
    assert "Figure 1. A sine." in still
    assert not re.search(r"(?:src|href)=.(?!data:|#)|@import|fetch\(|url\((?!#)", page)
    assert len(page) < 200_000


def test_the_same_player_comes_out_twice():
    pages = [explore(sine, frequency=[1, 2], **WORDS).to_html() for _ in range(2)]
    assert pages[0] == pages[1]


def test_a_frame_that_fails_says_for_which_value_and_the_others_are_shown():
    player = explore(lambda n: sine(1 / n), n=[0, 1, 2], start={"n": 0}, **WORDS)
    assert player.failures == ("no figure at n = 0: ZeroDivisionError: division by zero",)
    assert player.frames[0] == f"<p>{player.failures[0]}</p>"
    assert player.frames[1].startswith("<svg")
    assert player.still.startswith(b"\x89PNG")
    assert player.failures[0] in repr(player)


def test_what_extensions_add_to_figures_is_collected_frame_by_frame(monkeypatch):
    class Shell:
        class events:  # pyplot may hang on a shell that was here before
            register = unregister = staticmethod(lambda name, function: None)

        class display_formatter:
            @staticmethod
            def mimebundle_formatter(figure):
                return {"application/x-data": list(figure.axes[0].lines[0].get_ydata()[:1])}, {}

    monkeypatch.setattr("IPython.get_ipython", Shell)
    player = explore(lambda a: plt.plot([a, a]), a=[3.0, 4.0], **WORDS)
    bundle = player._repr_mimebundle_()
    assert bundle["application/x-data"] == {"frames": [[3.0], [4.0]]}
    assert set(bundle) == {"application/x-data", "text/html", "text/plain"}


def test_film_plays_as_long_as_its_motion():
    player = film(sine, [1.0, 2.0, 4.0], **WORDS)
    assert player.seconds == 3.0
    assert unpacked(player.to_html())["seconds"] == 3.0
    assert film(sine, [1.0, 2.0], seconds=0.5, **WORDS).seconds == 0.5
    assert explore(sine, frequency=[1, 2], **WORDS).seconds is None


def test_a_figure_that_is_open_is_not_painted_over():
    axes = plt.subplots()[1]
    explore(lambda a: plt.plot([0, a]), a=[1, 2], **WORDS)
    assert not axes.lines
    plt.close("all")


def test_figures_that_were_open_stay_open():
    mine = plt.figure()
    explore(sine, frequency=[1, 2], **WORDS)
    assert plt.get_fignums() == [mine.number]
    plt.close(mine)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"draw": None, "a": [1, 2]}, TypeError, "draw must be a function"),
        ({}, ValueError, "one or two parameters with their values, got 0"),
        ({"a": [1, 2], "b": [1, 2], "c": [1, 2]}, ValueError, "got 3"),
        ({"a": [1]}, ValueError, "a must have 2 to 40 values, got 1"),
        ({"a": range(41)}, ValueError, "2 to 40 values, got 41"),
        ({"a": range(8), "b": [1, 2]}, ValueError, "a must have 2 to 7 values, got 8"),
        (
            {"a": [1, 2], "start": {"a": 3}},
            ValueError,
            "start must be among the values of a, got 3",
        ),
        ({"a": [1, 2], "start": {"b": 1}}, ValueError, "start must name parameters among a, got b"),
        ({"a": [1, 2], "caption": " "}, ValueError, "caption must say what the figure shows"),
        ({"a": [1, 2], "alt": None}, ValueError, "alt must say what the figure shows"),
        ({"draw": lambda a: 1 / 0, "a": [1, 2]}, ValueError, "at least one frame; no figure at a"),
    ],
)
def test_bad_input(arguments, error, words):
    with pytest.raises(error, match=words):
        explore(**{"draw": sine, **WORDS, **arguments})


@pytest.mark.parametrize("times", [[], [1.0], [2.0, 1.0]])
def test_bad_times(times):
    with pytest.raises(ValueError, match=r"times must (hold at least 2|increase)"):
        film(sine, times, **WORDS)


def test_is_public():
    assert sb.plotting.explore is explore


def test_axes_stay_where_they_are_unless_a_label_needs_more_room():
    axes = []

    def draw(top):
        with plt.rc_context({"figure.constrained_layout.use": True}):
            axes.append(plt.subplots()[1])
        axes[-1].set(ylim=(0, top), title=f"{top} m", ylabel="height [m]")
        axes[-1].set_yticks([0, top], ["0", str(top)])

    explore(draw, top=[1, 2, 1_000_000], **WORDS)
    left = [ax.get_position(original=True).x0 for ax in axes]
    assert left[0] == left[1]
    assert left[2] > left[0] + 0.05
    alone = explore(draw, top=[1_000_000, 2_000_000], **WORDS)
    assert alone.frames[0] != alone.frames[1]
    assert axes[-2].get_position(original=True).x0 == pytest.approx(left[2], abs=1e-3)
