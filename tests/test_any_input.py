"""Whatever a caller sends is right, or refused by a documented error."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import statebook as sb

DOCUMENTED = (TypeError, ValueError, sb.EquilibriumNotFoundError)
magnitudes = st.one_of(
    st.just(0.0),
    st.builds(
        lambda sign, digits, power: sign * digits * 10.0**power,
        st.sampled_from([-1.0, 1.0]),
        st.floats(1, 9.99),
        st.integers(-300, 299),
    ),
)


def as_sent(x, form):
    """Return x in one of the forms in which arrays arrive."""
    if form == "read-only":
        x = x.copy()
        x.flags.writeable = False
        return x
    if form == "non-contiguous":
        return np.repeat(x, 2)[::2]
    if form == "reversed":
        return x[::-1].copy()[::-1]
    return {"list": x.tolist(), "tuple": tuple(x.tolist()), "array": x}[form]


FORMS = st.sampled_from(["array", "read-only", "non-contiguous", "reversed", "list", "tuple"])


@settings(deadline=None, derandomize=True, max_examples=60)
@given(
    st.integers(1, 4).flatmap(
        lambda n: st.tuples(*[st.lists(magnitudes, min_size=n, max_size=n)] * 2)
    ),
    FORMS,
)
def test_linear_functions_of_any_magnitude(rows, form):
    gains, x = (np.array(v) for v in rows)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            A, B = sb.jacobians(lambda x: gains * x, as_sent(x, form))
        except DOCUMENTED:  # gains * x overflows, at x or beside it
            assert not np.isfinite(2 * gains * np.maximum(np.abs(x), 1)).all()
            return
    assert B.shape == (len(x), 0)
    # An entry whose products all underflow is beyond what numbers can show.
    visible = np.abs(gains) * np.where(x == 0, 1.0, np.abs(x)) > 1e-290
    expected = np.diag(np.where(visible, gains, 0.0))
    found = np.where(np.diag(visible) | ~np.eye(len(x), dtype=bool), A, 0.0)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=0)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(magnitudes, magnitudes, FORMS)
def test_waves_of_any_magnitude(size, x, form):
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            A, _ = sb.jacobians(lambda x: size * np.sin(x), as_sent(np.array([x]), form))
        except DOCUMENTED:
            assert abs(x) > 1e3  # beyond, sin(x) is a random number to whoever looks beside x
            return
    if abs(size) > 1e-290 and abs(x) < 1e3:
        assert A[0, 0] == pytest.approx(size * np.cos(x), rel=1e-6, abs=1e-12 * abs(size))


anything = st.one_of(
    hnp.arrays(
        st.sampled_from([np.float64, np.float32, np.int64, np.complex128, np.bool_]),
        hnp.array_shapes(min_dims=0, max_dims=3, max_side=4),
    ),
    st.none(),
    st.text(max_size=3),
    st.lists(st.one_of(st.floats(), st.none(), st.lists(st.floats(), max_size=2)), max_size=3),
)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(
    st.sampled_from([sb.jacobians, sb.linearize, sb.find_equilibrium]),
    st.sampled_from(["model", "function"]),
    anything,
    anything,
)
def test_anything_works_or_raises_what_is_documented(function, kind, x, u):
    system = sb.Pendulum(damping=0.1)
    if kind == "function":
        system = lambda x, u: np.array([x[1], u[0] - np.sin(x[0]) - x[1]])  # noqa: E731
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            result = function(system, x, u)
        except DOCUMENTED as error:
            assert str(error)
            return
        except IndexError:  # of the function itself, which has two states and an input
            assert (kind == "function" and np.shape(x)[:1] != (2,)) or np.shape(u)[:1] != (1,)
            return
    if function is sb.find_equilibrium:
        assert np.isfinite(result.x).all() and np.isfinite(result.u).all()
    else:
        A, B = (result.A, result.B) if function is sb.linearize else result
        assert np.isfinite(A).all() and np.isfinite(B).all()


@settings(deadline=None, derandomize=True, max_examples=40)
@given(
    hnp.arrays(np.float64, st.integers(1, 5), elements=st.floats(-1e3, 1e3)),
    st.integers(0, 2**31),
    FORMS,
)
def test_stable_linear_systems_have_their_origin(guess, seed, form):
    n = len(guess)
    A = np.random.default_rng(seed).normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.1) * np.eye(n)
    found = sb.find_equilibrium(lambda x: A @ x, as_sent(guess, form))
    assert np.abs(found.x).max() <= 1e-12 * max(np.abs(guess).max(), 1.0)


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.sampled_from([np.float32, np.float64, np.int32, np.int8]), st.integers(-5, 5), FORMS)
def test_numbers_of_any_kind_are_numbers(kind, value, form):
    x = np.array([value, 2], dtype=kind)
    A, _ = sb.jacobians(sb.Pendulum(damping=0.5, g=9.8), as_sent(x, form))
    np.testing.assert_allclose(A, [[0, 1], [9.8 * np.sin(value), -0.5]], rtol=1e-14, atol=1e-14)
