"""What was found so far, made a part of the model: the fit's poses where they had been with it.

A large slip pulls the whole tree along, and its residuals are no longer small. So once one is found, the tree's
numbers, the states and the slip itself are improved by the very sums that found it (Gauss-Newton steps), and what
remains is tested again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from station.fit.image.image_fit import ImageFit
from station.fit.image.projection import projected
from station.fit.image.views import COORDINATES
from station.fit.image_checks.changes import taken_out
from station.fit.image_checks.directions import CAMERA, TWIST, Rows, T_part_marker
from station.fit.image_checks.freedoms import Freedoms, key
from station.fit.image_checks.sums import Sums, change_of_states, scene_centre
from station.kinematics import se3
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray

STEPS = 3


@dataclass(frozen=True, eq=False)
class Move:
    """A move that was found.

    Attributes:
        what: among `Sums.columns`: a marker, a part, or the camera.
        profile: (T,) by which it goes, at the frames.
        twist: (6,) of it.
    """

    what: str
    profile: FloatArray
    twist: FloatArray


def model_px(image: ImageFit, moves: Sequence[Move]) -> FloatArray:
    """(N, 8) where the corners are by an image fit's poses, after some moves; rolling shutters are left out."""
    views = image.views
    part = views.part[views.marker]
    poses = image.T_ref_part[views.frame, part]
    mounts = T_part_marker(views.points_m)[views.marker]
    centre = se3.translation(scene_centre(image))
    for move in moves:
        slip = se3.exp(move.profile[views.frame, None] * move.twist)
        kind, _, number = move.what.partition(" ")
        if kind == CAMERA:
            poses = centre @ slip @ se3.inverse(centre) @ poses
        elif kind == "marker":
            own = (views.marker == int(number))[:, None, None]
            poses = np.where(own, poses @ mounts @ slip @ se3.inverse(mounts), poses)
        else:
            poses = np.where((part == int(number))[:, None, None], poses @ slip, poses)
    p_cam = views.points_m[views.marker] @ np.swapaxes(poses[:, :3, :3], -1, -2) + poses[:, None, :3, 3]
    return projected(views.camera, image.numbers, p_cam).reshape(-1, COORDINATES)


def changed(image: ImageFit, T_ref_part: FloatArray, before: Sequence[Move], after: Sequence[Move]) -> ImageFit:
    """The image fit with other poses and moves: the residuals follow."""
    moved = replace(image, T_ref_part=T_ref_part)
    return replace(moved, residual_px=image.residual_px + model_px(image, before) - model_px(moved, after))


def improved(
    tree: KinematicTree,
    image: ImageFit,
    rows: Rows,
    free: Freedoms,
    allowed: Sums,
    added: Sequence[tuple[str, FloatArray]],
    moves: Sequence[Move],
) -> tuple[ImageFit, list[Move]]:
    """One step of all numbers.

    Args:
        tree: that the freedoms are of.
        image: as it is, the moves in its residuals.
        rows: of it.
        free: its freedoms.
        allowed: sums of a fit that may change the moves too, and then what the calibration leaves open.
        added: names and profiles (n,) of all that was allowed for, the moves first.
        moves: that are in the residuals.
    """
    root = taken_out(allowed.PP)
    numbers = root @ (root.T @ allowed.Pr)
    widths = [allowed.columns[what].stop - allowed.columns[what].start for what, _ in added]
    first = len(numbers) - sum(widths)
    states = change_of_states(image, rows, free, allowed, numbers, added)
    poses = _moved_poses(tree, image, free, numbers[: free.by_parameters.shape[-1]], states)
    after = [replace(move, twist=move.twist + numbers[first + TWIST * i :][:TWIST]) for i, move in enumerate(moves)]
    return changed(image, poses, moves, after), after


def _moved_poses(
    tree: KinematicTree, image: ImageFit, free: Freedoms, shared: FloatArray, states: FloatArray
) -> FloatArray:
    """(T, K, 4, 4) after changes of the shared numbers (n,) and of the states (T, s), along the tree."""
    parts, old = image.views.parts, image.T_ref_part
    columns = free.columns

    def pose(body: str) -> FloatArray:
        return old[:, parts.index(body)] if body in parts else se3.identity(len(old))

    def turn(name: str, twists: FloatArray) -> FloatArray:
        return twists[..., columns[name]] if name in columns else np.zeros((*twists.shape[:-1], TWIST))

    new: dict[str, FloatArray] = {}
    for root in tree.tree_roots:
        moving = se3.exp(turn(key("state", root), states)) if key("state", root) in columns else np.eye(4)
        new[root] = se3.exp(turn(key("root", root), shared)) @ pose(root) @ moving
        for joint in tree.outward(root):
            T_parent_child = se3.inverse(pose(joint.parent)) @ pose(joint.child)
            own = free.own_twists[joint.name]
            by_state = own.by_state @ states[:, columns[key("state", joint.child)], None]
            by_form = own.by_form @ shared[columns[key("form", joint.name)], None]
            new[joint.child] = (
                new[joint.parent]
                @ se3.exp(shared[columns[key("near", joint.name)]])
                @ T_parent_child
                @ se3.exp((by_state + by_form)[..., 0])
                @ se3.exp(shared[columns[key("far", joint.name)]])
            )
    found = old.copy()
    for k, part in enumerate(parts):
        if part in tree.parts:
            body = tree.body_of(part)
            mount = shared[columns[key("mount", part)]] if key("mount", part) in columns else np.zeros(TWIST)
            found[:, k] = new[body] @ se3.inverse(pose(body)) @ old[:, k] @ se3.exp(mount)
    return found
