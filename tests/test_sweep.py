"""sweep gives what a loop gives, wherever it runs."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

import statebook as sb


def polar(radius, angle):
    return np.array([radius * np.cos(angle), radius * np.sin(angle)])


def ragged(size):
    return np.zeros(size)


def failing(x):
    return 1 / x


GRID = {"radius": [1.0, 2.0, 3.0], "angle": np.linspace(0, 1, 5)}


@pytest.mark.parametrize("pool", [ThreadPoolExecutor, ProcessPoolExecutor, None])
def test_order_and_shape(pool):
    executor = pool and pool(max_workers=2)
    result = sb.sweep(polar, GRID, executor=executor, progress=False)
    assert result.shape == (3, 5, 2)
    for i, j in np.ndindex(3, 5):
        expected = polar(GRID["radius"][i], GRID["angle"][j])
        np.testing.assert_array_equal(result[i, j], expected)
    if executor:
        executor.shutdown()


def test_failure_names_the_point():
    with ThreadPoolExecutor() as pool:
        with pytest.raises(RuntimeError, match=r"failed at \{'x': 0\}: division by zero"):
            sb.sweep(failing, {"x": [2, 1, 0]}, executor=pool, progress=False)


@pytest.mark.parametrize("grid", [{}, {"size": []}])
def test_empty_grid_is_refused(grid):
    with pytest.raises(ValueError, match="at least one value"):
        sb.sweep(ragged, grid)


def test_results_must_have_one_shape():
    with ThreadPoolExecutor() as pool:
        with pytest.raises(ValueError, match="one shape"):
            sb.sweep(ragged, {"size": [1, 2]}, executor=pool, progress=False)
