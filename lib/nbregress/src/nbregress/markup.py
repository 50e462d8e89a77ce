"""HTML and SVG compared: elements in order, tables by cells, scripts by their JSON."""

import html.parser
import json
import re
from typing import Any, NamedTuple

from nbregress.comparison import Comparison
from nbregress.pictures import pictures_difference
from nbregress.textdiff import cut
from nbregress.trees import json_differences

_PICTURE = re.compile(r"data:(?:image/[\w+.-]+|audio/(?:x-)?wav);base64,([\w+/=\\\s]+)")
_FILM = re.compile(r"data:(?:video|audio|font|application)/[\w+.;=-]+;base64,[\w+/=\\\s]+")
_ID = re.compile(r"""\b(?:id|data-root-id|for|name)=\\?["']([^"'\\]+)\\?["']""")
_WORD = re.compile(r"[A-Za-z_][\w-]*|[0-9a-f]{8}-[\w-]{27}")
_HEX = re.compile(r"[0-9a-f]{32}|[0-9a-f]{8}-(?:[0-9a-f]{4}-){3}[0-9a-f]{12}")
_SVG_NOISE = re.compile(
    r"<!--.*?-->|<\?xml[^>]*>|<!DOCTYPE[^>]*>|<metadata>.*?</metadata>|<dc:date>.*?</dc:date>",
    re.DOTALL,
)
_INLINE = ("sup", "sub")
_LITERAL = re.compile(r"[\[{](?=\s*[\"{\[])")
_SCRIPTS = ("script", "style")


class _Piece(NamedTuple):
    kind: str  # "tag", "text" or the name of an element with code in it
    value: str
    row: int = 0
    column: int = 0
    table: int = 0


class _Reader(html.parser.HTMLParser):
    """The pieces of a page in order, with their places in tables."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.pieces: list[_Piece] = []
        self.table = self.row = self.column = 0
        self.code = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in _INLINE:
            self.handle_data(f"<{tag}>")
            return
        if tag == "table":
            self.table, self.row = self.table + 1, 0
        elif tag == "tr":
            self.row, self.column = self.row + 1, 0
        elif tag in ("td", "th"):
            self.column += 1
        self.code = tag if tag in _SCRIPTS else ""
        text = " ".join(f'{name}="{value or ""}"' for name, value in sorted(attrs))
        self.pieces.append(_Piece("tag", f"<{tag} {text}>"))

    def handle_endtag(self, tag: str) -> None:
        self.code = ""
        if tag in _INLINE:
            self.handle_data(f"</{tag}>")

    def handle_data(self, data: str) -> None:
        if not data.strip():
            return
        place = (self.row, self.column, self.table)
        last = self.pieces[-1] if self.pieces else None
        if last is not None and last.kind == "text" and last[2:] == place and not self.code:
            self.pieces[-1] = last._replace(value=last.value + data)
        else:
            self.pieces.append(_Piece(self.code or "text", data, *place))


def html_differences(name: str, stored: str, new: str, comparison: Comparison) -> list[str]:
    """What differs between two pieces of HTML, one message each.

    Identifiers are compared by the order of their appearance, pictures by their pixels,
    JSON within scripts as data, and text by its words and numbers.

    Parameters
    ----------
    name : str
    stored, new : str
    comparison : Comparison

    Returns
    -------
    messages : list of str

    Examples
    --------
    >>> from nbregress.settings import Settings
    >>> old, new = (f"<table><tr><td>{x}</td></tr></table>" for x in (0.5, 0.6))
    >>> html_differences("output", old, new, Comparison(Settings()))
    ['output, row 1, column 1 of table 1: 0.6, stored 0.5 (difference 0.1, allowed 6e-06)']
    """
    if stored == new:
        return []
    messages = []
    old_pictures, new_pictures = _PICTURE.findall(stored), _PICTURE.findall(new)
    if len(old_pictures) != len(new_pictures):
        return [f"{name}: {len(new_pictures)} pictures, stored {len(old_pictures)}"]
    for number, (a, b) in enumerate(zip(old_pictures, new_pictures, strict=True), start=1):
        message = pictures_difference(a, b)
        if message:
            messages.append(f"{name}, picture {number} of {len(new_pictures)}: {message}")
    old, now = (_pieces(text) for text in (stored, new))
    return (messages + _pieces_differences(name, old, now, comparison))[:6]


def svg_differences(name: str, stored: str, new: str, comparison: Comparison) -> list[str]:
    """What differs between two SVG pictures, but for their names and dates.

    Parameters
    ----------
    name : str
    stored, new : str
    comparison : Comparison

    Returns
    -------
    messages : list of str
    """
    stored, new = (_SVG_NOISE.sub("", text) for text in (stored, new))
    return html_differences(name, stored, new, comparison)


def script_differences(name: str, stored: str, new: str, comparison: Comparison) -> list[str]:
    """What differs between two scripts: in their JSON, and in the code around it.

    Parameters
    ----------
    name : str
    stored, new : str
    comparison : Comparison

    Returns
    -------
    messages : list of str
    """
    (old_code, old_data), (code, data) = (_split_json(_renamed(t)) for t in (stored, new))
    if len(old_data) != len(data):
        return [f"{name}: {len(data)} pieces of data, stored {len(old_data)}"]
    messages = json_differences(name, old_data, data, comparison)
    message = comparison.text(old_code, code)
    return messages + ([f"{name}: {message}"] if message else [])


def _split_json(text: str) -> tuple[str, list[Any]]:
    decoder = json.JSONDecoder()
    code, data, position = [], [], 0
    for match in _LITERAL.finditer(text):
        if match.start() < position:
            continue
        try:
            value, end = decoder.raw_decode(text, match.start())
        except (json.JSONDecodeError, RecursionError):
            continue
        code.append(text[position : match.start()])
        data.append(value)
        position = end
    return "<data>".join([*code, text[position:]]), data


def _renamed(text: str) -> str:
    """A page whose identifiers are counted in the order of their appearance."""
    text = _FILM.sub("film", _PICTURE.sub("picture", text))
    names: dict[str, str] = {}
    for match in _ID.finditer(text):
        if re.search(r"\d|^T_", match[1]):
            names.setdefault(match[1], f"name{len(names) + 1}")
    if names:
        text = _WORD.sub(lambda m: names.get(m[0], m[0]), text)
    return _HEX.sub(lambda m: names.setdefault(m[0], f"name{len(names) + 1}"), text)


def _pieces(text: str) -> list[_Piece]:
    reader = _Reader()
    reader.feed(_renamed(text))
    reader.close()
    return reader.pieces


def _pieces_differences(
    name: str, old: list[_Piece], new: list[_Piece], comparison: Comparison
) -> list[str]:
    messages: list[str] = []
    largest: dict[tuple[int, int], float] = {}
    for piece in (*old, *new):
        value = _value(piece.value) if piece.table and piece.kind == "text" else 0.0
        key = piece.table, piece.column
        largest[key] = max(largest.get(key, 0.0), value)
    for a, b in zip(old, new, strict=False):
        if a.kind != b.kind or a[2:] != b[2:]:
            return [*messages, f"{name}: {cut(b.value, 90)!r}, stored {cut(a.value, 90)!r}"]
        if a.value == b.value:
            continue
        if a.kind in _SCRIPTS:
            messages += script_differences(f"{name}, {a.kind}", a.value, b.value, comparison)
            continue
        stored, now = (" ".join(piece.value.split()) for piece in (a, b))
        message = comparison.text(stored, now, beside=largest.get((a.table, a.column), 0.0))
        if message:
            place = (
                f", row {a.row}, column {a.column} of table {a.table}" if a.table and a.row else ""
            )
            messages.append(f"{name}{place}: {message.removeprefix('line 1: ')}")
    if len(old) != len(new):
        k = min(len(old), len(new))
        extra = (new[k:] or old[k:])[0].value
        messages.append(f"{name}: {len(new)} pieces, stored {len(old)}; from {cut(extra, 90)!r}")
    return messages


def _value(text: str) -> float:
    try:
        value = abs(float(text))
    except ValueError:
        return 0.0
    return value if value < float("inf") else 0.0
