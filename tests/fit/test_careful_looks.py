"""How carefully pairs are looked at: few frames tell the noise, but no body; and no look is made twice."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from simulated import noisy_log, poses, scores, simulated_tree

from station.fit import asking
from station.fit.asking import FITTING, SURVEYING, Explained, Question
from station.fit.learner import learn
from station.fit.options import FitOptions
from station.logs import PoseLog

ARM_M, SIGMA_M, SIGMA_RAD = 0.02, 0.001, 0.02


def hinge_log(seed: int, frames: int, turn_rad: float) -> PoseLog:
    """Two parts about a hinge beside the second one, which turns to and fro by so much; both move anyhow."""
    rng = np.random.default_rng(seed)
    arm = poses(np.zeros(3), np.array([ARM_M, 0, 0]))
    first = poses(rng.uniform(-1, 1, (frames, 3)), rng.uniform(-0.3, 0.3, (frames, 3)))
    second = first @ poses(rng.normal(0, turn_rad, (frames, 1)) * [0, 0, 1], np.zeros(3)) @ arm
    noise = poses(*(rng.normal(0, sigma, (frames, 2, 3)) for sigma in (SIGMA_RAD, SIGMA_M)))
    return PoseLog(np.arange(frames) / 30, "world", ("first", "second"), np.stack([first, second], axis=1) @ noise)


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_parts_that_turn_too_little_for_a_few_frames_to_tell_are_two_bodies(seed: int) -> None:
    """As many frames as a survey has don't tell it; all do."""
    log = hinge_log(seed, 200, 2 * SIGMA_RAD)
    assert SURVEYING.frames is not None
    few = np.linspace(0, len(log.t_s) - 1, SURVEYING.frames).astype(np.intp)
    assert not learn(PoseLog(log.t_s[few], log.reference, log.parts, log.T_ref_part[few])).tree.joints
    assert [joint.type for joint in learn(log).tree.joints] == ["revolute"]


@pytest.mark.parametrize(("frames", "again"), [(90, False), (300, True)])
def test_pairs_of_which_all_frames_were_looked_at_are_not_fitted_again(
    frames: int, again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Question[Any]] = []
    explained = asking._explained

    def seen(question: Question[Any], *rest: Any) -> Explained:
        asked.append(question)
        return explained(question, *rest)

    monkeypatch.setattr(asking, "_explained", seen)
    rng = np.random.default_rng(3)
    truth = simulated_tree(rng, bodies=3, frames=frames, root_moves=True, trackers=(1, 1))
    assert len(learn(noisy_log(rng, truth, sigma_m=SIGMA_M, sigma_rad=0.005)).tree.joints) == 2
    assert (FITTING in {question.effort for question in asked}) == again


@pytest.mark.parametrize("root", range(4))
def test_a_careful_look_serves_from_whichever_end_its_joint_hangs(root: int) -> None:
    rng = np.random.default_rng(8)
    truth = simulated_tree(rng, bodies=4, frames=120, root_moves=True, trackers=(1, 1))
    log = noisy_log(rng, truth, sigma_m=SIGMA_M, sigma_rad=0.005)
    as_it_starts = FitOptions(root=log.parts[root], refine="none")  # least squares of all would mend a wrong start
    found = scores(truth, log, learn(log, as_it_starts).tree)
    assert found.types_correct
    assert all(joint.axis_error_rad is not None and joint.axis_error_rad < 0.02 for joint in found.joints)
