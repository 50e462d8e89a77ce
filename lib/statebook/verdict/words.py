"""Numbers, tables and the order of eigenvalues, as reports show them."""

from __future__ import annotations

import html

import numpy as np


def format_real(value: float, scale: float = 0.0) -> str:
    """Four digits; what is rounding against scale is 0, never -0."""
    return "0" if abs(value) <= 1e-9 * scale or value == 0 else f"{value:.4g}"


def format_complex(value: complex, scale: float) -> str:
    real, imag = format_real(value.real, scale), format_real(value.imag, scale)
    if imag == "0":
        return real
    sign = "-" if imag.startswith("-") else "+"
    return f"{real} {sign} {imag.lstrip('-')}j" if real != "0" else f"{imag}j"


def text_table(rows: list[tuple[str, ...]]) -> list[str]:
    """Return the lines of a table, its columns aligned."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def html_table(rows: list[tuple[str, ...]]) -> str:
    """Return a table with a head; a wide one scrolls by itself, and the page does not."""
    table = "".join(
        "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row) + "</tr>"
        for tag, row in zip(["th", *["td"] * len(rows)], rows, strict=False)
    )
    return f'<div style="overflow-x:auto;white-space:nowrap"><table>{table}</table></div>'


def sort_eigenvalues(eigenvalues: np.ndarray) -> np.ndarray:
    """Sort along the last axis by decreasing real part, then imaginary part.

    Real parts that agree to 1e-9 of the largest eigenvalue count as equal, so that rounding
    does not shuffle conjugate pairs.
    """
    return np.take_along_axis(eigenvalues, sorting(eigenvalues), axis=-1).astype(complex)


def sorting(eigenvalues: np.ndarray) -> np.ndarray:
    """Indices that sort eigenvalues along the last axis."""
    scale = np.abs(eigenvalues).max(axis=-1, keepdims=True, initial=0.0)
    real = eigenvalues.real / np.where(scale > 0, scale, 1.0)
    return np.lexsort((-eigenvalues.imag, -np.round(real, 9)), axis=-1)
