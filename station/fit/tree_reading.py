"""Fits a whole tree from what the pairs told, and reads its joints as they hang from the root."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.bodies import Bodies, Group
from station.fit.comparison import fit_pairs
from station.fit.noise import INLIER_ABOVE
from station.fit.options import FitOptions
from station.fit.pairwise import JointFit, residuals
from station.fit.reading import JointReading
from station.fit.selection import Scores, continuous_states
from station.fit.structure import outward
from station.fit.whole_tree import Skeleton, TreeFit, TreeModel, body_poses, measured_parts, refine_tree
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames, JointType
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

REFERENCE = 0  # the log's reference frame is the first of all parts while fitting


@dataclass(frozen=True, eq=False)
class Structure:
    """Parts (reference first) with their noise, groups of them, the groups' bodies, and the forest's edges (E, 2)."""

    parts: Bodies
    groups: tuple[Group, ...]
    bodies: Bodies
    edges: IntArray


def named_member(group: Group, *, include: bool) -> int:
    """Which member names the body: the first, but the reference frame only if it is a part or alone."""
    return 1 if group.members[0] == REFERENCE and not include and len(group.members) > 1 else 0


@dataclass(frozen=True, eq=False)
class _Start:
    """A tree as the pairs tell it, from the inner root outward: bodies, joints, their fits."""

    bodies: list[int]
    order: list[tuple[int, int]]
    fits: list[JointFit]
    scores: Scores


def read_tree(
    structure: Structure, root: int, options: FitOptions, *, include: bool
) -> list[tuple[int, int, JointReading, Scores, int]]:
    """(parent, child, reading, scores, row of the scores) of each joint of a tree, from the root outward.

    Inside, the tree hangs from the reference frame if that is in it, so that what stands still has one pose.
    """
    tree = [root, *(b for _, b, _ in outward(root, structure.edges))]
    still = [k for k in tree if REFERENCE in structure.groups[k].members]
    start = _start(structure, still[0] if still else root, options)
    if not start.order:
        return []
    parts, skeleton = _skeleton(structure, start, root_moves=not still)
    fit = refine_tree(skeleton, _first_model(structure, start, parts, skeleton), measured_parts(structure.parts, parts))
    found: list[tuple[int, int, JointReading, Scores, int]] = []
    for a, b, _ in outward(root, structure.edges):  # joints are few
        j = next(i for i, pair in enumerate(start.order) if set(pair) == {a, b})
        reading = _reading(structure, start, skeleton, parts, fit, j, outer=(a, b), include=include)
        found.append((a, b, reading.settled(), start.scores, j))
    return found


def _start(structure: Structure, root: int, options: FitOptions) -> _Start:
    order = [(a, b) for a, b, _ in outward(root, structure.edges)]
    bodies = [root, *(b for _, b in order)]
    if not order:
        return _Start(bodies, order, [], Scores(options.criterion, {}, np.zeros(0), np.zeros(0, dtype=bool)))
    fits, scores, _ = fit_pairs(
        structure.bodies, np.array(order, dtype=np.intp), options.joint_types, options.criterion
    )
    movable = [name for name in options.joint_types if JOINT_TYPES[name].states] or list(options.joint_types)
    best = [min(movable, key=lambda name, i=i: float(scores.by_type[name][i])) for i in range(len(order))]
    return _Start(bodies, order, [fits[name].take(np.array([i])) for i, name in enumerate(best)], scores)


def _skeleton(structure: Structure, start: _Start, *, root_moves: bool) -> tuple[list[int], Skeleton]:
    """The tree's parts, and its skeleton with bodies and parts numbered within it."""
    parts: list[int] = []
    body_of: list[int] = []
    free: list[bool] = []
    for body, k in enumerate(start.bodies):
        members = [part for part in structure.groups[k].members if part != REFERENCE]
        parts += members
        body_of += [body] * len(members)
        holds_reference = REFERENCE in structure.groups[k].members
        free += [holds_reference or i > 0 for i in range(len(members))]
    number = {k: body for body, k in enumerate(start.bodies)}
    joints = tuple((number[a], number[b], fit.joint) for (a, b), fit in zip(start.order, start.fits, strict=True))
    return parts, Skeleton(joints, tuple(body_of), tuple(free), root_moves)


def _first_model(structure: Structure, start: _Start, parts: list[int], skeleton: Skeleton) -> TreeModel:
    T = len(structure.bodies.seen)
    frames = tuple(fit.model.frames.take(0) for fit in start.fits)
    q = np.stack(
        [_filled(continuous_states(fit)[0, :, 0], fit.inlier[0] > INLIER_ABOVE) for fit in start.fits], axis=-1
    )
    of_part = {part: group.mounts[i] for group in structure.groups for i, part in enumerate(group.members)}
    mounts = np.stack([of_part[part] for part in parts])
    model = TreeModel(se3.identity(T), frames, q, mounts)
    return (
        TreeModel(_first_root(structure, start, skeleton, model), frames, q, mounts) if skeleton.root_moves else model
    )


def _filled(q: FloatArray, good: BoolArray) -> FloatArray:
    """States (T,), those that are not good interpolated."""
    rows = np.flatnonzero(good)
    return np.interp(np.arange(len(q)), rows, q[rows]) if rows.size else np.zeros_like(q)


def _first_root(structure: Structure, start: _Start, skeleton: Skeleton, model: TreeModel) -> FloatArray:
    """(T, 4, 4) root poses told by the first body that was seen in each frame; else those of the frame before."""
    chains = body_poses(skeleton, model)
    found = np.full((len(model.q), 4, 4), np.nan)
    for chain, body in reversed(list(zip(chains, start.bodies, strict=True))):  # the root itself last: it is the best
        seen = structure.bodies.oriented[:, body]
        found[seen] = (structure.bodies.T_ref_body[:, body] @ se3.inverse(chain))[seen]
    known = np.flatnonzero(~np.isnan(found[:, 0, 0]))
    nearest = known[np.clip(np.searchsorted(known, np.arange(len(found)), side="right") - 1, 0, None)]
    return found[nearest]


def _reading(
    structure: Structure,
    start: _Start,
    skeleton: Skeleton,
    parts: list[int],
    fit: TreeFit,
    j: int,
    *,
    outer: tuple[int, int],
    include: bool,
) -> JointReading:
    """A joint between the naming parts of two bodies; turned round if the outer tree has it the other way."""
    a, b = outer
    inner, kind, along_q = fit.model.frames[j], skeleton.joints[j][2], fit.model.q[:, j]
    to_axis = np.zeros((6, skeleton.parameters))
    columns = range(*skeleton.joint_columns(j).indices(skeleton.parameters))
    split = len(kind.axis_freedoms)
    frames = inner
    if start.order[j] == outer:
        to_axis[list(kind.axis_freedoms), columns[:split]] = 1.0
    else:  # T_child_parent = C^-1 exp(-q screw) F^-1
        to_axis[list(kind.child_freedoms), columns[split:]] = -1.0
        frames = JointFrames(se3.inverse(inner.T_axis_child), se3.inverse(inner.T_parent_axis), inner.form)
        along_q = -along_q
    offset_a, offset_b = (_naming_mount(structure, k, parts, fit, include=include) for k in outer)
    frames = JointFrames(se3.inverse(offset_a) @ frames.T_parent_axis, frames.T_axis_child @ offset_b, frames.form)
    naming = structure.groups[a].members[named_member(structure.groups[a], include=include)]
    if naming in parts and skeleton.free_mount[parts.index(naming)]:
        to_axis[:, skeleton.mount_columns(parts.index(naming))] -= se3.adjoint(se3.inverse(frames.T_parent_axis))
    good_a, good_b = (_told(structure, k, parts, fit) for k in outer)
    seen = structure.bodies.oriented[:, a] & structure.bodies.seen[:, b]
    residual = _relative_residual(structure, kind, frames, along_q, outer, (offset_a, offset_b))
    good = seen & good_a & good_b
    return JointReading(
        type=kind,
        frames=frames,
        covariance=to_axis @ fit.covariance @ to_axis.T,
        q=along_q,
        std=fit.state_std[:, j],
        seen=seen,
        good=good,
        residual=residual,
        oriented=good & structure.bodies.oriented[:, b],
    )


def _naming_mount(structure: Structure, k: int, parts: list[int], fit: TreeFit, *, include: bool) -> FloatArray:
    """(4, 4) pose of the naming part in its body's frame, as refined."""
    group = structure.groups[k]
    member = named_member(group, include=include)
    part = group.members[member]
    return fit.model.mounts[parts.index(part)] if part in parts else group.mounts[member]


def _told(structure: Structure, k: int, parts: list[int], fit: TreeFit) -> BoolArray:
    """(T,) some part of a body was seen and is no outlier; always for what stands still."""
    members = structure.groups[k].members
    if REFERENCE in members:
        return np.ones(len(fit.inlier), dtype=bool)
    return fit.inlier[:, [parts.index(part) for part in members]].max(axis=1) > INLIER_ABOVE


def _relative_residual(
    structure: Structure,
    kind: JointType,
    frames: JointFrames,
    q: FloatArray,
    outer: tuple[int, int],
    offsets: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """(T, 6) of the fused relative pose of two bodies' naming parts against the joint."""
    T_a, T_b = (structure.bodies.T_ref_body[:, k] @ offset for k, offset in zip(outer, offsets, strict=True))
    return residuals(
        se3.inverse(T_a) @ T_b, frames.T_parent_axis @ kind.axis_motion(q[:, None], frames.form) @ frames.T_axis_child
    )
