"""Claims of the packaged trees: simulated with the options that nobody changed, a fit finds each again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from station.commands import fitting, simulating
from station.fit.options import FitOptions
from station.formats.trees import example_names, load_tree
from station.kinematics.joints import JOINT_TYPES
from station.simulate import SimulationOptions
from station.tree_scores import score_tree

# Of axes found from 100 frames with 1 mm and 0.01 rad of noise. Where bodies swing by a radian and more, the noise of
# the mean of 100 frames is 0.001 rad; the backrest and the door move less.
AXIS_WITHIN_RAD = np.radians(1.5)


@pytest.mark.parametrize("name", example_names())
def test_a_fit_of_the_simulated_poses_finds_the_tree(name: str, tmp_path: Path):
    tree = load_tree(name)
    planar = name.startswith("planar")
    made = simulating.simulate(tree=name, out=tmp_path / "poses.csv", options=SimulationOptions(planar=planar), seed=1)
    plain = {"rigid", "prismatic", "revolute"} | {joint.type for joint in tree.joints}
    options = FitOptions(joint_types=tuple(kind for kind in JOINT_TYPES if kind in plain))
    found = fitting.fit(tmp_path / "poses.csv", tmp_path / "fit", options=options).fit
    scores = score_tree(found.tree, made.simulated.tree, made.simulated.truth)
    assert scores.groups_correct and scores.structure_correct and scores.types_correct, scores.mistakes
    axes = [joint.axis_error_rad for joint in scores.joints if joint.axis_error_rad is not None]
    assert axes and max(axes) < AXIS_WITHIN_RAD
    assert found.tree.warnings == ()
