"""Kinematic trees: bodies, each named by one of its parts, and joints; forward kinematics and re-rooting."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from station.errors import InvalidData
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointGeometry, JointType
from station.logs import FloatArray, check_slugs, frozen_floats

# Dimensionless; as for the rotations of a PoseLog.
RIGID_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class Joint:
    """A joint between two bodies and what a fit found out about it; None where nothing was fitted or is known.

    Attributes:
        name: slug; a fitted joint is `parent__child` until it is matched to a commanded one.
        type: key of `JOINT_TYPES`.
        parent: named part of the parent body.
        child: named part of the child body.
        axis_parent: (3,) unit vector in the parent's frame; None for a type without one.
        point_parent_m: (3,) point of the axis, best the one nearest the child's mean position; None for a type without.
        T_parent_child_zero: (4, 4) pose of the child at state 0; `T_parent_child(q) = motion(q) @ T_parent_child_zero`.
        pitch_m_per_rad: advance of a screw; None for the other types.
        state_min: least observed state, in the type's unit (rad or m).
        state_max: largest observed state.
        limits: least and largest state that a tree file allows.
        scores: "criterion" with its name, and each candidate type's score, lower is better; NaN if it has none.
        probability: of each candidate, "free" included if it is one.
        rms_rotation_rad: norm of the rotation residuals over inliers.
        rms_translation_m: norm of the translation residuals over inliers.
        frames: number of frames with both parts.
        outliers: number of these that were left out.
        axis_std_rad: sqrt(trace) over the two degrees of freedom of the axis.
        point_std_m: sqrt(trace) over the two degrees of freedom of the point.

    Raises:
        InvalidData: for names that are no slugs, an unknown type, an axis or point that the type needs or has not, an
            axis that is no unit vector, a zero pose that is no rigid motion, a range that ends before it begins.
    """

    name: str
    type: str
    parent: str
    child: str
    axis_parent: FloatArray | None
    point_parent_m: FloatArray | None
    T_parent_child_zero: FloatArray
    pitch_m_per_rad: float | None = None
    state_min: float | None = None
    state_max: float | None = None
    limits: tuple[float, float] | None = None
    scores: Mapping[str, float | str] | None = None
    probability: Mapping[str, float] | None = None
    rms_rotation_rad: float | None = None
    rms_translation_m: float | None = None
    frames: int | None = None
    outliers: int | None = None
    axis_std_rad: float | None = None
    point_std_m: float | None = None

    def __post_init__(self) -> None:
        check_slugs((self.name,), "joint")
        for name in ("axis_parent", "point_parent_m", "T_parent_child_zero"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else frozen_floats(value))
        for name in ("scores", "probability"):
            by_type: Mapping[str, object] | None = getattr(self, name)
            object.__setattr__(self, name, None if by_type is None else dict(by_type))
        _check_ends(self)
        _check_geometry(self)
        _check_range(self, "state", self.state_min, self.state_max)
        if self.limits is not None:
            object.__setattr__(self, "limits", tuple(self.limits))
            _check_range(self, "limits", *self.limits)

    @property
    def kind(self) -> JointType:
        """The joint type with its kinematics."""
        return JOINT_TYPES[self.type]

    @property
    def unit(self) -> str:
        """Unit of the state, "rad" or "m"; empty for a joint without one."""
        return self.kind.unit or ""

    @property
    def geometry(self) -> JointGeometry:
        """Where the joint is, in the parent's frame."""
        return JointGeometry(self.axis_parent, self.point_parent_m, self.T_parent_child_zero, self.pitch_m_per_rad)

    def forward(self, q: ArrayLike) -> FloatArray:
        """T_parent_child (..., 4, 4) at states q (...,) in rad or m; a rigid joint ignores them but for their shape."""
        return self.kind.forward(self.geometry, np.asarray(q, dtype=np.float64))

    def with_sign(self, sign: int) -> Joint:
        """The same joint for sign +1; for -1 its axis turned round, so that its state counts the other way."""
        if sign > 0 or self.axis_parent is None:
            return self
        low, high = (None if x is None else -x for x in (self.state_max, self.state_min))
        limits = None if self.limits is None else (-self.limits[1], -self.limits[0])
        return replace(self, axis_parent=-self.axis_parent, state_min=low, state_max=high, limits=limits)

    def reversed(self) -> Joint:
        """The same joint seen from its child: for the same q the same relative motion.

        `T_child_parent(q) = zero^-1 motion(q)^-1`, so the zero pose is inverted, the point is taken to the child's
        frame and so is the axis, with its sign turned: then q keeps its sign. The name, scores and counts stay. The
        residuals of translation and the deviations of axis and point hold in the parent's frame only: they become None.
        """
        T_child_parent = se3.inverse(self.T_parent_child_zero)
        axis = None if self.axis_parent is None else -T_child_parent[:3, :3] @ self.axis_parent
        turned = replace(
            self,
            parent=self.child,
            child=self.parent,
            axis_parent=axis,
            point_parent_m=_moved_point(T_child_parent, self.point_parent_m),
            T_parent_child_zero=T_child_parent,
            rms_translation_m=None,
            axis_std_rad=None,
            point_std_m=None,
        )
        return turned._with_nearest_point()

    def _with_nearest_point(self) -> Joint:
        """The joint with the point of its axis that is nearest to the child's origin at the middle of the range."""
        if self.axis_parent is None or self.point_parent_m is None:
            return self
        p_child = self.forward(_middle(self.state_min, self.state_max))[:3, 3]
        along = self.axis_parent @ (p_child - self.point_parent_m)
        return replace(self, point_parent_m=self.point_parent_m + along * self.axis_parent)


@dataclass(frozen=True, eq=False, slots=True)
class KinematicTree:
    """Bodies and the joints between them.

    A body is known by one of its parts, its named part: it stands in `trees` and in the joints. The other members of
    its rigid group are further trackers on it; where they sit on the body is not told here.

    Attributes:
        root: named part that poses are told in; nothing is the parent of its body.
        parts: every tracked part.
        rigid_groups: parts found to be one body, two or more in each group.
        trees: named parts of the bodies that joints connect; more than one tree where nothing connects them.
        joints: in the order of the columns of joint states; each tree of n bodies has n - 1.
        method: how the tree was found, as JSON values.
        warnings: plain sentences.

    Raises:
        InvalidData: for names that aren't distinct slugs, groups that overlap or name unknown parts, trees that don't
            hold each body once, joints between unknown bodies or different trees, a body with two parents, a loop, a
            tree that its joints don't connect, a root that isn't one.
    """

    root: str
    parts: tuple[str, ...]
    rigid_groups: tuple[tuple[str, ...], ...]
    trees: tuple[tuple[str, ...], ...]
    joints: tuple[Joint, ...]
    method: Mapping[str, object] = field(default_factory=dict[str, object])
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("parts", "joints", "warnings"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        for name in ("rigid_groups", "trees"):
            object.__setattr__(self, name, tuple(tuple(group) for group in getattr(self, name)))
        object.__setattr__(self, "method", dict(self.method))
        check_slugs(self.parts, "part")
        check_slugs([joint.name for joint in self.joints], "joint")
        _check_groups(self)
        _check_bodies(self)
        _check_joints(self)
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
        """The joints that have a state, in their order: the columns of a joint log."""
        return tuple(joint for joint in self.joints if joint.kind.states)

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
            q: states [rad or m] by joint, (...,) each, broadcast against each other; or one array (..., J), a column
                for each of `movable`. A mapping needs no more than the joints below `start`.
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
            state = np.broadcast_to(states.get(joint.name, np.zeros(())), batch)
            poses[joint.child] = poses[joint.parent] @ joint.forward(state)
        return poses

    def rerooted(self, new_root: str) -> KinematicTree:
        """The same tree told from another body: for the same states the same relative motion of all bodies.

        The joints on the way from `new_root` to the root of its tree are reversed (`Joint.reversed`). Names and order
        of the joints stay, so that states keep their meaning. In a forest the other trees stay.

        Raises:
            InvalidData: if `new_root` is not the named part of a body.
        """
        if new_root not in self.bodies:
            where = f" (its body is '{self.body_of(new_root)}')" if new_root in self.parts else ""
            raise InvalidData(f"'{new_root}' is no body{where}; have {', '.join(self.bodies)}")
        above = {joint.child: joint for joint in self.joints}
        to_reverse: set[str] = set()
        body = new_root
        while body in above:
            to_reverse.add(above[body].name)
            body = above[body].parent
        joints = tuple(joint.reversed() if joint.name in to_reverse else joint for joint in self.joints)
        return replace(self, root=new_root, joints=joints)

    def _states(self, q: Mapping[str, ArrayLike] | ArrayLike) -> tuple[dict[str, FloatArray], tuple[int, ...]]:
        """States by joint, and the shape that they broadcast to."""
        if isinstance(q, Mapping):
            unknown = [name for name in q if name not in {joint.name for joint in self.joints}]
            if unknown:
                raise InvalidData(f"no joint '{unknown[0]}'; have {', '.join(j.name for j in self.joints) or 'none'}")
            states = {name: np.asarray(state, dtype=np.float64) for name, state in q.items()}
            return states, np.broadcast_shapes(*(state.shape for state in states.values()))
        columns = np.asarray(q, dtype=np.float64)
        names = [joint.name for joint in self.movable]
        if columns.ndim == 0 or columns.shape[-1] != len(names):
            raise InvalidData(f"states have shape {columns.shape}; want (..., {len(names)}): {', '.join(names)}")
        return {name: columns[..., i] for i, name in enumerate(names)}, columns.shape[:-1]


def connected_bodies(bodies: Sequence[str], joints: Sequence[Joint]) -> tuple[tuple[str, ...], ...]:
    """The bodies that joints connect, tree by tree, in the order of `bodies`; joints of other bodies are ignored."""
    tree_of = {body: {body} for body in bodies}
    for joint in joints:
        if joint.parent in tree_of and joint.child in tree_of:
            joined = tree_of[joint.parent] | tree_of[joint.child]
            tree_of.update((body, joined) for body in joined)
    firsts = {id(tree): tree for tree in tree_of.values()}
    return tuple(tuple(body for body in bodies if body in tree) for tree in firsts.values())


def _middle(low: float | None, high: float | None) -> float:
    return 0.0 if low is None or high is None else 0.5 * (low + high)


def _moved_point(T: FloatArray, p: FloatArray | None) -> FloatArray | None:
    return None if p is None else T[:3, :3] @ p + T[:3, 3]


def _check_ends(joint: Joint) -> None:
    check_slugs((joint.parent,), "part")
    check_slugs((joint.child,), "part")
    if joint.parent == joint.child:
        raise InvalidData(f"joint '{joint.name}' has '{joint.parent}' at both ends")
    if joint.type not in JOINT_TYPES:
        raise InvalidData(f"joint '{joint.name}' has the type '{joint.type}'; want one of {', '.join(JOINT_TYPES)}")


def _check_geometry(joint: Joint) -> None:
    kind, what = joint.kind, f"joint '{joint.name}' ({joint.type})"
    needs = {"axis_parent": kind.has_axis, "point_parent_m": kind.has_point}
    for name, needed in needs.items():
        value: FloatArray | None = getattr(joint, name)
        if (value is not None) != needed:
            raise InvalidData(f"{what}: {name} is {'missing' if needed else 'given'}; the type {_needs(needed)}")
        if value is not None and (value.shape != (3,) or not np.all(np.isfinite(value))):
            raise InvalidData(f"{what}: {name} is {value.tolist()}; want three finite numbers")
    needs_pitch = kind.form_freedoms > 0
    if (joint.pitch_m_per_rad is not None) != needs_pitch:
        given = "missing" if needs_pitch else "given"
        raise InvalidData(f"{what}: pitch_m_per_rad is {given}; the type {_needs(needs_pitch)}")
    if joint.pitch_m_per_rad is not None and not np.isfinite(joint.pitch_m_per_rad):
        raise InvalidData(f"{what}: pitch_m_per_rad is {joint.pitch_m_per_rad}; want a finite number")
    if not _is_rigid_motion(joint.T_parent_child_zero):
        raise InvalidData(
            f"{what}: T_parent_child_zero is no rigid motion; want a (4, 4) pose whose rotation is one within "
            f"{RIGID_TOLERANCE:g} and whose last row is 0 0 0 1"
        )
    try:
        _ = joint.geometry
    except InvalidData as error:
        raise InvalidData(f"{what}: {error}") from None


def _needs(needed: bool) -> str:
    return "needs it" if needed else "has none"


def _is_rigid_motion(T: FloatArray) -> bool:
    if T.shape != (4, 4) or not np.all(np.isfinite(T)) or np.any(T[3] != (0, 0, 0, 1)):
        return False
    R = T[:3, :3]
    return bool(np.abs(R.T @ R - np.eye(3)).max() < RIGID_TOLERANCE and np.linalg.det(R) > 0)


def _check_range(joint: Joint, what: str, low: float | None, high: float | None) -> None:
    given = [x for x in (low, high) if x is not None]
    if given and not joint.kind.states:
        raise InvalidData(f"joint '{joint.name}': a {joint.type} joint has no state, but {what} is given")
    if not np.all(np.isfinite(given)) or (len(given) == 2 and given[0] > given[1]):
        raise InvalidData(f"joint '{joint.name}': {what} from {low} to {high}; want finite numbers that don't fall")


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


def _check_connected(tree: KinematicTree, names: tuple[str, ...]) -> None:
    roots = [name for name in tree.tree_roots if name in names]
    if len(roots) != 1:
        raise InvalidData(
            f"the tree of {', '.join(names)} has {len(roots)} roots ({', '.join(roots) or 'a loop'}); want one"
        )
    reached = {roots[0], *(joint.child for joint in tree.outward(roots[0]))}
    if reached != set(names):
        apart = [name for name in names if name not in reached]
        raise InvalidData(f"no joint connects {', '.join(apart)} to {roots[0]}; want a tree each, or a joint")
