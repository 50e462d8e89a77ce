"""Two texts compared: the same words, each number within a tolerance of itself."""

import math
import os
import re

from nbregress.numbers import Number, split_numbers
from nbregress.settings import Settings

# Rounding leaves this much of the largest number beside it.
RESIDUE = 1000 * 2.0**-52
_SHOWN = 5
_CUT = 200


def text_difference(
    stored: str, new: str, settings: Settings, *, beside: float = 0.0
) -> str | None:
    """What differs between two texts, or None.

    Words, integers, dates, versions and identifiers must be the same. A number with a
    point or an exponent may differ by ``rtol`` times itself, plus ``atol``; within the
    brackets of an array, and in a complex number, also by what rounding leaves of the
    largest number there. Arrays may wrap lines differently.

    Parameters
    ----------
    stored, new : str
    settings : Settings
        Its ``rtol`` and ``atol``.
    beside : float >= 0
        The largest number of the array that the texts are a part of.

    Returns
    -------
    message : str or None

    Examples
    --------
    >>> text_difference("x = 0.33333333", "x = 0.33333334", Settings())
    >>> text_difference("K = 0.97", "K = 0.96", Settings())
    'line 1: 0.96, stored 0.97 (difference 0.01, allowed 9.7e-06)'
    """
    if stored == new:
        return None
    old_words, old_numbers = split_numbers(stored)
    new_words, new_numbers = split_numbers(new)
    if plain_spaces(old_words) != plain_spaces(new_words):
        return _words_difference(stored, new)
    messages = []
    scales = _scales(old_words, old_numbers, new_numbers, beside)
    for a, b, scale in zip(old_numbers, new_numbers, scales, strict=True):
        size = max(abs(n.value) if n.value == n.value else 0.0 for n in (a, b))
        allowed = settings.atol + settings.rtol * size + RESIDUE * scale
        if not _same(a, b, allowed):
            messages.append(_number_message(a, b, allowed))
    if not messages:
        return _places_difference(stored, new)
    more = f"\n... and {len(messages) - _SHOWN} more numbers" if len(messages) > _SHOWN else ""
    return "\n".join(messages[:_SHOWN]) + more


def cut(text: str, size: int = _CUT) -> str:
    """A text short enough for a message.

    Parameters
    ----------
    text : str
    size : int

    Returns
    -------
    text : str
        Its beginning, if it is longer.
    """
    return text if len(text) <= size else f"{text[: size - 20]}... ({len(text)} characters)"


def _same(a: Number, b: Number, allowed: float) -> bool:
    if a.integer and b.integer:
        return a.text.lstrip("+") == b.text.lstrip("+")
    if math.isnan(a.value) or math.isnan(b.value):
        return math.isnan(a.value) and math.isnan(b.value)
    if a.value == b.value:
        return a.integer == b.integer
    return abs(a.value - b.value) <= allowed and math.isfinite(allowed)


def _number_message(a: Number, b: Number, allowed: float) -> str:
    head = f"line {b.line}: {cut(b.text, 60)}, stored {cut(a.text, 60)}"
    if a.integer and b.integer:
        return f"{head} (integers are exact)"
    if a.value == b.value:
        return f"{head} (an integer in one, not in the other)"
    distance = abs(a.value - b.value)
    return f"{head} (difference {distance:.3g}, allowed {allowed:.2g})"


def _words_difference(stored: str, new: str) -> str:
    old_lines, new_lines = stored.splitlines(), new.splitlines()
    for number, (old, line) in enumerate(zip(old_lines, new_lines, strict=False), start=1):
        if old != line and plain_spaces(split_numbers(old)[0]) != plain_spaces(
            split_numbers(line)[0]
        ):
            start = max(len(os.path.commonprefix([old, line])) - 40, 0)  # noqa: RUF071
            start = start if max(len(old), len(line)) > _CUT else 0
            return f"line {number}: {cut(line[start:])!r}\n  stored {cut(old[start:])!r}"
    common = min(len(old_lines), len(new_lines))
    extra = (new_lines[common:] or old_lines[common:] or ["(the end of the line)"])[0]
    count = f"{len(new_lines)} lines, stored {len(old_lines)}"
    return f"{count}; from line {common + 1}: {cut(extra)!r}"


def plain_spaces(words: list[str]) -> list[str]:
    """Words without the spaces that only align numbers, or wrap an array.

    Within brackets every white space is one space, none next to a bracket; elsewhere line
    ends stay. Spaces next to a number go.

    Parameters
    ----------
    words : list of str
        What stands around the numbers of a text.

    Returns
    -------
    plain : list of str
    """
    depth = 0
    plain = []
    for index, word in enumerate(words):
        out: list[str] = []
        for piece in re.split(r"([\[\](){}])", word):
            if piece in ("(", "["):
                depth += 1
            elif piece in (")", "]"):
                depth = max(depth - 1, 0)
            elif depth:
                piece = re.sub(r"\s+", " ", piece)
            out.append(piece)
        text = re.sub(r" {2,}", " ", "".join(out))
        text = re.sub(r"([(\[]) ", r"\1", re.sub(r" (?=[)\]\n]|$)", "", text))
        text = re.sub(r" ?, ", ", ", text)
        if index > 0:
            text = text.lstrip(" ")
        plain.append(text)
    return plain


def _scales(words: list[str], old: list[Number], new: list[Number], beside: float) -> list[float]:
    """For each number, the largest one of the array or the complex number it is part of."""
    both = list(zip(old, new, strict=True))
    sizes = [
        max((abs(n.value) for n in pair if math.isfinite(n.value)), default=0.0) for pair in both
    ]
    scales = [beside] * len(sizes)
    for k in range(1, len(sizes)):
        # 1.2-0.3j: two numbers with nothing between them and a j behind.
        if words[k] == "" and words[k + 1].startswith("j"):
            scales[k - 1] = scales[k] = max(beside, math.hypot(sizes[k - 1], sizes[k]))
    depth, members = 0, list[int]()
    for k, word in enumerate(words):
        for bracket in re.findall(r"[\[\]]", word):
            depth = max(depth + (1 if bracket == "[" else -1), 0)
            if depth == 0:
                largest = max((sizes[m] for m in members), default=0.0)
                for m in members:
                    scales[m] = max(scales[m], largest)
                members = []
        if depth and k < len(sizes):
            members.append(k)
    return scales


def _places_difference(stored: str, new: str) -> str | None:
    """A value in another column of a table, or a line of words with another indentation."""
    old_lines, new_lines = stored.splitlines(), new.splitlines()
    if len(old_lines) != len(new_lines):
        return None  # an array that wraps differently
    depth = 0
    for number, (old, line) in enumerate(zip(old_lines, new_lines, strict=True), start=1):
        words = not depth and re.match(r" *[^\W\d]", line) and not re.search(r"\S {2,}\S", line)
        if words and len(old) - len(old.lstrip()) != len(line) - len(line.lstrip()):
            return f"line {number} has another indentation: {cut(line)!r}\n  stored {cut(old)!r}"
        depth = max(depth + line.count("[") - line.count("]"), 0)
    for start, end in _blocks(old_lines):
        was, now = _columns(old_lines[start:end]), _columns(new_lines[start:end])
        widest = max(map(len, was))
        for k, (a, b) in enumerate(zip(was, now, strict=True)):
            if len(a) == len(b) and len(a) < widest and a != b:
                place = f"line {start + k + 1} has a value in another column"
                line, old = new_lines[start + k], old_lines[start + k]
                return f"{place}: {cut(line)!r}\n  stored {cut(old)!r}"
    return None


def _blocks(lines: list[str]) -> list[tuple[int, int]]:
    """First and last line of each table: lines with gaps, without a blank one between."""
    blocks, start = [], 0
    for k in range(len(lines) + 1):
        if k == len(lines) or not lines[k].strip():
            if k - start > 1 and any(re.search(r"\S {2,}\S", line) for line in lines[start:k]):
                blocks.append((start, k))
            start = k + 1
    return blocks


def _columns(lines: list[str]) -> list[list[int]]:
    """For each line of a table, the numbers of the columns that its values stand in."""
    taken = [False] * max(map(len, lines))
    for line in lines:
        for match in re.finditer(r"\S+", line):
            taken[match.start() : match.end()] = [True] * len(match[0])
    column, numbers = -1, []
    for k, filled in enumerate(taken):
        column += filled and not (k and taken[k - 1])
        numbers.append(column)
    return [[numbers[m.start()] for m in re.finditer(r"\S+", line)] for line in lines]
