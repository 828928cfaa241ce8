"""States of the frames in which parts don't fit, where least squares would stay at a wrong answer or lose the frame.

A flipped marker, a gross error of one of a body's trackers, a body that was not seen between two that were: the pairs'
states, or those of the frames around, may then be far off, and all that hangs from there looks like outliers. Here,
with the parameters as they are, each of a body's parts says what state it would have, and the likeliest of that is
taken, body by body from the root outward; then the states of what still doesn't fit are sought together by least
squares with heavy tails, which leave nothing out for being far off.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from station.fit.noise import INLIER_ABOVE
from station.fit.skeleton import Skeleton, TreeJoint, TreeModel, with_moved_states
from station.fit.tree_elimination import UNOBSERVED
from station.fit.tree_equations import equations
from station.fit.tree_motion import tree_poses
from station.fit.tree_residuals import Measured
from station.kinematics import se3
from station.kinematics.joints import JointFrames
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# Degrees of freedom of the heavy tails, and their least squares.
STUDENT_FREEDOMS = 3.0
ROUNDS = 10
DAMPING_START, DAMPING_FALL, DAMPING_RISE = 1e-4, 0.1, 10.0
# In -2 log likelihood of a frame: less is no other answer; a search is over where steps promise no more than this.
BETTER, FOUND = 1.0, 0.01
# Frames that are worked on at once.
FRAMES_AT_ONCE = 1000


def with_likely_states(skeleton: Skeleton, model: TreeModel, measured: Measured, chi2: FloatArray) -> TreeModel:
    """The model with likelier states in frames in which some part looks like an outlier; itself if there are none.

    Args:
        skeleton: of the tree.
        model: parameters, which stay, and states.
        measured: poses of the parts.
        chi2: (T, K) whitened squared residuals of the model.
    """
    odd = np.flatnonzero(_odd(measured, chi2))
    for start in range(0, len(odd), FRAMES_AT_ONCE):  # memory asks for this loop
        rows = odd[start : start + FRAMES_AT_ONCE]
        before, some = model.take(rows), measured.take(rows)
        after = _sought(skeleton, before, some)
        better = _cost(skeleton, after, some) < _cost(skeleton, before, some) - BETTER
        if better.any():
            model = model.with_states(rows[better], after.take(np.flatnonzero(better)))
    return model


def _odd(measured: Measured, chi2: FloatArray) -> BoolArray:
    """(T,) some part was seen and is no inlier."""
    return np.any(measured.seen & (measured.weights(chi2) < INLIER_ABOVE), axis=-1)


def _chi2(skeleton: Skeleton, model: TreeModel, measured: Measured) -> FloatArray:
    return measured.chi2(tree_poses(skeleton, model).parts, model.shared)


def _cost(skeleton: Skeleton, model: TreeModel, measured: Measured) -> FloatArray:
    """(T,) -2 log likelihood."""
    return measured.costs(_chi2(skeleton, model, measured)).sum(axis=-1)


def _sought(skeleton: Skeleton, model: TreeModel, measured: Measured) -> TreeModel:
    """The likeliest of the states as they are, those that single parts tell, and both after a search."""
    best = _likelier(skeleton, measured, model, _told_by_parts(skeleton, model, measured))
    odd = np.flatnonzero(_odd(measured, _chi2(skeleton, best, measured)))
    if not odd.size:
        return best
    before, some = best.take(odd), measured.take(odd)
    return best.with_states(odd, _likelier(skeleton, some, before, _searched(skeleton, before, some)))


def _likelier(skeleton: Skeleton, measured: Measured, a: TreeModel, b: TreeModel) -> TreeModel:
    """The likelier one of two models' states, frame by frame."""
    rows = np.flatnonzero(_cost(skeleton, b, measured) < _cost(skeleton, a, measured))
    return a.with_states(rows, b.take(rows))


def _told_by_parts(skeleton: Skeleton, model: TreeModel, measured: Measured) -> TreeModel:
    """The model with each body where the likeliest of its own parts puts it, from the root outward."""
    if skeleton.root_moves:
        model = _with_root(skeleton, model, measured)
    for j, joint in enumerate(skeleton.joints):  # a body needs those before it
        columns = skeleton.state_columns(j)
        members = [k for k, body in enumerate(skeleton.body_of) if body == joint.far]
        before = model.q[:, columns]
        T_near = tree_poses(skeleton, model).bodies[joint.near]
        proposals = [before, *(_states_of_part(joint, model, j, T_near, measured, k) for k in members)]
        best, chosen = np.full(len(before), np.inf), before
        for q in proposals:
            q = joint.type.nearest_turn(q, before)
            tried = _with_joint(model, columns, q)
            cost = measured.costs(_chi2(skeleton, tried, measured))[:, members].sum(axis=-1)
            chosen, best = np.where((cost < best)[:, None], q, chosen), np.minimum(cost, best)
        model = _with_joint(model, columns, chosen)
    return model


def _states_of_part(
    joint: TreeJoint, model: TreeModel, j: int, T_ref_near: FloatArray, measured: Measured, part: int
) -> FloatArray:
    """(T, s) states that put a part of the far body where it was measured; anything where it was not."""
    frames, sign = model.frames[j], 1.0
    if joint.turned:  # M(q)^-1 is M(-q)
        frames, sign = (
            JointFrames(se3.inverse(frames.T_axis_child), se3.inverse(frames.T_parent_axis), frames.form),
            -1.0,
        )
    seen = se3.inverse(T_ref_near @ frames.T_parent_axis) @ measured.T_ref_part[:, part]
    zero = frames.T_axis_child @ model.mounts[part]
    by_pose = sign * joint.type.axis_state(seen, zero, frames.form)
    by_position = sign * joint.type.axis_state_of_position(seen[:, :3, 3], zero[:3, 3], frames.form)
    return np.where(measured.dimensions[:, part, None] == 6, by_pose, by_position)


def _with_joint(model: TreeModel, columns: slice, q: FloatArray) -> TreeModel:
    """The model with other states (T, s) of one joint."""
    return replace(model, q=np.concatenate([model.q[:, : columns.start], q, model.q[:, columns.stop :]], axis=-1))


def _with_root(skeleton: Skeleton, model: TreeModel, measured: Measured) -> TreeModel:
    """The model with its root where the likeliest part in the tree puts it through the joints between them."""
    best, chosen = _cost(skeleton, model, measured), model.T_ref_root
    T_part_root = se3.inverse(tree_poses(skeleton, model).parts) @ model.T_ref_root[:, None]
    for k in range(len(skeleton.body_of)):
        root = measured.T_ref_part[:, k] @ T_part_root[:, k]
        cost = _cost(skeleton, replace(model, T_ref_root=root), measured)
        better = (cost < best) & (measured.dimensions[:, k] == 6)
        chosen, best = np.where(better[:, None, None], root, chosen), np.where(better, cost, best)
    return replace(model, T_ref_root=chosen)


def _searched(skeleton: Skeleton, model: TreeModel, measured: Measured) -> TreeModel:
    """The model with each frame's states where residuals with heavy tails are likeliest; damped, frame by frame."""
    damping = np.full(len(model.q), DAMPING_START)
    chi2 = _chi2(skeleton, model, measured)
    for _ in range(ROUNDS):  # each step starts where the last one ended
        weights = (STUDENT_FREEDOMS + measured.dimensions) / (STUDENT_FREEDOMS + chi2) * measured.seen
        found = equations(skeleton, model, measured, weights)
        diagonal = np.diagonal(found.H_ss, axis1=-2, axis2=-1)
        lifted = np.where(diagonal > 0, diagonal * (UNOBSERVED + damping[:, None]), 1.0)
        H = found.H_ss + lifted[..., None] * np.eye(skeleton.states)
        step = np.asarray(-np.linalg.solve(H, found.g_s[..., None])[..., 0], dtype=np.float64)
        tried = with_moved_states(skeleton, model, step)
        tried_chi2 = _chi2(skeleton, tried, measured)
        better = _tails(measured, tried_chi2) <= _tails(measured, chi2)
        model = model.with_states(np.flatnonzero(better), tried.take(np.flatnonzero(better)))
        chi2 = np.where(better[:, None], tried_chi2, chi2)
        damping *= np.where(better, DAMPING_FALL, DAMPING_RISE)
        if not np.any(np.sum(step * found.g_s, axis=-1) < -FOUND):
            break
    return model


def _tails(measured: Measured, chi2: FloatArray) -> FloatArray:
    """(T,) -2 log of Student densities, but for a constant."""
    freedoms = STUDENT_FREEDOMS + measured.dimensions
    return np.sum(measured.seen * freedoms * np.log1p(chi2 / STUDENT_FREEDOMS), axis=-1)
