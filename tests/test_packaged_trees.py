"""Claims of the packaged trees: simulated with the options that nobody changed, a fit finds each again."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.commands import fitting, simulating
from station.fit.options import FitOptions
from station.formats.trees import example_names, load_tree
from station.kinematics.joints import JOINT_TYPES
from station.simulate import SimulationOptions
from station.tree_bounds import tree_bounds
from station.tree_scores import score_tree

# Root mean square errors of an axis at the Cramer-Rao bound; one is over 3 once in 8,000 (Rayleigh's distribution).
AXIS_WITHIN_BOUNDS = 3.0


@pytest.mark.parametrize("name", example_names())
def test_a_fit_of_the_simulated_poses_finds_the_tree(name: str, tmp_path: Path):
    tree = load_tree(name)
    simulation = SimulationOptions(planar=name.startswith("planar"))
    made = simulating.simulate(name, tmp_path / "poses.csv", options=simulation, seed=1).simulated
    plain = {"rigid", "prismatic", "revolute"} | {joint.type for joint in tree.joints}
    options = FitOptions(joint_types=tuple(kind for kind in JOINT_TYPES if kind in plain))
    found = fitting.fit(tmp_path / "poses.csv", tmp_path / "fit", options=options).fit
    scores = score_tree(found.tree, made.tree, made.truth)
    assert scores.groups_correct and scores.structure_correct and scores.types_correct, scores.mistakes
    covariance = simulation.noise.covariance(made.truth.T_ref_part)
    bounds = {
        bound.joint: bound.axis_rad
        for bound in tree_bounds(made.tree, made.truth, made.states, covariance, root_moves=True)
    }
    for joint in scores.joints:
        bound = bounds[joint.joint]
        if joint.axis_error_rad is not None and bound is not None:
            assert joint.axis_error_rad < AXIS_WITHIN_BOUNDS * bound, joint.joint
    assert found.tree.warnings == ()
