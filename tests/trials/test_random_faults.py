"""Some captures of the fault campaign; tests/benchmarks/capture_faults.py tries hundreds."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.trials.fault_trials import draw, try_seed


@pytest.mark.parametrize("seed", range(6))
def test_whatever_goes_wrong_on_the_bus_the_arm_is_left_as_it_is_said_to_be(tmp_path: Path, seed: int) -> None:
    assert try_seed(tmp_path, seed).wrong == [], str(draw(seed))
