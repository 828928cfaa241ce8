"""Joints that earlier looks at pairs came to: where later looks at the same pairs start.

A pair is looked at several times: in a few frames, in more, with the noise that its parts turned out to have, in all
frames. A closed form or samples tell where the joint is about, and that is sought but once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from station.kinematics.joints import JOINT_TYPES, JointFrames

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class KnownJoints:
    """Joints of P pairs.

    Attributes:
        pairs: (P, 2) bodies, parent first.
        known: (P,) whether there is anything.
        by_pose: (P,) whether it is by orientations too, or by positions alone.
        frames: (P, ...) by type.
    """

    pairs: IntArray
    known: BoolArray
    by_pose: BoolArray
    frames: Mapping[str, JointFrames]

    @staticmethod
    def none(pairs: IntArray, joint_types: Sequence[str]) -> KnownJoints:
        """Of pairs (P, 2) of which nothing is known."""
        T, no = np.tile(np.eye(4), (len(pairs), 1, 1)), np.zeros(len(pairs), dtype=bool)
        frames = {
            name: JointFrames(T, T, np.zeros((len(pairs), JOINT_TYPES[name].form_freedoms))) for name in joint_types
        }
        return KnownJoints(pairs, no, no, frames)

    @staticmethod
    def all_of(some: Sequence[KnownJoints]) -> KnownJoints:
        """Those of pairs one after another; all of the same types."""
        frames = {
            name: JointFrames(
                np.concatenate([each.frames[name].T_parent_axis for each in some]),
                np.concatenate([each.frames[name].T_axis_child for each in some]),
                np.concatenate([each.frames[name].form for each in some]),
            )
            for name in some[0].frames
        }
        pairs, known, by_pose = zip(*((each.pairs, each.known, each.by_pose) for each in some), strict=True)
        return KnownJoints(np.concatenate(pairs), np.concatenate(known), np.concatenate(by_pose), frames)

    def take(self, rows: IntArray) -> KnownJoints:
        """Those of some of the pairs."""
        frames = {name: each.take(rows) for name, each in self.frames.items()}
        return KnownJoints(self.pairs[rows], self.known[rows], self.by_pose[rows], frames)

    def with_rows(self, rows: IntArray, some: KnownJoints) -> KnownJoints:
        """With others for some of the pairs."""
        order = np.arange(len(self.pairs))
        order[rows] = len(order) + np.arange(len(rows))
        return KnownJoints.all_of([self, some]).take(order)

    def of(self, pairs: IntArray, joint_types: Sequence[str]) -> KnownJoints:
        """What is known of pairs (P, 2), in whichever order of their bodies."""
        row = {(a, b): i for i, (a, b) in enumerate(self.pairs.tolist()) if self.known[i]}
        found = KnownJoints.none(pairs, joint_types)
        if not row:
            return found
        asked: list[tuple[int, int]] = [(a, b) for a, b in pairs.tolist()]
        there = [i for i, (a, b) in enumerate(asked) if (a, b) in row]
        turned = [i for i, (a, b) in enumerate(asked) if (b, a) in row and (a, b) not in row]
        ours = KnownJoints(self.pairs, self.known, self.by_pose, {name: self.frames[name] for name in joint_types})
        found = found.with_rows(np.array(there, np.intp), ours.take(np.array([row[asked[i]] for i in there], np.intp)))
        back = ours.take(np.array([row[asked[i][1], asked[i][0]] for i in turned], np.intp)).turned()
        return found.with_rows(np.array(turned, np.intp), back)

    def turned(self) -> KnownJoints:
        """The same joints with the bodies of each pair in the other order; of positions alone the child's orientation
        is not known, and so nothing is.
        """
        frames: dict[str, JointFrames] = {}
        for name, each in self.frames.items():
            q = np.zeros((len(self.pairs), JOINT_TYPES[name].states))
            frames[name], _, _ = JOINT_TYPES[name].reversed(each, q, np.zeros((*q.shape, 0)))
        return KnownJoints(self.pairs[:, ::-1], self.known & self.by_pose, self.by_pose, frames)

    def renumbered(self, number: IntArray) -> KnownJoints:
        """With new numbers (K,) for bodies; -1 for those that are there no more."""
        pairs = number[self.pairs]
        return KnownJoints(pairs, self.known & np.all(pairs >= 0, axis=-1), self.by_pose, self.frames)
