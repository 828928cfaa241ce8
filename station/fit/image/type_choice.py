"""Joints of a type that need not be: what looks like a ball to coarse poses is a hinge where its corners say no more.

A type that is a case of another one has fewer numbers. Where a joint's states go as one of that type would, the tree is
fitted to the corners again with it, and stays so if the corners are no farther off than chance explains, and what a
detector errs by at least.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import TypeVar

import numpy as np

from station.fit.image.corner_data import costs_of_squares
from station.fit.image.detector_errors import DETECTOR_PX
from station.fit.image.refinement import Refined
from station.fit.image.views import COORDINATES
from station.fit.skeleton import Skeleton, TreeModel
from station.fit.tree_motion import tree_poses
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointFrames, JointType
from station.logs import FloatArray

Item = TypeVar("Item")

# Standard deviations of chi squared by which a simpler type may exceed its mean.
CHANCE_SIGMAS = 4.0
# Types by which a body's place and turns are farther off, at the median, aren't tried.
NEAR_PX = 3.0

Refining = Callable[[Skeleton, TreeModel], Refined]


def with_simpler_types(
    skeleton: Skeleton, found: Refined, joint_types: Collection[str], refining: Refining
) -> tuple[Skeleton, Refined]:
    """The tree with each joint of the simplest type that explains the corners as well.

    Args:
        skeleton: of the tree.
        found: as refined on corners.
        joint_types: the candidates.
        refining: a tree on the same corners, from a start.
    """
    for j, joint in enumerate(skeleton.joints):
        for name in joint.type.simpler:
            start = _with_type(skeleton, found, j, JOINT_TYPES[name]) if name in joint_types else None
            if start is None:
                continue
            refined = refining(*start)
            if _is_as_likely(refined, found, start[0].parameters - skeleton.parameters):
                skeleton, found = start[0], refined
                break
    return skeleton, found


def _with_type(skeleton: Skeleton, found: Refined, j: int, kind: JointType) -> tuple[Skeleton, TreeModel] | None:
    """The tree with one of its joints of another type, as near to what was found as can be; None if that isn't near."""
    model, joint = found.fit.model, skeleton.joints[j]
    poses = tree_poses(skeleton, model)
    T_parent_child = se3.inverse(poses.bodies[joint.parent]) @ poses.bodies[joint.child]
    known = np.asarray(np.isfinite(found.fit.state_covariance[j]).all(axis=(-2, -1)), dtype=bool)
    weights = np.asarray(known, dtype=np.float64)
    if not known.any():
        return None
    starts = [_start(kind, frames, T_parent_child) for frames in kind.starts(T_parent_child, weights)]
    off_m = [_off_m(found, kind, start, T_parent_child)[known] for start in starts]
    best = int(np.argmin([np.median(off) for off in off_m]))
    depth_m = poses.bodies[joint.child][known, 2, 3]
    if np.median(off_m[best] * found.image.views.camera.matrix[0, 0] / depth_m) > NEAR_PX:
        return None
    frames, q = starts[best]
    columns = skeleton.state_columns(j)
    return (
        replace(skeleton, joints=_replaced(skeleton.joints, j, replace(joint, type=kind))),
        replace(
            model,
            frames=_replaced(model.frames, j, frames),
            q=np.concatenate([model.q[:, : columns.start], q, model.q[:, columns.stop :]], axis=-1),
        ),
    )


def _replaced(items: tuple[Item, ...], at: int, item: Item) -> tuple[Item, ...]:
    return (*items[:at], item, *items[at + 1 :])


def _start(kind: JointType, frames: JointFrames, T_parent_child: FloatArray) -> tuple[JointFrames, FloatArray]:
    """A joint and its states (T, s)."""
    T_axis_child = se3.inverse(frames.T_parent_axis) @ T_parent_child
    return frames, kind.continuous(kind.axis_state(T_axis_child, frames.T_axis_child, frames.form))


def _off_m(
    found: Refined, kind: JointType, start: tuple[JointFrames, FloatArray], T_parent_child: FloatArray
) -> FloatArray:
    """(T,) by which the corners of a marker about the child's origin would be elsewhere by a joint, at most."""
    frames, q = start
    T = frames.T_parent_axis @ kind.axis_motion(q, frames.form) @ frames.T_axis_child
    off = se3.log(se3.inverse(T_parent_child) @ T)
    points = found.image.views.points_m
    size_m = float(np.linalg.norm(points - points.mean(axis=1, keepdims=True), axis=-1).max())
    return np.linalg.norm(off[:, :3], axis=-1) + size_m * np.linalg.norm(off[:, 3:], axis=-1)


def _is_as_likely(simpler: Refined, found: Refined, parameters: int) -> bool:
    """Whether corners cost no more, by the noise of the richer tree, than its numbers would explain by chance.

    And than one number that all frames share is worth (Schwarz, 1978): of two types that do, the simpler is likelier.

    Args:
        simpler: with fewer numbers.
        found: with more.
        parameters: how many more of them that all frames share the simpler one has.
    """
    image, other = simpler.image, found.image
    scale = other.scale[other.views.marker]
    squares = image.chi2 * (image.scale[image.views.marker] / scale) ** 2
    dearer = float(np.sum(costs_of_squares(squares) - costs_of_squares(other.chi2)))
    fewer = max(_states(found) - _states(simpler) - parameters, 1)
    variance = np.einsum("nii->n", other.views.covariance_px2) / COORDINATES * scale**2
    repeated = DETECTOR_PX**2 * float(np.sum(1 / variance)) / len(variance)
    price = float(np.log(COORDINATES * len(other.views)))
    return dearer <= fewer * (1 + repeated) + CHANCE_SIGMAS * np.sqrt(2 * fewer) + price


def _states(found: Refined) -> int:
    """Numbers of states that were observed."""
    return sum(int(np.isfinite(np.einsum("tii->ti", each)).sum()) for each in found.fit.state_covariance)
