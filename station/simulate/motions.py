"""How simulated objects move: Algorithm 2's random walk, step by step and all at once, and smooth motions.

The steps are pure functions, so that a walk may be played frame by frame (`start_states`, `walk_states`, `start_root`,
`walk_root`) or made for many frames and repeats at once. A motion is an entry in `MOTIONS`.

Algorithm 2 doesn't tell the first states: they are drawn from the whole ranges. Its line 6 moves the root by the noise
of its own observation; here by steps of their own (`noise` says why).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from station.kinematics import se3
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray
from station.simulate.noise import PLANAR
from station.simulate.state_ranges import StateRanges, state_ranges

# Algorithm 2, line 1: where a root starts [m, rad], plus and minus; line 8: the largest step, of a range.
ROOT_START_M, ROOT_START_RAD = 5.0, 2 * np.pi
STEP_SHARE = 0.1
# A smooth motion goes to and fro this often, least and most; a smooth root sways as far as so many steps.
SWINGS = (0.5, 3.0)
SWAY_STEPS = 10.0


def start_states(tree: KinematicTree, rng: np.random.Generator) -> FloatArray:
    """(C,) states anywhere in the ranges of a tree's joints, as its `columns` say; see `state_ranges`."""
    ranges = state_ranges(tree)
    return ranges.spread(rng.uniform(-1.0, 1.0, ranges.low.shape))


def walk_states(tree: KinematicTree, q: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(..., C) states one step on from q (..., C): lines 8-9 of Algorithm 2."""
    ranges = state_ranges(tree)
    return ranges.bounded(q + rng.uniform(-1.0, 1.0, np.shape(q)) * (STEP_SHARE * ranges.span))


def start_root(rng: np.random.Generator, *, planar: bool = False) -> FloatArray:
    """(4, 4) `T_world_root` at random: line 1 of Algorithm 2; planar: in the world's xy plane."""
    return started_root(rng.uniform(-1.0, 1.0, 6), planar=planar)


def started_root(u: FloatArray, *, planar: bool) -> FloatArray:
    """(..., 4, 4) a root's first pose, T(v) R(w), for numbers u (..., 6) from -1 to 1."""
    start = u * (PLANAR if planar else 1.0)
    return se3.pose(se3.exp_so3(ROOT_START_RAD * start[..., 3:]), ROOT_START_M * start[..., :3])


def walk_root(
    T_world_root: FloatArray, rng: np.random.Generator, step_m: float, step_rad: float, *, planar: bool = False
) -> FloatArray:
    """(4, 4) the root one step on: line 6 of Algorithm 2, with a step in the root's own frame."""
    scale = np.repeat([step_m, step_rad], 3) * (PLANAR if planar else 1.0)
    return T_world_root @ se3.exp(rng.uniform(-1.0, 1.0, 6) * scale)


@dataclass(frozen=True)
class Motion:
    """A way to move.

    Attributes:
        draws: random numbers from -1 to 1 for one repeat: `(rng, frames, columns)` to any shape.
        states: (R, T, C) states of their ranges, for draws (R, ...) and a number of frames.
        path: (R, T, 4, 4) motion of a root from its start, in its own frame, for draws of six columns and the largest
            step (6,) [m, rad].
    """

    draws: Callable[[np.random.Generator, int, int], FloatArray]
    states: Callable[[StateRanges, FloatArray, int], FloatArray]
    path: Callable[[FloatArray, FloatArray, int], FloatArray]


def _walk_draws(rng: np.random.Generator, frames: int, columns: int) -> FloatArray:
    """(T, columns), a row a frame: a longer walk begins as a shorter one."""
    return rng.uniform(-1.0, 1.0, (frames, columns))


def _walk_states(ranges: StateRanges, u: FloatArray, frames: int) -> FloatArray:
    q = u * (STEP_SHARE * ranges.span)
    q[:, 0] = ranges.spread(u[:, 0])
    for t in range(1, frames):  # each step starts where the last ended
        q[:, t] = ranges.bounded(q[:, t - 1] + q[:, t])
    return q


def _walk_path(u: FloatArray, step: FloatArray, frames: int) -> FloatArray:
    T = se3.exp(u * step)
    T[:, 0] = np.eye(4)
    joined = 1  # steps in each product so far: every round joins two products, so that few rounds make a long path
    while joined < frames:
        T[:, joined:] = T[:, :-joined] @ T[:, joined:]
        joined *= 2
    return T


def _smooth_draws(rng: np.random.Generator, frames: int, columns: int) -> FloatArray:
    """(columns, 4): two rates and two phases each."""
    return rng.uniform(-1.0, 1.0, (columns, 4))


def _sway(u: FloatArray, frames: int) -> FloatArray:
    """(R, T, C) from -1 to 1, whose ends are reached: two sines of draws u (R, C, 4)."""
    t = np.linspace(0.0, 2 * np.pi, frames)[:, None]
    rate = SWINGS[0] + (SWINGS[1] - SWINGS[0]) * (0.5 + 0.5 * u[:, None, :, :2])
    phase = np.pi * u[:, None, :, 2:]
    x = np.sin(rate[..., 0] * t + phase[..., 0]) + 0.5 * np.sin(rate[..., 1] * t + phase[..., 1])
    low, high = x.min(axis=1, keepdims=True), x.max(axis=1, keepdims=True)
    return 2 * (x - low) / np.where(high > low, high - low, 1.0) - 1


def _smooth_states(ranges: StateRanges, u: FloatArray, frames: int) -> FloatArray:
    return ranges.spread(_sway(u, frames))


def _smooth_path(u: FloatArray, step: FloatArray, frames: int) -> FloatArray:
    T = se3.exp(SWAY_STEPS * step * _sway(u, frames))
    return se3.inverse(T[:, :1]) @ T


MOTIONS: dict[str, Motion] = {
    "walk": Motion(_walk_draws, _walk_states, _walk_path),
    "smooth": Motion(_smooth_draws, _smooth_states, _smooth_path),
}
