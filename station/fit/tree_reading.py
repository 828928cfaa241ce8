"""Fits a whole tree from what the pairs told, and reads its joints as they hang from the root."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from station.fit.asking import Asking
from station.fit.bodies import Group
from station.fit.image.camera_numbers import unknowns
from station.fit.image.image_fit import ImageFit
from station.fit.image.refinement import Refined, refine_image
from station.fit.image.type_choice import with_simpler_types
from station.fit.image.views import Views
from station.fit.noise import INLIER_ABOVE
from station.fit.options import FitOptions
from station.fit.pairwise import residuals
from station.fit.reading import JointReading
from station.fit.rigid_pairs import RigidPairs
from station.fit.selection import Scores
from station.fit.skeleton import Skeleton, TreeModel
from station.fit.structure import outward
from station.fit.tree_motion import tree_poses
from station.fit.tree_residuals import measured_parts
from station.fit.tree_start import REFERENCE, Structure, TreeStart, tree_start
from station.fit.whole_tree import TreeFit, refine_tree
from station.kinematics import se3
from station.kinematics.joints import JointFrames, JointType
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

__all__ = ["REFERENCE", "Structure", "TreeReading", "named_member", "read_tree"]


def named_member(group: Group, *, include: bool) -> int:
    """Which member names the body: the first, but the reference frame only if it is a part or alone."""
    return 1 if group.members[0] == REFERENCE and not include and len(group.members) > 1 else 0


@dataclass(frozen=True, eq=False)
class _Refined:
    """A tree, its start, its fit, where its parts were seen (T, K), and whether the reference is a part of its own."""

    structure: Structure
    start: TreeStart
    fit: TreeFit
    part_seen: BoolArray
    include: bool

    def group(self, body: int) -> Group:
        """Members of one of the skeleton's bodies."""
        return self.structure.groups[self.start.bodies[body]]

    def naming_part(self, body: int) -> int | None:
        """Which of the skeleton's parts gives a body its name; None for the reference frame."""
        group = self.group(body)
        part = group.members[named_member(group, include=self.include)]
        return self.start.parts.index(part) if part in self.start.parts else None

    def naming_mount(self, body: int) -> FloatArray:
        """(4, 4) pose of the naming part in its body's frame, as refined."""
        part = self.naming_part(body)
        return np.eye(4) if part is None else self.fit.model.mounts[part]

    def members(self, body: int) -> list[int]:
        """The skeleton's parts of a body, without the reference frame."""
        return [k for k, other in enumerate(self.start.skeleton.body_of) if other == body]

    def seen(self, body: int) -> BoolArray:
        """(T,) some part of a body was seen; always for what stands still."""
        if REFERENCE in self.group(body).members:
            return np.ones(len(self.fit.inlier), dtype=bool)
        return np.any(self.part_seen[:, self.members(body)], axis=1)

    def told(self, body: int) -> BoolArray:
        """(T,) some part of a body was seen and is no outlier; always for what stands still."""
        if REFERENCE in self.group(body).members:
            return np.ones(len(self.fit.inlier), dtype=bool)
        return np.any(self.fit.inlier[:, self.members(body)] > INLIER_ABOVE, axis=1)


@dataclass(frozen=True, eq=False)
class TreeReading:
    """What a tree's fit tells.

    Attributes:
        joints: (parent, child, reading, scores, row of the scores) of each, from the root outward; ends are bodies.
        mounts: T_body_part (4, 4) of further trackers by part, in the frames of the bodies' naming parts.
        image: the corners against the tree, if it was refined on them.
        rigid: parts that the corners say to be rigid to each other, or to the reference, though the tree has a joint
            between them, or lets them move.
    """

    joints: tuple[tuple[int, int, JointReading, Scores, int], ...]
    mounts: Mapping[int, FloatArray]
    image: ImageFit | None = None
    rigid: RigidPairs = field(default_factory=RigidPairs)


def read_tree(
    structure: Structure, root: int, options: FitOptions, views: Views | None, *, include: bool
) -> Asking[TreeReading]:
    """The joints of a tree from the root outward, and where further trackers sit on its bodies.

    The tree is fitted to the poses, and to the corners too if there are views of its parts.
    """
    order = [(a, b) for a, b, _ in outward(root, structure.edges)]
    if not order:
        group = structure.groups[root]
        return TreeReading((), _mounts(group, group.members, group.mounts, include=include))
    start: TreeStart = yield from tree_start(structure, root, options)
    fit = refine_tree(
        start.skeleton,
        start.model,
        lambda parts: measured_parts(structure.parts, [start.parts[k] for k in parts]),
        move=options.refine != "none",
    )
    image, rigid, seen = None, RigidPairs(), structure.parts.seen[:, list(start.parts)]
    if views is not None:
        start, found = _refined_on_corners(structure, start, fit, views, options)
        fit, image, seen = found.fit, found.image, _seen(found.image.views)
        rigid = _rigid(structure, start, found, options)
    refined = _Refined(structure, start, fit, seen, include)
    names = [(start.bodies[joint.parent], start.bodies[joint.child]) for joint in start.skeleton.joints]
    rows = [names.index(pair) for pair in order]
    joints = [(a, b, _reading(refined, j).settled(), start.scores, j) for (a, b), j in zip(order, rows, strict=True)]
    mounts: dict[int, FloatArray] = {}
    for k in start.bodies:
        mounts |= _mounts(structure.groups[k], start.parts, fit.model.mounts, include=include)
    return TreeReading(tuple(joints), mounts, image, rigid)


def _refined_on_corners(
    structure: Structure, start: TreeStart, fit: TreeFit, views: Views, options: FitOptions
) -> tuple[TreeStart, Refined]:
    """The tree, with joints of the simplest types that explain the corners, and its fit."""
    names = tuple(structure.parts.names[k] for k in start.parts)
    unknown = unknowns(views.camera, views.readout_s, options.camera_numbers)

    def refining(skeleton: Skeleton, model: TreeModel) -> Refined:
        return refine_image(skeleton, model, names, views, unknown)

    found = refining(start.skeleton, fit.model)
    skeleton, found = with_simpler_types(start.skeleton, found, options.joint_types, refining)
    return replace(start, skeleton=skeleton), found


def _rigid(structure: Structure, start: TreeStart, found: Refined, options: FitOptions) -> RigidPairs:
    """What rests, as pairs of parts, where rigid joints and a root that stands still are for the fit to find."""
    ends: list[tuple[int | None, int | None]] = []
    if "rigid" in options.joint_types:
        joints = [start.skeleton.joints[j] for j in found.rest.joints]
        ends += [(_first_part(start, joint.near), _first_part(start, joint.far)) for joint in joints]
        ends += [(_first_part(start, a), _first_part(start, b)) for a, b in found.rest.pairs]
    if options.root_static is None:
        ends += [(None, _first_part(start, body)) for body in found.rest.bodies]
    poses = tree_poses(start.skeleton, found.fit.model).parts
    known = np.isfinite(found.image.T_ref_part[..., 0, 0])
    pairs: list[list[int]] = []
    relative: list[FloatArray] = []
    for a, b in ends:
        if b is None or not (both := known[:, b] & (a is None or known[:, a])).any():
            continue
        T_a = se3.identity(len(poses)) if a is None else poses[:, a]
        pairs.append([REFERENCE if a is None else start.parts[a], start.parts[b]])
        relative.append(se3.mean((se3.inverse(T_a) @ poses[:, b])[both]))
    return RigidPairs(np.array(pairs, dtype=np.intp).reshape(-1, 2), np.array(relative).reshape(-1, 4, 4))


def _first_part(start: TreeStart, body: int) -> int | None:
    """The skeleton's first part of a body; None for the reference frame alone."""
    return next((k for k, of in enumerate(start.skeleton.body_of) if of == body), None)


def _seen(views: Views) -> BoolArray:
    """(T, K) whether a marker of a part was seen."""
    found = np.zeros((len(views.t_s), len(views.parts)), dtype=bool)
    found[views.frame, views.part[views.marker]] = True
    return found


def _mounts(group: Group, parts: Sequence[int], mounts: FloatArray, *, include: bool) -> dict[int, FloatArray]:
    """T_body_part (4, 4) of a group's members but the one that names it, in that one's frame.

    Args:
        group: of parts.
        parts: P of all parts.
        mounts: (P, 4, 4) of these, in a frame that the members share; the reference frame's is the identity.
        include: whether the reference frame is a part.
    """
    of_part = {REFERENCE: np.eye(4)} | dict(zip(parts, mounts, strict=True))
    naming = group.members[named_member(group, include=include)]
    others = [part for part in group.members if part not in (naming, REFERENCE)]
    return {part: se3.inverse(of_part[naming]) @ of_part[part] for part in others}


def _reading(refined: _Refined, j: int) -> JointReading:
    """A joint between the naming parts of two bodies."""
    skeleton, fit = refined.start.skeleton, refined.fit
    joint, inner = skeleton.joints[j], fit.model.frames[j]
    a, b = joint.parent, joint.child
    offset_a, offset_b = refined.naming_mount(a), refined.naming_mount(b)
    frames = JointFrames(se3.inverse(offset_a) @ inner.T_parent_axis, inner.T_axis_child @ offset_b, inner.form)
    to_axis = np.zeros((6 + len(inner.form), skeleton.parameters))
    columns = range(*skeleton.joint_columns(j).indices(skeleton.parameters))
    to_axis[list(joint.type.axis_freedoms), columns[: len(joint.type.axis_freedoms)]] = 1.0
    to_axis[range(6, len(to_axis)), columns[len(columns) - len(inner.form) :]] = 1.0
    naming = refined.naming_part(a)
    if naming is not None and skeleton.free_mount[naming]:
        to_axis[:6, skeleton.mount_columns(naming)] -= se3.adjoint(se3.inverse(frames.T_parent_axis))
    good = refined.told(a) & refined.told(b)
    if joint.type.states == 1:  # of several states some may be observed
        good &= np.isfinite(fit.state_covariance[j][:, 0, 0])
    q = fit.model.q[:, skeleton.state_columns(j)]
    residual, placed, oriented = _relative_residual(refined, joint.type, frames, q, (a, b))
    return JointReading(
        type=joint.type,
        frames=frames,
        covariance=to_axis @ fit.covariance @ to_axis.T,
        q=q,
        state_covariance=fit.state_covariance[j],
        seen=refined.seen(a) & refined.seen(b),
        good=good,
        residual=residual,
        placed=good & placed,
        oriented=good & oriented,
        spread=fit.spread[refined.members(a) + refined.members(b)].max(axis=0, initial=0.0),
    )


def _relative_residual(
    refined: _Refined, kind: JointType, frames: JointFrames, q: FloatArray, pair: tuple[int, int]
) -> tuple[FloatArray, BoolArray, BoolArray]:
    """(T, 6) of the fused relative pose of two bodies' naming parts against the joint, where there are both (T,), and
    where with the child's orientation (T,).
    """
    bodies = refined.structure.bodies
    a, b = (refined.start.bodies[body] for body in pair)
    T_a, T_b = (bodies.T_ref_body[:, k] @ refined.naming_mount(body) for k, body in zip((a, b), pair, strict=True))
    T_joint = frames.T_parent_axis @ kind.axis_motion(q, frames.form) @ frames.T_axis_child
    placed = bodies.oriented[:, a] & bodies.seen[:, b]
    return residuals(se3.inverse(T_a) @ T_b, T_joint), placed, placed & bodies.oriented[:, b]
