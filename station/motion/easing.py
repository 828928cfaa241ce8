"""Time laws without jolts: how a move starts and ends at rest."""

from __future__ import annotations

import numpy as np

from station.logs import FloatArray

# A move gets up to its speed, and from it to rest, in so long.
RAMP_S = 0.4


def eased_time(t_s: FloatArray, ramp_s: FloatArray | float) -> FloatArray:
    """Time that gets under way: its rate rises from 0 to 1 over ramp_s as (1 - cos(pi t / ramp)) / 2, then stays.

    From then on it is ramp / 2 behind. Zero before t = 0; without a ramp it is t itself.
    """
    ramp = np.broadcast_to(np.asarray(ramp_s, dtype=np.float64), t_s.shape)
    some = np.where(ramp > 0, ramp, 1.0)
    inside = np.clip(t_s, 0.0, ramp)
    rising = 0.5 * (inside - some / np.pi * np.sin(np.pi * inside / some))
    return np.where(ramp > 0, rising, 0.0) + np.maximum(t_s - ramp, 0.0)


def eased_share(t_s: FloatArray, move_s: FloatArray, ramp_s: FloatArray) -> FloatArray:
    """Share of its way, 0 to 1, of a move that takes move_s, with ramp_s (at most half of that) at either end."""
    even_s = move_s - ramp_s
    moving = even_s > 0
    t = np.clip(t_s, 0.0, move_s)
    share = (eased_time(t, ramp_s) - eased_time(t - even_s, ramp_s)) / np.where(moving, even_s, 1.0)
    return np.where(moving, share, 1.0)


def eased_move(way: FloatArray, speed: FloatArray, acceleration: FloatArray) -> tuple[float, float]:
    """Duration and ramp [s] of a move over ways (J,) that all joints take in step, none above its speed (J,) or
    acceleration (J,), which may be infinite; nor does any get up to its speed in less than RAMP_S.

    The greatest speed is way / (move - ramp), the greatest acceleration pi / 2 of that over ramp.
    """
    even_s = float(np.max(way / speed, initial=0.0))
    if even_s == 0:
        return 0.0, 0.0
    squared_s2 = float(np.max(np.pi / 2 * way / np.minimum(acceleration, np.pi / 2 * speed / RAMP_S)))
    ramp_s = squared_s2 / even_s
    if ramp_s > even_s:  # too short a way to reach that speed
        even_s = ramp_s = float(np.sqrt(squared_s2))
    return even_s + ramp_s, ramp_s
