"""What a fit can do about corners by itself: how each part moves with its tree's numbers.

A joint's geometry is, whatever its type, a twist that is fixed to the body before it and one that is fixed to the body
behind, less what its state can do: for a hinge 6 + 6 - 2 of these 12 that the state or the other one does, and one
more that both do, which leaves its 9. Nothing is lost by telling all 12: what two columns do both is taken out once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from station.fit.image.image_fit import ImageFit
from station.kinematics import se3
from station.kinematics.tree import Joint, KinematicTree
from station.logs import FloatArray

# A root that moves less than this [m, and as an entry of its rotation] stands still: its pose is one for all frames.
STILL = 1e-9


@dataclass(frozen=True, eq=False)
class OwnTwists:
    """Twists of a joint's child, in its own frame: (6, s) by its state, (T, 6, m) by its form."""

    by_state: FloatArray
    by_form: FloatArray


@dataclass(frozen=True, eq=False)
class Freedoms:
    """Right perturbations of the poses of K parts in T frames.

    Attributes:
        by_states: (T, K, 6, s) by numbers that each frame has of its own.
        by_parameters: (T, K, 6, n) by those that all frames share.
        columns: of each root, joint and part in `by_parameters`, then in `by_states`, see `key`.
        own_twists: of each joint.
    """

    by_states: FloatArray
    by_parameters: FloatArray
    columns: Mapping[str, slice]
    own_twists: Mapping[str, OwnTwists]


def key(kind: str, name: str) -> str:
    """Name of some columns: "root" and "state" of a body; "near", "far" and "form" of a joint; "mount" of a part."""
    return f"{kind} {name}"


def freedoms(tree: KinematicTree, image: ImageFit) -> Freedoms:
    """How the parts of an image fit move with its tree's numbers; NaN where poses are."""
    seen, found = _Bodies(tree, image), _Columns(image.T_ref_part.shape[:2])
    for root in tree.tree_roots:
        below = seen.parts_beyond(root)
        if not below.any() or root not in image.views.parts:  # the reference itself
            continue
        still = seen.is_still(root)
        frame = se3.identity(len(image.T_ref_part)) if still else seen.pose(root)
        found.add(key("root" if still else "state", root), seen.moved(frame, np.eye(6), below), shared=still)
    own_twists = {joint.name: _own_twists(joint, seen) for joint in tree.joints}
    for joint in tree.joints:
        below, child = seen.parts_beyond(joint.child), seen.pose(joint.child)
        own = own_twists[joint.name]
        found.add(key("near", joint.name), seen.moved(seen.pose(joint.parent), np.eye(6), below), shared=True)
        found.add(key("far", joint.name), seen.moved(child, np.eye(6), below), shared=True)
        found.add(key("form", joint.name), seen.moved(child, own.by_form, below), shared=True)
        found.add(key("state", joint.child), seen.moved(child, own.by_state, below), shared=False)
    for k, part in enumerate(image.views.parts):
        if part in tree.parts and tree.body_of(part) != part:
            only = np.arange(len(image.views.parts)) == k
            found.add(key("mount", part), seen.moved(image.T_ref_part[:, k], np.eye(6), only), shared=True)
    return found.freedoms(own_twists)


class _Columns:
    """Columns that are put together."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        nothing = np.zeros((*shape, 6, 0))
        self._blocks: dict[bool, list[FloatArray]] = {True: [nothing], False: [nothing]}
        self._columns: dict[str, slice] = {}

    def add(self, name: str, twists: FloatArray, *, shared: bool) -> None:
        start = sum(block.shape[-1] for block in self._blocks[shared])
        self._columns[name] = slice(start, start + twists.shape[-1])
        self._blocks[shared].append(twists)

    def freedoms(self, own_twists: Mapping[str, OwnTwists]) -> Freedoms:
        by_states, by_parameters = (np.concatenate(self._blocks[shared], axis=-1) for shared in (False, True))
        return Freedoms(by_states, by_parameters, self._columns, own_twists)


def _own_twists(joint: Joint, seen: _Bodies) -> OwnTwists:
    kind = joint.kind
    frames = kind.frames(joint.geometry)
    to_child = se3.adjoint(se3.inverse(frames.T_axis_child))
    form = np.zeros((len(seen.pose(joint.child)), 6, 0))
    if kind.form_freedoms:
        T_parent_child = se3.inverse(seen.pose(joint.parent)) @ seen.pose(joint.child)
        q = kind.inverse(joint.geometry, T_parent_child)
        form = to_child @ kind.form_twists(q.reshape(len(q), kind.states), frames.form)
    return OwnTwists(to_child @ kind.state_twists(frames.form), form)


class _Bodies:
    """Poses of a tree's bodies in the reference, and which parts hang from them."""

    def __init__(self, tree: KinematicTree, image: ImageFit) -> None:
        self._tree, self._image = tree, image
        self._to_part = se3.adjoint(se3.inverse(image.T_ref_part))

    def pose(self, body: str) -> FloatArray:
        """(T, 4, 4); the identity of the reference itself."""
        parts, poses = self._image.views.parts, self._image.T_ref_part
        return poses[:, parts.index(body)] if body in parts else se3.identity(len(poses))

    def is_still(self, body: str) -> bool:
        T = self.pose(body)
        known = T[np.isfinite(T).all(axis=(1, 2))]
        return bool(np.ptp(known, axis=0).max(initial=0.0) < STILL) if len(known) else True

    def parts_beyond(self, body: str) -> np.ndarray:
        """(K,) parts that are on a body or hang from it."""
        bodies = {body, *(joint.child for joint in self._tree.outward(body))}
        known = set(self._tree.parts)
        return np.array([p in known and self._tree.body_of(p) in bodies for p in self._image.views.parts], dtype=bool)

    def moved(self, T_ref_body: FloatArray, twists: FloatArray, parts: np.ndarray) -> FloatArray:
        """(T, K, 6, n) twists of the given parts by twists (..., 6, n) fixed to a body; the others stay."""
        found = np.zeros((*self._image.T_ref_part.shape[:2], 6, twists.shape[-1]))
        found[:, parts] = self._to_part[:, parts] @ (se3.adjoint(T_ref_body) @ twists)[:, None]
        return found
