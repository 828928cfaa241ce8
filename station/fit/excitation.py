"""How much motion a joint needs for its axis to be told: the fit's own measure, also while capturing."""

from __future__ import annotations

import math

# Less travel than this [rad, m] is what makes an axis uncertain; with more it is the noise.
SMALL_TRAVEL = {"rad": math.radians(15.0), "m": 0.05}


def motion_share(travel: float, unit: str) -> float:
    """Travel [rad or m] that was seen as a share of what the fit needs; 1 and more is enough."""
    return travel / SMALL_TRAVEL[unit]
