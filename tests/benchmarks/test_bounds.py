"""The Cramer-Rao bounds that the benchmarks print, against published ones and against a simulation."""

from __future__ import annotations

import numpy as np
import pytest

from tests.benchmarks.bounds import bound, median_norm
from tests.benchmarks.made_joints import MadeObject, single_joint, watch
from tests.benchmarks.made_trees import random_tree

STD_M, STD_RAD = 0.003, 0.02


def least(made: MadeObject, std_m: float = STD_M, std_rad: float = STD_RAD) -> tuple[float, float]:
    """Median bounds of axis [deg] and point [mm] of the first joint."""
    T, K = made.T_ref_part.shape[:2]
    found = bound(made, np.zeros((T, K, 6)), std_m, std_rad)
    return float(np.degrees(median_norm(found.axis(0)))), 1e3 * median_norm(found.point(0))


@pytest.mark.parametrize(
    ("kind", "travel", "arm_m", "axis_deg"),
    [("prismatic", 0.3, 0.3, 0.17), ("prismatic", 0.05, 0.3, 1.0), ("revolute", np.pi / 2, 0.3, 0.15),
     ("revolute", np.pi / 6, 0.3, 0.45), ("revolute", np.pi / 18, 0.3, 1.35), ("revolute", np.pi / 2, 0.0, 0.22),
     ("revolute", 5 * np.pi / 3, 0.3, 0.057)],
)  # fmt: skip
def test_bounds_of_one_joint_are_the_published_ones(kind: str, travel: float, arm_m: float, axis_deg: float) -> None:
    made = single_joint(np.random.default_rng(1), kind, frames=200, travel=travel, arm_m=arm_m)
    # Published to two digits: half a unit of the last, and the medians' 0.5 %.
    assert least(made)[0] == pytest.approx(axis_deg, rel=0.05)


@pytest.mark.parametrize(
    ("kind", "travel", "std_mm", "std_deg", "poses", "axis_deg"),
    [("prismatic", 0.2, 30, 3, 10, 15.4), ("prismatic", 0.4, 30, 3, 40, 4.2), ("revolute", np.pi / 12, 1, 1, 10, 5.3),
     ("revolute", np.pi / 4, 30, 3, 10, 6.1), ("revolute", np.pi / 2, 30, 3, 40, 1.7),
     ("revolute", np.pi / 2, 100, 10, 10, 10.4)],
)  # fmt: skip
def test_bounds_with_a_noisy_parent_are_the_published_ones(
    kind: str, travel: float, std_mm: float, std_deg: float, poses: int, axis_deg: float
) -> None:
    found: list[float] = []
    for seed in range(8):
        made = single_joint(
            np.random.default_rng(seed), kind, frames=poses, travel=travel, arm_m=0.65, parent_tracked=True
        )
        found.append(least(made, 1e-3 * std_mm, np.radians(std_deg))[0])
    # The published ones are of one geometry, these of eight.
    assert np.median(found) == pytest.approx(axis_deg, rel=0.05)


@pytest.mark.parametrize("root_moves", [False, True])
def test_efficient_estimates_err_as_much_as_the_bound_says(root_moves: bool) -> None:
    rng = np.random.default_rng(2)
    kinds = ("prismatic", "revolute", "screw")
    made = random_tree(rng, bodies=3, frames=20, kinds=kinds, root_moves=root_moves, walk=False, trackers=(1, 2))
    squares: list[float] = []
    for _ in range(25):
        noise = watch(rng, made.T_ref_part, STD_M, STD_RAD).noise
        found = bound(made, noise, STD_M, STD_RAD)
        for j in range(2):
            error = found.efficient[found.axis_columns[j]]
            squares.append(float(error @ np.linalg.solve(found.axis(j), error)))
    # Half of chi squared of 100 degrees of freedom over 50: a standard deviation of 14 %, here three of them.
    assert np.mean(squares) / 2 == pytest.approx(1.0, abs=0.42)


def test_four_times_the_frames_halve_the_bound_and_a_parent_s_noise_raises_it() -> None:
    """A parent with the child's noise doubles the variance, and its orientation has a lever."""
    exact = single_joint(np.random.default_rng(3), "revolute", frames=50, travel=1.0, arm_m=0.3)
    tracked = single_joint(np.random.default_rng(3), "revolute", frames=50, travel=1.0, arm_m=0.3, parent_tracked=True)
    longer = single_joint(np.random.default_rng(3), "revolute", frames=200, travel=1.0, arm_m=0.3)
    # Evenly spaced, 50 states spread 3 % more than 200.
    assert least(longer)[0] == pytest.approx(0.5 * least(exact)[0], rel=0.04)
    assert least(tracked)[0] > np.sqrt(2) * least(exact)[0]
