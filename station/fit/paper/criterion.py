"""The score by which joint types compare: Akaike's criterion as the paper has it (24)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from station.fit.paper.joints import PaperJoint


@dataclass(frozen=True)
class Criterion:
    """A named score, lower is better, of a joint, the sum of its costs over frames, and the number of frames."""

    name: str
    score: Callable[[PaperJoint, float, int], float]


def _aic(joint: PaperJoint, cost: float, frames: int) -> float:
    return cost + 2 * joint.parameters


# The cost stands for -2 log L of (24), which with the weights of `Weights.of_noise` it is. The text takes the cost for
# -log L and adds the number of parameters once, as (8) does: that ranks as this does with c and d doubled.
#
# The states count nothing, and each takes up one direction of its frame's noise: with weights that fit the noise a
# movable joint costs T less than a rigid one, for 3 or 6 parameters more. So rigid is chosen only if the weights
# overrate the noise.
PAPER_AIC = Criterion("paper-aic", _aic)
