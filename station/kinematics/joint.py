"""A joint between two bodies: where it is, how it moves, what a fit found out about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from station.errors import InvalidData
from station.kinematics import se3
from station.kinematics.joints import JOINT_TYPES, JointGeometry, JointType
from station.logs import FloatArray, check_slugs, frozen_floats

# Dimensionless; as for the rotations of a PoseLog.
RIGID_TOLERANCE = 1e-6
RIGID_MOTION = f"whose rotation is one within {RIGID_TOLERANCE:g} and whose last row is 0 0 0 1"


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
        state_min: least observed state, in the type's unit (rad or m); of a spherical joint, the angle of its rotation
            vector, as for the next two.
        state_max: largest observed state.
        limits: least and largest state that a tree file allows.
        scores: "criterion" with its name, and each candidate type's score, lower is better; NaN if it has none.
        criteria: the scores of every criterion, by its name.
        probability: of each candidate, "free" included if it is one.
        rms_rotation_rad: norm of the rotation residuals over inliers.
        rms_translation_m: norm of the translation residuals over inliers.
        frames: number of frames with both parts.
        outliers: number of these that were left out.
        axis_std_rad: sqrt(trace) over the two degrees of freedom of the axis.
        point_std_m: sqrt(trace) over the two degrees of freedom of the point; the three of a spherical joint's centre.
        pitch_std_m_per_rad: of the pitch.

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
    criteria: Mapping[str, Mapping[str, float]] | None = None
    probability: Mapping[str, float] | None = None
    rms_rotation_rad: float | None = None
    rms_translation_m: float | None = None
    frames: int | None = None
    outliers: int | None = None
    axis_std_rad: float | None = None
    point_std_m: float | None = None
    pitch_std_m_per_rad: float | None = None

    def __post_init__(self) -> None:
        check_slugs((self.name,), "joint")
        for name in ("axis_parent", "point_parent_m", "T_parent_child_zero"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else frozen_floats(value))
        for name in ("scores", "probability"):
            by_type: Mapping[str, object] | None = getattr(self, name)
            object.__setattr__(self, name, None if by_type is None else dict(by_type))
        if self.criteria is not None:
            object.__setattr__(self, "criteria", {name: dict(scores) for name, scores in self.criteria.items()})
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

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of its states in a JointLog: none for a rigid joint, its own for one state, else `name_x`, `_y`, `_z`.

        A spherical joint's three are its rotation vector [rad], in the parent's axes.
        """
        return (self.name,) * self.kind.states if self.kind.states < 2 else tuple(f"{self.name}_{i}" for i in "xyz")

    def forward(self, q: ArrayLike) -> FloatArray:
        """T_parent_child (..., 4, 4) at states q (...,) in rad or m, or (..., 3) of a spherical joint.

        A rigid joint ignores them but for their shape.
        """
        return self.kind.forward(self.geometry, np.asarray(q, dtype=np.float64))

    def with_sign(self, sign: int) -> Joint:
        """The same joint for sign +1; for -1 its axis turned round, so that its state counts the other way.

        A joint without an axis has no sign and stays as it is.
        """
        if sign > 0 or self.axis_parent is None:
            return self
        low, high = (None if x is None else -x for x in (self.state_max, self.state_min))
        limits = None if self.limits is None else (-self.limits[1], -self.limits[0])
        return replace(self, axis_parent=-self.axis_parent, state_min=low, state_max=high, limits=limits)

    def reversed(self) -> Joint:
        """The same joint seen from its child: for the same q the same relative motion.

        `T_child_parent(q) = zero^-1 motion(q)^-1`, so the zero pose is inverted, the point is taken to the child's
        frame and so is the axis, with its sign turned: then q keeps its sign, and a screw its pitch. A rotation vector
        has no axis to turn: the states of a spherical joint become `reversed_states`. The name, scores and counts stay.
        The residuals of translation and the deviations of axis and point hold in the parent's frame only: they become
        None.
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

    def reversed_states(self, q: ArrayLike) -> FloatArray:
        """States of `reversed()`, as `forward` takes them, for the same relative motion: q but for a spherical joint.

        There they are `-R_child_parent(0) q`, the opposite rotation in the child's axes at q = 0.
        """
        return self.kind.reversed_states(self.geometry, np.asarray(q, dtype=np.float64))

    def _with_nearest_point(self) -> Joint:
        """The joint with the point of its axis that is nearest to the child's origin at the middle of the range."""
        if self.axis_parent is None or self.point_parent_m is None:
            return self
        p_child = self.forward(_middle(self.state_min, self.state_max))[:3, 3]
        along = self.axis_parent @ (p_child - self.point_parent_m)
        return replace(self, point_parent_m=self.point_parent_m + along * self.axis_parent)


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
    if not is_rigid_motion(joint.T_parent_child_zero):
        raise InvalidData(f"{what}: T_parent_child_zero is no rigid motion; want a (4, 4) pose {RIGID_MOTION}")
    try:
        _ = joint.geometry
    except InvalidData as error:
        raise InvalidData(f"{what}: {error}") from None


def _needs(needed: bool) -> str:
    return "needs it" if needed else "has none"


def is_rigid_motion(T: FloatArray) -> bool:
    """Whether T is a (4, 4) rigid motion, within RIGID_TOLERANCE."""
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
