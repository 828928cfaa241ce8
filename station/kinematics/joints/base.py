"""What a joint type is: its kinematics in its own axis frame, its honest count of parameters, and a start for a fit.

Every type moves between two fixed poses,

    T_parent_child(q) = T_parent_axis @ M(q; form) @ T_axis_child,

with M a motion in the axis frame: Trans_z for prismatic, R_z for revolute, both for a screw whose `form` is its pitch,
any rotation for spherical, none for rigid. The paper's parametrisations (18, 20, 22) are special cases:
`o = T_parent_axis @ T_axis_child`, `r = T_parent_axis`, `c = T_axis_child`. They carry directions that change nothing
(turning r about z and c back); the free directions listed by each type leave those out, so that they are as many as the
type's parameters: 6 rigid, 7 prismatic, 9 revolute, 10 screw, 6 spherical.

A type needs forward kinematics (`axis_motion`), inverse kinematics (`axis_state`), the twists of its state and form,
and a start for a fit; everything else follows. Only a type whose states are no plain numbers, such as the rotation
vectors of a ball or the full turns of a screw, says besides how they add, go on and are told otherwise (`moved`,
`over_time`, `continuous`, `nearest_turn`, `reversed` and those below it).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidData
from station.kinematics import se3
from station.logs import FloatArray, frozen_floats

# Dimensionless: an axis whose length differs from 1 by more than this is not a direction but a mistake.
AXIS_LENGTH_TOLERANCE = 1e-6
Z = np.array([0.0, 0.0, 1.0])
# A tracker's error of position over its error of orientation: what the two are weighed by where both tell a state and
# no noise is known.
BALANCE_M = 0.1


@dataclass(frozen=True, eq=False)
class JointGeometry:
    """Where a joint is, in the parent's frame.

    Attributes:
        axis_parent: (3,) unit vector along or about which the joint moves; None for a rigid joint.
        point_parent_m: (3,) a point of the axis; None where any would do (rigid, prismatic).
        T_parent_child_zero: (4, 4) pose of the child in the parent at q = 0.
        pitch_m_per_rad: advance along the axis of a screw; None for the other types.

    Raises:
        InvalidData: for an axis that has not unit length, or a zero pose that is no (4, 4) matrix.
    """

    axis_parent: FloatArray | None
    point_parent_m: FloatArray | None
    T_parent_child_zero: FloatArray
    pitch_m_per_rad: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_parent_child_zero", frozen_floats(self.T_parent_child_zero))
        if self.T_parent_child_zero.shape != (4, 4):
            raise InvalidData(f"a zero pose has shape {self.T_parent_child_zero.shape}; want (4, 4)")
        for name in ("axis_parent", "point_parent_m"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen_floats(value))
        if self.axis_parent is not None and abs(np.linalg.norm(self.axis_parent) - 1) > AXIS_LENGTH_TOLERANCE:
            raise InvalidData(f"a joint axis has length {np.linalg.norm(self.axis_parent):g}; want a unit vector")

    @property
    def T_parent_axis(self) -> FloatArray:
        """(4, 4) frame with z along the axis; its origin is the point, or the child's at q = 0 where there is none."""
        axis = Z if self.axis_parent is None else self.axis_parent
        point = self.T_parent_child_zero[:3, 3] if self.point_parent_m is None else self.point_parent_m
        return se3.pose(se3.rotation_between(Z, axis), point)


@dataclass(frozen=True, eq=False)
class JointFrames:
    """The fixed numbers of a batch of joints.

    Attributes:
        T_parent_axis: (..., 4, 4).
        T_axis_child: (..., 4, 4).
        form: (..., m) numbers of the motion itself, such as a screw's pitch [m/rad]; most types have none, m = 0.
    """

    T_parent_axis: FloatArray
    T_axis_child: FloatArray
    form: FloatArray

    @staticmethod
    def plain(T_parent_axis: FloatArray, T_axis_child: FloatArray) -> JointFrames:
        """Frames of a type without form."""
        return JointFrames(T_parent_axis, T_axis_child, np.zeros((*T_parent_axis.shape[:-2], 0)))

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_] | int) -> JointFrames:
        """Some of the joints."""
        return JointFrames(self.T_parent_axis[rows], self.T_axis_child[rows], self.form[rows])


class JointType(ABC):
    """A kind of joint. A new one is a subclass in its own file and a line in the registry; the tests then cover it.

    Attributes:
        name: as in files and options.
        parameters: honest degrees of freedom of the geometry when poses are seen.
        position_parameters: the same when only the child's positions are seen.
        paper_parameters: the count of the paper's footnote 5, or by its way of counting.
        states: numbers s that change from frame to frame.
        position_states: how many of them positions tell.
        unit: of the state, "m" or "rad"; None without one.
        has_axis: whether the joint has a direction.
        has_point: whether it has a place: a point of its axis, or its centre.
        axis_freedoms: entries of a right perturbation of T_parent_axis that a fit moves.
        child_freedoms: entries of a left perturbation of T_axis_child that a fit moves.
        form_freedoms: how many numbers m its `form` has.
        usual: how often one meets it, as against a hinge.
        includes: types with the same frames and states that it is where its form is zero.
        simpler: types whose motions are a case of its own, the simplest first.
    """

    name: ClassVar[str]
    parameters: ClassVar[int]
    position_parameters: ClassVar[int]
    paper_parameters: ClassVar[int]
    states: ClassVar[int]
    position_states: ClassVar[int]
    unit: ClassVar[str | None]
    has_axis: ClassVar[bool]
    has_point: ClassVar[bool]
    axis_freedoms: ClassVar[tuple[int, ...]]
    child_freedoms: ClassVar[tuple[int, ...]]
    form_freedoms: ClassVar[int] = 0
    usual: ClassVar[float] = 1.0
    includes: ClassVar[tuple[str, ...]] = ()
    simpler: ClassVar[tuple[str, ...]] = ()

    @property
    def state_shape(self) -> tuple[int, ...]:
        """Shape of one state as `forward` takes it: () for a number, else (s,)."""
        return (self.states,) if self.states > 1 else ()

    @abstractmethod
    def axis_motion(self, q: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 4, 4) motion M for states q (..., s) and forms (..., m); NaN where a state is."""

    def moved_axes(self, R_axis: FloatArray, q: FloatArray, form: FloatArray) -> tuple[FloatArray, FloatArray]:
        """R_axis M, rotation (3, 3, P, T) and shift (3, P, T) of the moved axis frame along the parent's axes.

        Entries come first: for many frames that is much quicker than products of poses.

        Args:
            R_axis: (3, 3, P) of the axis frame in the parent.
            q: (P, T, s) states.
            form: (P, m).
        """
        M = self.axis_motion(q, form[:, None])
        R, t = M[..., :3, :3].transpose(2, 3, 0, 1), M[..., :3, 3].transpose(2, 0, 1)
        return np.einsum("ijp,jkpt->ikpt", R_axis, R), np.einsum("ijp,jpt->ipt", R_axis, t)

    @abstractmethod
    def state_twists(self, form: FloatArray) -> FloatArray:
        """(..., 6, s) right perturbations of M by changes of the state, M(moved(q, dq)) = M(q) exp(twists dq)."""

    def form_twists(self, q: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 6, m) right perturbations of M by changes of the form."""
        return np.zeros((*np.shape(q)[:-1], 6, self.form_freedoms))

    def moved(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """(..., s) states changed by dq (..., s)."""
        return q + dq

    @abstractmethod
    def axis_state(self, T_axis_child: FloatArray, zero: FloatArray, form: FloatArray) -> FloatArray:
        """(..., s) state that brings `zero` (..., 4, 4) nearest `T_axis_child` (..., 4, 4), both in the axis frame."""

    @abstractmethod
    def axis_state_of_position(self, p_axis: FloatArray, zero_axis: FloatArray, form: FloatArray) -> FloatArray:
        """(..., s) state that brings the position `zero_axis` (..., 3) nearest `p_axis` (..., 3), in the axis frame."""

    def over_time(
        self, q: FloatArray, p_axis: FloatArray, zero_axis: FloatArray, form: FloatArray, weights: FloatArray
    ) -> FloatArray:
        """(..., T, s) states for a start, where one frame alone may not tell which of several it is in.

        Args:
            q: (..., T, s) by `axis_state` or `axis_state_of_position`, each frame by itself.
            p_axis: (..., T, 3) measured positions in the axis frame.
            zero_axis: (..., 3) position at the state 0.
            form: (..., m).
            weights: (..., T) how far frames are to be trusted.
        """
        return q

    def continuous(self, q: FloatArray) -> FloatArray:
        """(..., T, s) the same states without jumps of a full turn from frame to frame."""
        return np.unwrap(q, axis=-2) if self.unit == "rad" else q

    def nearest_turn(self, q: FloatArray, near: FloatArray) -> FloatArray:
        """(..., s) states q told by the full turn that brings them nearest to other states (..., s)."""
        return near + wrapped(q - near) if self.unit == "rad" else q

    def extent(self, q: FloatArray) -> FloatArray:
        """(...,) the number whose range and limits a tree tells of states q (..., s): the state itself."""
        return q[..., 0]

    def reversed(
        self, frames: JointFrames, q: FloatArray, dq: FloatArray
    ) -> tuple[JointFrames, FloatArray, FloatArray]:
        """The joint seen from its child, with its states q (..., s) and their changes dq (..., s, k), as `moved` takes
        them: T_child_parent = T_axis_child^-1 M(q)^-1 T_parent_axis^-1.
        """
        return JointFrames(se3.inverse(frames.T_axis_child), se3.inverse(frames.T_parent_axis), frames.form), -q, -dq

    def upright(self, frames: JointFrames, q: FloatArray, dq: FloatArray) -> tuple[JointFrames, FloatArray, FloatArray]:
        """The same motion with an axis frame that `geometry` tells in full, states and their changes likewise."""
        return frames, q, dq

    def from_zero(
        self, frames: JointFrames, q: FloatArray, dq: FloatArray, zero: FloatArray
    ) -> tuple[JointFrames, FloatArray, FloatArray]:
        """The same motion with its zero where the state was `zero` (s,), states and their changes likewise."""
        T_axis_child = self.axis_motion(zero, frames.form) @ frames.T_axis_child
        return JointFrames(frames.T_parent_axis, T_axis_child, frames.form), q - zero, dq

    def column_changes(self, q: FloatArray, dq: FloatArray) -> FloatArray:
        """(..., s, k) changes of the numbers q (..., s) themselves by changes dq (..., s, k) as `moved` takes them."""
        return dq

    def column_information(self, q: FloatArray, information: FloatArray) -> FloatArray:
        """(..., s, s) information about the numbers q (..., s) themselves, of that about changes of `moved`."""
        return information

    @abstractmethod
    def starts(self, T_parent_child: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """Closed-form fits to begin from, one or several where the data can be read in several ways.

        Args:
            T_parent_child: (..., T, 4, 4) finite poses.
            weights: (..., T) not negative; frames of weight 0 are ignored.
        """

    @abstractmethod
    def position_starts(self, p_parent: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """The same from positions (..., T, 3) alone; the child's orientation is then the parent's."""

    def geometry(self, frames: JointFrames) -> JointGeometry:
        """The geometry of one joint, (4, 4) frames, of this type."""
        T_parent_axis = frames.T_parent_axis
        axis = T_parent_axis[:3, 2] if self.has_axis else None
        point = T_parent_axis[:3, 3] if self.has_point else None
        pitch = float(frames.form[0]) if self.form_freedoms else None
        return JointGeometry(axis, point, T_parent_axis @ frames.T_axis_child, pitch)

    def frames(self, geometry: JointGeometry) -> JointFrames:
        """The fixed numbers of a geometry of this type."""
        if self.has_axis and geometry.axis_parent is None:
            raise InvalidData(f"a {self.name} joint needs an axis")
        if self.form_freedoms and geometry.pitch_m_per_rad is None:
            raise InvalidData(f"a {self.name} joint needs a pitch")
        T_parent_axis = geometry.T_parent_axis
        form = np.array([geometry.pitch_m_per_rad] if self.form_freedoms else [], dtype=np.float64)
        return JointFrames(T_parent_axis, se3.inverse(T_parent_axis) @ geometry.T_parent_child_zero, form)

    def reversed_states(self, geometry: JointGeometry, q: FloatArray) -> FloatArray:
        """States, as `forward` takes them, of the joint seen from its child (`Joint.reversed`): the same.

        The axis turns round there, so that a state along or about it counts on.
        """
        return q

    def motion(self, geometry: JointGeometry, q: FloatArray) -> FloatArray:
        """(..., 4, 4) motion of the child from its zero pose, in the parent's frame: T(q) @ T(0)^-1."""
        frames = self.frames(geometry)
        M = self.axis_motion(self._columns(np.asarray(q, dtype=np.float64)), frames.form)
        return frames.T_parent_axis @ M @ se3.inverse(frames.T_parent_axis)

    def forward(self, geometry: JointGeometry, q: FloatArray) -> FloatArray:
        """(..., 4, 4) T_parent_child at states q [m or rad]: (...,), or (..., s) for s > 1."""
        return self.motion(geometry, q) @ geometry.T_parent_child_zero

    def inverse(self, geometry: JointGeometry, T_parent_child: FloatArray) -> FloatArray:
        """State nearest to T_parent_child (..., 4, 4), as `forward` takes it; angles in (-pi, pi], but a screw's."""
        frames = self.frames(geometry)
        q = self.axis_state(se3.inverse(frames.T_parent_axis) @ T_parent_child, frames.T_axis_child, frames.form)
        return q if self.states > 1 else q.sum(axis=-1)

    def _columns(self, q: FloatArray) -> FloatArray:
        """(..., s) states as a fit has them of those of `forward`."""
        return q if self.states > 1 else np.repeat(q[..., None], self.states, axis=-1)


def wrapped(angle: FloatArray) -> FloatArray:
    """(...,) the same angle in (-pi, pi]."""
    return np.arctan2(np.sin(angle), np.cos(angle))


def weighted_mean(values: FloatArray, weights: FloatArray) -> FloatArray:
    """(..., n) mean of values (..., T, n) with weights (..., T)."""
    return np.einsum("...t,...tn->...n", weights, values) / weights.sum(axis=-1)[..., None]


def weighted_scatter(values: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (..., 3) and principal directions (..., 3, 3), columns by falling spread, of points (..., T, 3)."""
    centre = weighted_mean(values, weights)
    d = values - centre[..., None, :]
    _, vectors = np.linalg.eigh(np.einsum("...t,...ti,...tj->...ij", weights, d, d))
    return centre, vectors[..., ::-1]


def mean_rotation(R: FloatArray, weights: FloatArray) -> FloatArray:
    """(..., 3, 3) chordal mean of rotations (..., T, 3, 3) with weights (..., T)."""
    return se3.project_to_so3(np.einsum("...t,...tij->...ij", weights, R))


def turned(T_parent_axis: FloatArray) -> FloatArray:
    """(..., 3, 3) rotations R_axis_parent of poses (..., 4, 4)."""
    return np.swapaxes(T_parent_axis[..., :3, :3], -1, -2)
