"""Kinematic trees: bodies, each named by one of its parts, and joints; forward kinematics and re-rooting."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from station.errors import InvalidData
from station.kinematics import se3
from station.kinematics.joint import RIGID_MOTION, Joint, is_rigid_motion
from station.logs import FloatArray, check_slugs, frozen_floats

__all__ = ["Joint", "KinematicTree", "connected_bodies"]


@dataclass(frozen=True, eq=False, slots=True)
class KinematicTree:
    """Bodies and the joints between them.

    A body is known by one of its parts, its named part: it stands in `trees` and in the joints, and its frame is the
    body's. The other members of its rigid group are further trackers on it.

    Attributes:
        root: named part that poses are told in; nothing is the parent of its body.
        parts: every tracked part.
        rigid_groups: parts found to be one body, two or more in each group.
        trees: named parts of the bodies that joints connect; more than one tree where nothing connects them.
        joints: in the order of the columns of joint states; each tree of n bodies has n - 1.
        method: how the tree was found, as JSON values.
        warnings: plain sentences.
        mounts: `T_body_part` (4, 4) of further trackers by part; of those that are missing nobody knows where they sit.

    Raises:
        InvalidData: for names that aren't distinct slugs, joints with the same names of states, groups that overlap or
            name unknown parts, trees that don't hold each body once, joints between unknown bodies or different trees,
            a body with two parents, a loop, a tree that its joints don't connect, a root that isn't one, mounts of
            parts that are no further trackers or that are no rigid motions.
    """

    root: str
    parts: tuple[str, ...]
    rigid_groups: tuple[tuple[str, ...], ...]
    trees: tuple[tuple[str, ...], ...]
    joints: tuple[Joint, ...]
    method: Mapping[str, object] = field(default_factory=dict[str, object])
    warnings: tuple[str, ...] = ()
    mounts: Mapping[str, FloatArray] = field(default_factory=dict[str, FloatArray])

    def __post_init__(self) -> None:
        for name in ("parts", "joints", "warnings"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        for name in ("rigid_groups", "trees"):
            object.__setattr__(self, name, tuple(tuple(group) for group in getattr(self, name)))
        object.__setattr__(self, "method", dict(self.method))
        object.__setattr__(self, "mounts", {part: frozen_floats(T) for part, T in self.mounts.items()})
        check_slugs(self.parts, "part")
        check_slugs([joint.name for joint in self.joints], "joint")
        check_slugs(self.columns, "state of a joint")
        _check_groups(self)
        _check_bodies(self)
        _check_joints(self)
        _check_mounts(self)
        for names in self.trees:
            _check_connected(self, names)
        if self.root not in self.tree_roots:
            raise InvalidData(f"root '{self.root}' is no root; have {', '.join(self.tree_roots)}")

    @property
    def bodies(self) -> tuple[str, ...]:
        """Named part of every body."""
        return tuple(name for names in self.trees for name in names)

    @property
    def tree_roots(self) -> tuple[str, ...]:
        """The body without a parent in each of `trees`."""
        children = {joint.child for joint in self.joints}
        return tuple(name for name in self.bodies if name not in children)

    @property
    def movable(self) -> tuple[Joint, ...]:
        """The joints that have a state, in their order."""
        return tuple(joint for joint in self.joints if joint.kind.states)

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of a joint log: `Joint.columns` of each joint, in their order."""
        return tuple(column for joint in self.joints for column in joint.columns)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each of `columns`, "rad" or "m"."""
        return {column: joint.unit for joint in self.joints for column in joint.columns}

    def joint(self, name: str) -> Joint:
        """The joint of that name; raises InvalidData if there is none."""
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise InvalidData(f"no joint '{name}'; have {', '.join(j.name for j in self.joints) or 'none'}")

    def body_of(self, part: str) -> str:
        """Named part of the body that carries `part`; raises InvalidData for an unknown part."""
        if part not in self.parts:
            raise InvalidData(f"no part '{part}'; have {', '.join(self.parts)}")
        members = next((group for group in self.rigid_groups if part in group), (part,))
        return next(name for name in members if name in self.bodies)

    def outward(self, start: str | None = None) -> Iterator[Joint]:
        """The joints that hang from the body `start` (the root if None), each after the one that it hangs from."""
        waiting = [self.root if start is None else start]
        while waiting:
            body = waiting.pop()
            below = [joint for joint in self.joints if joint.parent == body]
            yield from below
            waiting.extend(joint.child for joint in below)

    def forward(self, q: Mapping[str, ArrayLike] | ArrayLike, *, start: str | None = None) -> dict[str, FloatArray]:
        """Poses of the bodies that hang from a root.

        Args:
            q: states [rad or m] by joint, (...,) each, or (..., 3) of a spherical one, broadcast against each other; or
                one array (..., C), as `columns` says. A mapping needs no more than the joints below `start`.
            start: the body to begin from; the root if None. Bodies of another tree have no pose in the root: begin from
                that tree's own root.

        Returns:
            `T_start_part` (..., 4, 4) by named part, `start` included; NaN where a state above it is NaN. Other
            trackers of a body are left out.

        Raises:
            InvalidData: for states of unknown joints, missing states, another number of columns.
        """
        start = self.root if start is None else start
        if start not in self.bodies:
            raise InvalidData(f"no body '{start}'; have {', '.join(self.bodies)}")
        states, batch = self._states(q)
        joints = tuple(self.outward(start))
        missing = [joint.name for joint in joints if joint.kind.states and joint.name not in states]
        if missing:
            raise InvalidData(f"no state of {', '.join(missing)}; have {', '.join(states) or 'none'}")
        poses = {start: se3.identity(*batch)}
        for joint in joints:
            state = np.broadcast_to(states.get(joint.name, np.zeros(())), batch + joint.kind.state_shape)
            poses[joint.child] = poses[joint.parent] @ joint.forward(state)
        return poses

    def rerooted(self, new_root: str) -> KinematicTree:
        """The same tree told from another body: for the same states the same relative motion of all bodies.

        The joints on the way from `new_root` to the root of its tree are reversed (`Joint.reversed`). Names and order
        of the joints stay, so that states keep their meaning, but for those of spherical joints: see `rerooted_states`.
        In a forest the other trees stay.

        Raises:
            InvalidData: if `new_root` is not the named part of a body.
        """
        turning = self._turning(new_root)
        joints = tuple(joint.reversed() if joint.name in turning else joint for joint in self.joints)
        return replace(self, root=new_root, joints=joints)

    def rerooted_states(self, new_root: str, q: ArrayLike) -> FloatArray:
        """States (..., C), as `columns` says, of `rerooted(new_root)` that stand for these of this tree.

        Raises:
            InvalidData: if `new_root` is not the named part of a body; for another number of columns.
        """
        states, batch = self._states(np.asarray(q, dtype=np.float64))
        turning = self._turning(new_root)
        found = [np.zeros((*batch, 0))]
        for joint in self.movable:
            state = states[joint.name]
            told = joint.reversed_states(state) if joint.name in turning else state
            found.append(told.reshape(*batch, joint.kind.states))
        return np.concatenate(found, axis=-1)

    def _turning(self, new_root: str) -> set[str]:
        """Joints that are reversed for a new root."""
        if new_root not in self.bodies:
            where = f" (its body is '{self.body_of(new_root)}')" if new_root in self.parts else ""
            raise InvalidData(f"'{new_root}' is no body{where}; have {', '.join(self.bodies)}")
        above = {joint.child: joint for joint in self.joints}
        found: set[str] = set()
        body = new_root
        while body in above:
            found.add(above[body].name)
            body = above[body].parent
        return found

    def _states(self, q: Mapping[str, ArrayLike] | ArrayLike) -> tuple[dict[str, FloatArray], tuple[int, ...]]:
        """States by joint, and the shape that they broadcast to."""
        if isinstance(q, Mapping):
            unknown = [name for name in q if name not in {joint.name for joint in self.joints}]
            if unknown:
                raise InvalidData(f"no joint '{unknown[0]}'; have {', '.join(j.name for j in self.joints) or 'none'}")
            states = {name: np.asarray(state, dtype=np.float64) for name, state in q.items()}
            return states, np.broadcast_shapes(*(self._batch(name, state) for name, state in states.items()))
        columns = np.asarray(q, dtype=np.float64)
        if columns.ndim == 0 or columns.shape[-1] != len(self.columns):
            want = f"(..., {len(self.columns)}): {', '.join(self.columns)}"
            raise InvalidData(f"states have shape {columns.shape}; want {want}")
        ends = np.cumsum([joint.kind.states for joint in self.movable], dtype=int).tolist()
        told = {
            joint.name: columns[..., end - joint.kind.states : end].reshape(
                (*columns.shape[:-1], *joint.kind.state_shape)
            )
            for joint, end in zip(self.movable, ends, strict=True)
        }
        return told, columns.shape[:-1]

    def _batch(self, name: str, state: FloatArray) -> tuple[int, ...]:
        """Shape of a joint's states without that of one state."""
        own = self.joint(name).kind.state_shape
        if state.shape[state.ndim - len(own) :] != own:
            raise InvalidData(f"states of '{name}' have shape {state.shape}; want (..., {own[0]}): a rotation vector")
        return state.shape[: state.ndim - len(own)]


def connected_bodies(bodies: Sequence[str], joints: Sequence[Joint]) -> tuple[tuple[str, ...], ...]:
    """The bodies that joints connect, tree by tree, in the order of `bodies`; joints of other bodies are ignored."""
    tree_of = {body: {body} for body in bodies}
    for joint in joints:
        if joint.parent in tree_of and joint.child in tree_of:
            joined = tree_of[joint.parent] | tree_of[joint.child]
            tree_of.update((body, joined) for body in joined)
    firsts = {id(tree): tree for tree in tree_of.values()}
    return tuple(tuple(body for body in bodies if body in tree) for tree in firsts.values())


def _check_groups(tree: KinematicTree) -> None:
    members = [part for group in tree.rigid_groups for part in group]
    unknown = [part for part in members if part not in tree.parts]
    if unknown:
        raise InvalidData(f"rigid group with unknown part '{unknown[0]}'; have {', '.join(tree.parts)}")
    check_slugs(members, "part in rigid_groups")
    small = [group for group in tree.rigid_groups if len(group) < 2]
    if small:
        raise InvalidData(f"rigid group of {len(small[0])}: {', '.join(small[0])}; want two or more parts, or no group")


def _check_bodies(tree: KinematicTree) -> None:
    """Each body is in the trees once, by exactly one of its parts."""
    check_slugs(tree.bodies, "part in trees")
    unknown = [name for name in tree.bodies if name not in tree.parts]
    if unknown:
        raise InvalidData(f"trees with unknown part '{unknown[0]}'; have {', '.join(tree.parts)}")
    grouped = {part for group in tree.rigid_groups for part in group}
    singles = [(part,) for part in tree.parts if part not in grouped]
    for members in (*tree.rigid_groups, *singles):
        named = [part for part in members if part in tree.bodies]
        if len(named) != 1:
            have = f"{len(named)} parts ({', '.join(named)})" if named else "none"
            raise InvalidData(f"trees hold {have} of the body {', '.join(members)}; want one of its parts, once")


def _check_joints(tree: KinematicTree) -> None:
    tree_of = {name: i for i, names in enumerate(tree.trees) for name in names}
    parent_of: dict[str, str] = {}
    for joint in tree.joints:
        for body in (joint.parent, joint.child):
            if body not in tree_of:
                raise InvalidData(f"joint '{joint.name}' at '{body}', which is no body; have {', '.join(tree.bodies)}")
        if tree_of[joint.parent] != tree_of[joint.child]:
            raise InvalidData(f"joint '{joint.name}' connects '{joint.parent}' and '{joint.child}' of different trees")
        if joint.child in parent_of:
            raise InvalidData(f"'{joint.child}' has two parents: {parent_of[joint.child]} and {joint.parent}")
        parent_of[joint.child] = joint.parent


def _check_mounts(tree: KinematicTree) -> None:
    trackers = [part for part in tree.parts if part not in tree.bodies]
    for part, T in tree.mounts.items():
        if part not in trackers:
            have = ", ".join(trackers) or "none"
            raise InvalidData(f"mount of '{part}', which is no further tracker of a body; have {have}")
        if not is_rigid_motion(T):
            raise InvalidData(f"mount of '{part}' is no rigid motion; want a (4, 4) pose {RIGID_MOTION}")


def _check_connected(tree: KinematicTree, names: tuple[str, ...]) -> None:
    roots = [name for name in tree.tree_roots if name in names]
    if len(roots) != 1:
        raise InvalidData(
            f"the tree of {', '.join(names)} has {len(roots)} roots ({', '.join(roots) or 'a loop'}); want one"
        )
    reached = {roots[0], *(joint.child for joint in tree.outward(roots[0]))}
    if reached != set(names):
        apart = [name for name in names if name not in reached]
        loop = " > ".join(_loop(tree, apart[0]))
        raise InvalidData(
            f"no joint connects {', '.join(apart)} to {roots[0]}: they hang in a loop, {loop}; want a tree"
        )


def _loop(tree: KinematicTree, body: str) -> list[str]:
    """Bodies of a loop, each the child of the one before, the first again as the last; above a body without a root."""
    parent_of = {joint.child: joint.parent for joint in tree.joints}
    above = [body]
    while parent_of[above[-1]] not in above:
        above.append(parent_of[above[-1]])
    again = parent_of[above[-1]]
    return [again, *reversed(above[above.index(again) :])]
