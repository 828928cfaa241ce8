"""How carefully pairs are looked at: no look is made twice."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from simulated import noisy_log, simulated_tree

from station.fit import asking
from station.fit.asking import FITTING, Explained, Question
from station.fit.learner import learn


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
    assert len(learn(noisy_log(rng, truth, sigma_m=0.001, sigma_rad=0.005)).tree.joints) == 2
    assert (FITTING in {question.effort for question in asked}) == again
