"""A tree as the fits of its pairs tell it: what a whole tree's refinement starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.fit.asking import Asking
from station.fit.bodies import Bodies, Group, oriented_pairs
from station.fit.comparison import fit_pairs
from station.fit.known_joints import KnownJoints
from station.fit.noise import INLIER_ABOVE
from station.fit.options import FitOptions
from station.fit.pair_fits import PairFits
from station.fit.selection import Scores, continuous_states
from station.fit.skeleton import Skeleton, TreeJoint, TreeModel
from station.fit.structure import outward
from station.fit.tree_motion import tree_poses
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames, JointType
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

REFERENCE = 0  # the log's reference frame is the first of all parts while fitting


@dataclass(frozen=True, eq=False)
class Structure:
    """Parts (reference first) with their noise, groups of them, the groups' bodies, the forest's edges (E, 2), joints
    of the bodies' pairs as the comparison left them, and the fits of those edges that it fitted to all frames.
    """

    parts: Bodies
    groups: tuple[Group, ...]
    bodies: Bodies
    edges: IntArray
    known: KnownJoints
    fitted: PairFits | None


@dataclass(frozen=True, eq=False)
class TreeStart:
    """A tree with its first numbers.

    Attributes:
        bodies: of the structure; the skeleton's are numbered in this order.
        parts: of the structure, in the skeleton's order; the reference frame is none.
        skeleton: hangs from the reference frame if that is in the tree, so that what stands still has one pose.
        model: the pairs' joints and states.
        scores: of the joints' types, a row for each joint.
    """

    bodies: tuple[int, ...]
    parts: tuple[int, ...]
    skeleton: Skeleton
    model: TreeModel
    scores: Scores


def tree_start(structure: Structure, root: int, options: FitOptions) -> Asking[TreeStart]:
    """The tree of the body `root`, its joints told from there outward."""
    order = [(a, b) for a, b, _ in outward(root, structure.edges)]
    still = next((k for k in (root, *(b for _, b in order)) if REFERENCE in structure.groups[k].members), None)
    inward = [(a, b) for a, b, _ in outward(root if still is None else still, structure.edges)]
    names = [(a, b) if (a, b) in order else (b, a) for a, b in inward]
    bodies = (root if still is None else still, *(b for _, b in inward))
    joints = yield from _pair_joints(structure, names, options)
    number = {k: body for body, k in enumerate(bodies)}
    tree_joints = tuple(
        TreeJoint(number[parent], number[child], kind, turned=(parent, child) != pair)
        for (parent, child), pair, kind in zip(names, inward, joints.types, strict=True)
    )
    parts, skeleton = _skeleton(structure, bodies, tree_joints, root_moves=still is None)
    of_part = {part: group.mounts[i] for group in structure.groups for i, part in enumerate(group.members)}
    mounts = np.stack([of_part[part] for part in parts])
    model = TreeModel(se3.identity(len(structure.bodies.seen)), joints.frames, joints.q, mounts)
    if skeleton.root_moves:
        model = _with_root(structure, bodies, skeleton, model)
    return TreeStart(bodies, parts, skeleton, model, joints.scores)


@dataclass(frozen=True, eq=False)
class _PairJoints:
    """Joints as their pairs alone tell them: types, frames, states (T, sum of s), and scores with a row for each."""

    types: tuple[JointType, ...]
    frames: tuple[JointFrames, ...]
    q: FloatArray
    scores: Scores


def _pair_joints(structure: Structure, names: Sequence[tuple[int, int]], options: FitOptions) -> Asking[_PairJoints]:
    """Each joint's likeliest movable type; a pair is fitted from the body that has orientations."""
    bodies = structure.bodies
    pairs = np.array(names, dtype=np.intp).reshape(-1, 2)
    found = yield from _fitted_pairs(structure, pairs, options)
    movable = [name for name in options.joint_types if JOINT_TYPES[name].states] or list(options.joint_types)
    types: list[JointType] = []
    frames: list[JointFrames] = []
    states = [np.zeros((len(bodies.seen), 0))]
    for i, fit in enumerate(found.likeliest(movable)):  # joints are few
        inner, q = fit.model.frames.take(0), _filled(continuous_states(fit)[0], fit.inlier[0] > INLIER_ABOVE)
        if found.pairs[i, 0] != pairs[i, 0]:
            inner, q, _ = fit.joint.reversed(inner, q, np.zeros((*q.shape, 0)))
        types.append(fit.joint)
        frames.append(inner)
        states.append(q)
    return _PairJoints(tuple(types), tuple(frames), np.concatenate(states, axis=-1), found.scores)


def _fitted_pairs(structure: Structure, pairs: IntArray, options: FitOptions) -> Asking[PairFits]:
    """All types fitted to all frames of pairs (P, 2), each in some order of its bodies: as far as that was done before,
    it is not done again.
    """
    found = [] if structure.fitted is None else [structure.fitted.of(pairs)]
    there = {frozenset(pair) for each in found for pair in each.pairs.tolist()}
    left = pairs[[frozenset(pair) not in there for pair in pairs.tolist()]]
    if len(left):
        asked = oriented_pairs(structure.bodies, left)
        more = yield from fit_pairs(structure.bodies, asked, options.joint_types, options.criterion, structure.known)
        found.append(more)
    return PairFits.all_of(found).of(pairs)


def _filled(q: FloatArray, good: BoolArray) -> FloatArray:
    """States (T, s), those that are not good interpolated."""
    rows = np.flatnonzero(good)
    if not rows.size:
        return np.zeros_like(q)
    at, found = np.arange(len(q)), np.empty_like(q)
    for i in range(q.shape[-1]):  # states of a joint are few
        found[:, i] = np.interp(at, rows, q[rows, i])
    return found


def _skeleton(
    structure: Structure, bodies: Sequence[int], joints: tuple[TreeJoint, ...], *, root_moves: bool
) -> tuple[tuple[int, ...], Skeleton]:
    """The tree's parts, and its skeleton with bodies and parts numbered within it."""
    parts: list[int] = []
    body_of: list[int] = []
    free: list[bool] = []
    for body, k in enumerate(bodies):
        members = [part for part in structure.groups[k].members if part != REFERENCE]
        parts += members
        body_of += [body] * len(members)
        holds_reference = REFERENCE in structure.groups[k].members
        free += [holds_reference or i > 0 for i in range(len(members))]
    return tuple(parts), Skeleton(joints, tuple(body_of), tuple(free), root_moves)


def _with_root(structure: Structure, bodies: Sequence[int], skeleton: Skeleton, model: TreeModel) -> TreeModel:
    """The model with a pose (T, 4, 4) of its root, told by the first body that was seen in each frame; else those of
    the frame before.
    """
    found = np.full((len(model.q), 4, 4), np.nan)
    chains = tree_poses(skeleton, model).bodies
    for chain, body in reversed(list(zip(chains, bodies, strict=True))):  # the root itself last: it is the best
        seen = structure.bodies.oriented[:, body]
        found[seen] = (structure.bodies.T_ref_body[:, body] @ se3.inverse(chain))[seen]
    known = np.flatnonzero(~np.isnan(found[:, 0, 0]))
    nearest = known[np.clip(np.searchsorted(known, np.arange(len(found)), side="right") - 1, 0, None)]
    return TreeModel(found[nearest], model.frames, model.q, model.mounts)
