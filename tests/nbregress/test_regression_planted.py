"""A few planted faults of each kind; `planted.py` plants hundreds."""

import pytest
from planted import FAULTS, NOISE, caught


@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_is_caught(name):
    assert caught(FAULTS, name, 2) == 2


@pytest.mark.parametrize("name", NOISE)
def test_noise_passes(name):
    assert caught(NOISE, name, 2) == 0
