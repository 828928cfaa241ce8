"""The paper's joints (18-23) as it parametrises them: kinematics, slopes, and what absorbs a rigid offset (Table I).

`fk(q)` is T_parent_child. The paper writes a relative pose as (x^j)^-1 x^i in section II-B and as x^b (x^a)^-1 in
Algorithm 1: these are one and the same only if x is the part's pose in the world in the first and the world's pose in
the part in the second. With x = T_world_part in both, the second is no relative pose: it changes with the object's
pose in the world. Here it is `T_parent_child = inverse(T_world_parent) @ T_world_child` throughout.

Every joint counts as many parameters as the paper does, 6, 9 and 12, although some of them change nothing (honest
counts are 6, 7 and 9).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from station.kinematics import se3
from station.kinematics.joints import JointGeometry
from station.logs import FloatArray

IntArray = NDArray[np.intp]

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # half turn about x: FLIP R_z(q) FLIP = R_z(-q)


class PaperJoint(ABC):
    """A joint type with its parameters, of one joint or of a batch (...,) of them.

    A new one is a dataclass of arrays, and a start in `PaperSteps.starts`.

    A step (..., k) of the optimiser perturbs each SE(3) parameter on its right by `exp([v, w])`, if the type
    doesn't say otherwise.

    Attributes:
        name: of the joint type, as in the registry of joint types.
        parameters: k of (24), as the paper counts.
    """

    name: ClassVar[str]
    parameters: ClassVar[int]

    @abstractmethod
    def fk(self, q: FloatArray) -> FloatArray:
        """T_parent_child (..., T, 4, 4) at states q (..., T)."""

    @abstractmethod
    def ik(self, T_parent_child: FloatArray) -> FloatArray:
        """States (..., T) of poses (..., T, 4, 4)."""

    @abstractmethod
    def moved(self, step: FloatArray) -> Self:
        """The joint a step (..., k) away."""

    @abstractmethod
    def chart(self, step: FloatArray) -> FloatArray:
        """(..., k, k) J with moved(step + d) = moved(step).moved(J d) to first order."""

    @abstractmethod
    def slopes(self, T_parent_child: FloatArray, q: FloatArray) -> FloatArray:
        """(..., 6, T, k) right perturbations of fk(ik(x)) by small steps, states included.

        Args:
            T_parent_child: (..., T, 4, 4) measured, x.
            q: (..., T) their states, ik(x).
        """

    @abstractmethod
    def with_child_offset(self, T_child_offset: FloatArray) -> Self:
        """The joint to a frame that is fixed on the child: fk -> fk @ offset (Table I, prepend)."""

    @abstractmethod
    def with_parent_offset(self, T_offset_parent: FloatArray) -> Self:
        """The joint from a frame that is fixed on the parent: fk -> offset @ fk (Table I, append)."""

    @abstractmethod
    def inverted(self) -> Self:
        """The joint from child to parent: fk -> inverse(fk) for the same states."""

    @abstractmethod
    def geometry(self, zero: float) -> JointGeometry:
        """One joint as the rest of the station holds it, with its state counted from `zero` [m or rad]."""

    @property
    def twin(self) -> Self | None:
        """The joint near which the costs have a second minimum if they have one here; None of a type with just one."""
        return None

    @classmethod
    def batch(cls, joints: Sequence[Self]) -> Self:
        """Joints of one type, as a batch (P,)."""
        return cls(*(np.stack(arrays) for arrays in zip(*(joint.arrays for joint in joints), strict=True)))

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """The parameters, in the order of the fields."""
        return tuple(getattr(self, field.name) for field in fields(self))  # pyright: ignore[reportArgumentType]

    def take(self, rows: IntArray | int) -> Self:
        """Some of a batch, or one of it."""
        return type(self)(*(array[rows] for array in self.arrays))

    def with_rows(self, rows: IntArray, some: Self) -> Self:
        """A batch with others for some."""
        arrays = [array.copy() for array in self.arrays]
        for array, changed in zip(arrays, some.arrays, strict=True):
            array[rows] = changed
        return type(self)(*arrays)


@dataclass(frozen=True, eq=False)
class PaperRigid(PaperJoint):
    """fk(o) = o, ik = 0 (paper, 18 and 19)."""

    o: FloatArray

    name = "rigid"
    parameters = 6

    def fk(self, q: FloatArray) -> FloatArray:
        return np.broadcast_to(self.o[..., None, :, :], (*q.shape, 4, 4))

    def ik(self, T_parent_child: FloatArray) -> FloatArray:
        return np.zeros(T_parent_child.shape[:-2])

    def moved(self, step: FloatArray) -> Self:
        return type(self)(self.o @ se3.exp(step))

    def chart(self, step: FloatArray) -> FloatArray:
        return se3.right_jacobian(step)

    def slopes(self, T_parent_child: FloatArray, q: FloatArray) -> FloatArray:
        return np.broadcast_to(np.eye(6)[:, None], (*q.shape[:-1], 6, q.shape[-1], 6))

    def with_child_offset(self, T_child_offset: FloatArray) -> Self:
        return type(self)(self.o @ T_child_offset)

    def with_parent_offset(self, T_offset_parent: FloatArray) -> Self:
        return type(self)(T_offset_parent @ self.o)

    def inverted(self) -> Self:
        return type(self)(se3.inverse(self.o))

    def geometry(self, zero: float) -> JointGeometry:
        return JointGeometry(None, None, self.o)


@dataclass(frozen=True, eq=False)
class PaperPrismatic(PaperJoint):
    """fk(o, u; q) = T(q u) o, ik = T^-1(x o^-1) . u (paper, 20 and 21); u is a unit vector.

    The state is (21) as printed: off the joint's manifold an error of orientation, times the distance between the
    parts, goes into it.

    A step [v, w, du] is added to o's translation and to u, which is made a unit vector again (three numbers, as the
    paper counts), and turns o by exp(w) on its right. So o slides straight along u, which changes next to nothing: with
    `exp([v, w])` instead BFGS takes twice as many iterations along that valley.
    """

    o: FloatArray
    u: FloatArray

    name = "prismatic"
    parameters = 9

    def fk(self, q: FloatArray) -> FloatArray:
        T = np.repeat(self.o[..., None, :, :], q.shape[-1], axis=-3)
        T[..., :3, 3] += q[..., None] * self.u[..., None, :]
        return T

    def ik(self, T_parent_child: FloatArray) -> FloatArray:
        return (self._offsets(T_parent_child) @ self.u[..., None])[..., 0]

    def _offsets(self, T_parent_child: FloatArray) -> FloatArray:
        """(..., T, 3) T^-1(x o^-1)."""
        turned = T_parent_child[..., :3, :3] @ self._p_child[..., None, :, None]
        return T_parent_child[..., :3, 3] - turned[..., 0]

    @property
    def _p_child(self) -> FloatArray:
        """(..., 3) O_R^T o_T."""
        return np.einsum("...ji,...j->...i", self.o[..., :3, :3], self.o[..., :3, 3])

    def moved(self, step: FloatArray) -> Self:
        u = self.u + step[..., 6:]
        o = se3.pose(self.o[..., :3, :3] @ se3.exp_so3(step[..., 3:6]), self.o[..., :3, 3] + step[..., :3])
        return type(self)(o, u / np.linalg.norm(u, axis=-1, keepdims=True))

    def chart(self, step: FloatArray) -> FloatArray:
        J = np.zeros((9, 9))
        J[:3, :3] = np.eye(3)
        J[3:6, 3:6] = se3.left_jacobian_so3(-step[3:6])
        u = self.u + step[6:]
        J[6:, 6:] = (np.eye(3) - np.outer(u, u) / (u @ u)) / np.linalg.norm(u)
        return J

    def slopes(self, T_parent_child: FloatArray, q: FloatArray) -> FloatArray:
        # ik(x) = u . (x_T - X_R p) with p = O_R^T o_T, which a step moves by O_R^T v - w x p.
        R, u = self.o[..., :3, :3], self.u[..., None, :]
        u_child = (u[..., None, :] @ T_parent_child[..., :3, :3])[..., 0, :]
        by_q = np.concatenate(
            [
                -u_child @ np.swapaxes(R, -1, -2),
                _cross(self._p_child[..., None, :], u_child),
                self._offsets(T_parent_child) - q[..., None] * u,
            ],
            axis=-1,
        )
        along = np.einsum("...ji,...j->...i", R, self.u)
        slopes = np.zeros((*q.shape[:-1], 6, q.shape[-1], 9))
        slopes[..., :3, :, :] = along[..., None, None] * by_q[..., None, :, :]
        columns = np.swapaxes(R, -1, -2)[..., None, :]
        slopes[..., :3, :, :3] += columns
        across = columns - along[..., None, None] * u[..., None, :, :]
        slopes[..., :3, :, 6:] += q[..., None, :, None] * across
        slopes[..., 3:, :, 3:6] = np.eye(3)[:, None]
        return slopes

    @property
    def twin(self) -> Self:
        """As far the other way along u: by (21) the lever from there takes up as much of the errors of orientation."""
        along = np.einsum("...i,...i->...", self.o[..., :3, 3], self.u)[..., None] * self.u
        return type(self)(se3.pose(self.o[..., :3, :3], self.o[..., :3, 3] - 2 * along), self.u)

    def with_child_offset(self, T_child_offset: FloatArray) -> Self:
        return type(self)(self.o @ T_child_offset, self.u)

    def with_parent_offset(self, T_offset_parent: FloatArray) -> Self:
        return type(self)(T_offset_parent @ self.o, T_offset_parent[:3, :3] @ self.u)

    def inverted(self) -> Self:
        inverse = se3.inverse(self.o)
        return type(self)(inverse, -inverse[:3, :3] @ self.u)

    def geometry(self, zero: float) -> JointGeometry:
        return JointGeometry(self.u, None, self.fk(np.array([zero]))[0])


@dataclass(frozen=True, eq=False)
class PaperRevolute(PaperJoint):
    """fk(c, r; q) = r R_z(q) c, ik = R_z^-1(r^-1 x c^-1) (paper, 22 and 23).

    So r is the axis in the parent and c the child in the axis' frame. R_z^-1 is the angle of the turn about z that is
    nearest to a rotation.
    """

    r: FloatArray
    c: FloatArray

    name = "revolute"
    parameters = 12

    def fk(self, q: FloatArray) -> FloatArray:
        return self.r[..., None, :, :] @ self._turned(q)

    def _turned(self, q: FloatArray) -> FloatArray:
        """(..., T, 4, 4) R_z(q) c, row by row: the optimiser asks for it at every step."""
        c, cosine, sine = self.c[..., None, :, :], np.cos(q)[..., None], np.sin(q)[..., None]
        T = np.repeat(c, q.shape[-1], axis=-3)
        T[..., 0, :] = cosine * c[..., 0, :] - sine * c[..., 1, :]
        T[..., 1, :] = sine * c[..., 0, :] + cosine * c[..., 1, :]
        return T

    def ik(self, T_parent_child: FloatArray) -> FloatArray:
        R = self._rotations(T_parent_child)
        return np.arctan2(R[..., 1, 0] - R[..., 0, 1], R[..., 0, 0] + R[..., 1, 1])

    def _rotations(self, T_parent_child: FloatArray) -> FloatArray:
        """(..., T, 3, 3) of r^-1 x c^-1."""
        R_r, R_c = (np.swapaxes(T[..., None, :3, :3], -1, -2) for T in (self.r, self.c))
        return R_r @ T_parent_child[..., :3, :3] @ R_c

    def moved(self, step: FloatArray) -> Self:
        moves = se3.exp(step.reshape(*step.shape[:-1], 2, 6))
        return type(self)(self.r @ moves[..., 0, :, :], self.c @ moves[..., 1, :, :])

    def chart(self, step: FloatArray) -> FloatArray:
        J = np.zeros((12, 12))
        J[:6, :6], J[6:, 6:] = se3.right_jacobian(step.reshape(2, 6))
        return J

    def slopes(self, T_parent_child: FloatArray, q: FloatArray) -> FloatArray:
        by_r, by_c = _angle_slopes(self._rotations(T_parent_child))
        by_c = by_c @ self.c[..., :3, :3]  # c exp(w) is exp(R_c w) c
        turned = self._turned(q)
        slopes = np.zeros((*q.shape[:-1], 6, q.shape[-1], 12))
        for i in range(3):  # rows of the adjoint of turned^-1, which takes a perturbation of r to one of fk
            axis = turned[..., :3, i]
            slopes[..., i, :, :3] = slopes[..., i + 3, :, 3:6] = axis
            slopes[..., i, :, 3:6] = _cross(turned[..., :3, 3], axis)
        by_q = slopes[..., 5:6].copy()
        slopes[..., 3:6] += by_q * by_r[..., None, :, :]
        slopes[..., 6:] = np.eye(6)[:, None]
        slopes[..., 9:] += by_q * by_c[..., None, :, :]
        return slopes

    def with_child_offset(self, T_child_offset: FloatArray) -> Self:
        return type(self)(self.r, self.c @ T_child_offset)

    def with_parent_offset(self, T_offset_parent: FloatArray) -> Self:
        return type(self)(T_offset_parent @ self.r, self.c)

    def inverted(self) -> Self:
        return type(self)(se3.inverse(self.c) @ FLIP, FLIP @ se3.inverse(self.r))

    def geometry(self, zero: float) -> JointGeometry:
        axis = self.r[:3, 2]
        return JointGeometry(axis, self.r[:3, 3] + self.c[2, 3] * axis, self.fk(np.array([zero]))[0])


def _angle_slopes(R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """By how much the nearest turn about z of exp(-w) R, and of R exp(-w), changes with w: (..., T, 3) each.

    With the turn q, tan q = s / k, and W its derivative by the entries of R, they are -b of b . w = <W R^T, hat(w)> and
    of b . w = <R^T W, hat(w)>.
    """
    s, k = R[..., 1, 0] - R[..., 0, 1], R[..., 0, 0] + R[..., 1, 1]
    square = s**2 + k**2
    s, k, minus = s / square, k / square, np.full(square.shape, -1.0)
    before = (k * R[..., 2, 0] - s * R[..., 2, 1], s * R[..., 2, 0] + k * R[..., 2, 1], minus)
    after = (k * R[..., 0, 2] + s * R[..., 1, 2], k * R[..., 1, 2] - s * R[..., 0, 2], minus)
    return np.stack(before, axis=-1), np.stack(after, axis=-1)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """(..., 3) vector product; quicker than NumPy's, which the optimiser would call at every step."""
    turned = (1, 2, 0), (2, 0, 1)
    return a[..., turned[0]] * b[..., turned[1]] - a[..., turned[1]] * b[..., turned[0]]
