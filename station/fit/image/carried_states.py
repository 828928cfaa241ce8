"""States of frames as those around them tell: carried on or back at their pace, or between the two."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from station.fit.skeleton import Skeleton, TreeModel
from station.kinematics import se3
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# A pace is carried on for as many times the time that it was taken over; then states stay.
FARTHEST = 3.0
# What all but so many frames err by when they are told by those around; from so many of them at least.
USUALLY, TRIED_FRAMES = 0.9, 20


def carried(
    skeleton: Skeleton, model: TreeModel, t_s: FloatArray, rows: IntArray, good: BoolArray
) -> tuple[TreeModel, ...]:
    """States in some frames: between the good ones around, on from those before, and back from those after.

    Where there is none on one side, all are told by the other; without any good frame there is no answer.

    Args:
        skeleton: of the tree.
        model: of all frames.
        t_s: (T,) times.
        rows: frames in question.
        good: (T,) whose states are to be trusted.
    """
    known = np.flatnonzero(good)
    if not known.size:
        return ()
    at = np.searchsorted(known, rows)
    before, after = known[np.maximum(at - 1, 0)], known[np.minimum(at, len(known) - 1)]
    before, after = np.where(at == 0, after, before), np.where(at == len(known), before, after)
    farther_back, farther_on = known[np.maximum(at - 2, 0)], known[np.minimum(at + 1, len(known) - 1)]
    ways = [(before, after), (farther_back, before), (farther_on, after)]
    return tuple(_between(skeleton, model, t_s, rows, *way) for way in ways)


def _between(
    skeleton: Skeleton, model: TreeModel, t_s: FloatArray, rows: IntArray, a: IntArray, b: IntArray
) -> TreeModel:
    """States in frames `rows` on the straight way from those in frames a to those in frames b, or on beyond."""
    span_s = t_s[b] - t_s[a]
    share = np.where(span_s != 0, (t_s[rows] - t_s[a]) / np.where(span_s != 0, span_s, 1.0), 1.0)
    share = np.where((share < 0) | (share > 1 + FARTHEST), 1.0, share)
    of_a, of_b = model.take(a), model.take(b)
    q = of_b.q.copy()
    for j, joint in enumerate(skeleton.joints):
        columns = skeleton.state_columns(j)
        first = joint.type.nearest_turn(of_a.q[:, columns], of_b.q[:, columns])
        q[:, columns] += (share - 1)[:, None] * (of_b.q[:, columns] - first)
    root = of_b.T_ref_root
    if skeleton.root_moves:
        root = root @ se3.exp((share - 1)[:, None] * se3.log(se3.inverse(of_a.T_ref_root) @ root))
    return replace(model, T_ref_root=root, q=q)


def carrying_error(skeleton: Skeleton, model: TreeModel, t_s: FloatArray, known: IntArray, missing: int) -> FloatArray:
    """(s,) by how much frames are usually told wrongly by those around them, as `moved` takes it; inf if too few.

    Args:
        skeleton: of the tree.
        model: of all frames.
        t_s: (T,) times.
        known: frames whose states are to be trusted.
        missing: every other run of so many of them is told by the rest.
    """
    out = np.arange(len(known)) // missing % 2 == 1
    out[-1:] = False  # between two others, all of them
    rows = known[out]
    if len(rows) < TRIED_FRAMES:
        return np.full(skeleton.states, np.inf)
    good = np.zeros(len(t_s), dtype=bool)
    good[known[~out]] = True
    between, *_ = carried(skeleton, model, t_s, rows, good)
    return np.quantile(np.abs(from_to(skeleton, model.take(rows), between)), USUALLY, axis=0)


def from_to(skeleton: Skeleton, here: TreeModel, there: TreeModel) -> FloatArray:
    """(n, s) from states to others, as `moved` takes them."""
    found = np.zeros((len(here.q), skeleton.states))
    for j, joint in enumerate(skeleton.joints):
        columns, form = skeleton.state_columns(j), here.frames[j].form
        M, M_other = (joint.type.axis_motion(of.q[:, columns], form) for of in (here, there))
        found[:, columns] = se3.log(se3.inverse(M) @ M_other) @ np.linalg.pinv(joint.type.state_twists(form)).T
    found[:, skeleton.joint_states :] = se3.log(se3.inverse(here.T_ref_root) @ there.T_ref_root)[
        :, : 6 * skeleton.root_moves
    ]
    return found
