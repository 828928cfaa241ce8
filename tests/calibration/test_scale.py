"""The markers' scale by known lengths: distances of axes, their deviations, and the verdict."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.errors import CalibrationError
from calibration.scale import Axis, KnownLength, axis_distance, combine_lengths

Z = np.array([0.0, 0.0, 1.0])


def turned(direction: np.ndarray, rng: np.random.Generator, std_rad: float) -> np.ndarray:
    """A direction moved by std_rad / sqrt(2) in each of two ways across it."""
    moved = direction + np.cross(direction, rng.normal(0, std_rad / np.sqrt(2), 3))
    return moved / np.linalg.norm(moved)


def shifted(point_m: np.ndarray, direction: np.ndarray, rng: np.random.Generator, std_m: float) -> np.ndarray:
    step = rng.normal(0, std_m / np.sqrt(2), 3)
    return point_m + step - direction * (step @ direction)


def test_the_distance_of_parallel_and_of_skew_axes_is_along_what_is_normal_to_both():
    a = Axis(Z, np.array([0.01, 0.02, 0.5]), 0.0, 0.0)
    parallel = Axis(-Z, np.array([0.01, 0.16, -0.3]), 0.0, 0.0)
    assert axis_distance(a, parallel) == pytest.approx((0.14, 0.0))
    skew = Axis(np.array([1.0, 0.0, 0.0]), np.array([5.0, 0.16, 2.0]), 0.0, 0.0)
    assert axis_distance(a, skew) == pytest.approx((0.14, 0.0))
    crossing = Axis(np.array([0.0, 1.0, 0.0]), np.array([0.01, 7.0, 0.0]), 0.0, 0.0)
    assert axis_distance(a, crossing)[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.8, 0.0, 0.6), (1.0, 0.0, 0.0)])
def test_the_standard_deviation_of_a_distance_covers_its_error(direction: tuple[float, float, float]):
    rng = np.random.default_rng(3)
    true_a, true_b = np.array([0.0, 0.0, 0.0]), np.array([0.05, 0.14, 0.12])
    d_b = np.array(direction)
    d_std, p_std = np.radians(0.1), 3e-4
    want = axis_distance(Axis(Z, true_a, 0.0, 0.0), Axis(d_b, true_b, 0.0, 0.0))[0]
    normalised = []
    for _ in range(400):
        a = Axis(turned(Z, rng, d_std), shifted(true_a, Z, rng, p_std), d_std, p_std)
        b = Axis(turned(d_b, rng, d_std), shifted(true_b, d_b, rng, p_std), d_std, p_std)
        found, std = axis_distance(a, b)
        normalised.append((found - want) / std)
    assert np.sqrt(np.mean(np.square(normalised))) == pytest.approx(1.0, abs=0.11)  # 400 draws, three sigma


def test_a_size_that_is_wrong_is_called_so_and_one_that_is_right_too():
    wrong = combine_lengths([KnownLength("a", 1.021, 0.002), KnownLength("b", 1.019, 0.002)])
    assert wrong.off and wrong.ratio == pytest.approx(1.02) and wrong.std == pytest.approx(0.002 / np.sqrt(2))
    assert "+2.00 % off" in wrong.verdict and "too large, by a factor of 1.0200" in wrong.verdict
    assert "too small" in combine_lengths([KnownLength("a", 0.98, 0.001)]).verdict
    right = combine_lengths([KnownLength("a", 1.004, 0.001)])  # 4 sigma, and less than matters
    assert not right.off and "size is right" in right.verdict
    unsure = combine_lengths([KnownLength("a", 1.02, 0.01)])
    assert not unsure.off and "would not be seen either" in unsure.verdict


def test_lengths_that_disagree_widen_the_deviation_and_none_is_no_scale():
    odd = combine_lengths([KnownLength("a", 1.00, 0.001), KnownLength("b", 1.04, 0.001)])
    assert odd.std == pytest.approx(0.02) and not odd.off
    with pytest.raises(CalibrationError, match="no length is known"):
        combine_lengths([])
    with pytest.raises(CalibrationError, match="standard deviation"):
        combine_lengths([KnownLength("a", 1.0, 0.0)])
