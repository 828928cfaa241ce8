"""Where a plan's joints will be: a servo that is sent a step runs at its speed limit until it is there."""

from __future__ import annotations

import numpy as np

from station.logs import FloatArray
from station.motion import Plan


def expected_states(plan: Plan, t_s: FloatArray) -> FloatArray:
    """States (..., J), rad or m, at times (...,) from the start of the motion.

    Of a streamed motion what is commanded; in a stepped one each joint leaves with its command and goes on at its own
    speed until it has arrived, as the plan's times have it. Gaining speed, lag and sag are left out.
    """
    if plan.motion.mode != "step":
        return plan.commanded(t_s)
    starts_s, q_from, q_to, speed = (
        np.stack([getattr(segment, name) for segment in plan.segments])
        for name in ("t_start_s", "q_from", "q_to", "speed")
    )
    index = np.maximum(np.searchsorted(starts_s, t_s, side="right") - 1, 0)
    gone_s = np.maximum(np.asarray(t_s) - starts_s[index], 0.0)[..., None]
    way = (q_to - q_from)[index]
    return q_from[index] + np.sign(way) * np.minimum(speed[index] * gone_s, np.abs(way))
