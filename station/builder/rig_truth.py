"""What a fit of a drawn rig's capture should find: the drawn tree, told by the markers that are tracked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from station.builder.draft import Draft, unused
from station.builder.edits import moved_joint, upright
from station.kinematics import se3
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray
from station.simulate.placing import layout

# Letters that tell markers of one part apart, as in the packaged rigs: `seat`, `seat_b`.
LETTERS = "bcdefghijklmnopqrstuvwxyz"


def bodies(draft: Draft) -> dict[str, str]:
    """The part that each part is fixed to by rigid joints, as the simulator folds them; itself if by none."""
    folded = layout(draft.tree)
    return {part: folded.tree.bodies[body] for part, body in zip(draft.tree.parts, folded.body, strict=True)}


def tracked_names(draft: Draft) -> list[str]:
    """A tracked part for each marker: the first on a part has the part's name, others a letter more."""
    names: list[str] = []
    for row, marker in enumerate(draft.markers):
        before = sum(other.part == marker.part for other in draft.markers[:row])
        letter = LETTERS[before - 1] if before <= len(LETTERS) else str(before + 1)
        stem = f"{marker.part}_{letter}"
        names.append(unused(stem, [*draft.tree.parts, *names]) if before else marker.part)
    return names


def tracked_tree(draft: Draft) -> KinematicTree:
    """The draft's tree as a tracker of its markers sees it.

    Each tracked part's frame is its marker's; a body is named by its first marker, the others are in its rigid group.

    Args:
        draft: with a marker on each body.
    """
    body_of, names = bodies(draft), tracked_names(draft)
    zero = draft.tree.forward(np.zeros(len(draft.tree.columns)))
    on_body: dict[str, list[str]] = {}
    mounts: dict[str, FloatArray] = {}
    for marker, name in zip(draft.markers, names, strict=True):
        body = body_of[marker.part]
        on_body.setdefault(body, []).append(name)
        mounts.setdefault(body, se3.inverse(zero[body]) @ zero[marker.part] @ marker.mount)
    joints = [
        replace(
            moved_joint(joint, se3.inverse(mounts[joint.parent])),
            parent=on_body[joint.parent][0],
            child=on_body[joint.child][0],
            T_parent_child_zero=upright(
                se3.inverse(mounts[joint.parent]) @ joint.T_parent_child_zero @ mounts[joint.child]
            ),
        )
        for joint in layout(draft.tree).tree.joints
    ]
    return KinematicTree(
        root=on_body[body_of[draft.tree.root]][0],
        parts=tuple(names),
        rigid_groups=tuple(tuple(group) for group in on_body.values() if len(group) > 1),
        trees=(tuple(group[0] for group in on_body.values()),),
        joints=tuple(joints),
    )
