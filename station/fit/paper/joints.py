"""The paper's joints (18-23) as it parametrises them: kinematics, gradients, and what absorbs a rigid offset (Table I).

`fk(q)` is T_parent_child. The paper writes a relative pose as (x^j)^-1 x^i in section II-B and as x^b (x^a)^-1 in
Algorithm 1: these are one and the same only if x is the part's pose in the world in the first and the world's pose in
the part in the second. With x = T_world_part in both, the second is no relative pose: it changes with the object's
pose in the world. Here it is `T_parent_child = inverse(T_world_parent) @ T_world_child` throughout.

Every joint counts as many parameters as the paper does, 6, 9 and 12, although some of them change nothing (honest
counts are 6, 7 and 9).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from station.kinematics import se3
from station.kinematics.joints import JointGeometry
from station.logs import FloatArray

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # half turn about x: FLIP R_z(q) FLIP = R_z(-q)


class PaperJoint(ABC):
    """A joint type with its parameters. A new one is a subclass and a start in `PaperSteps.starts`.

    A step (k,) of the optimiser perturbs each SE(3) parameter on its right by `exp([v, w])`, if the type doesn't say
    otherwise.

    Attributes:
        name: of the joint type, as in the registry of joint types.
        parameters: k of (24), as the paper counts.
    """

    name: ClassVar[str]
    parameters: ClassVar[int]

    @abstractmethod
    def fk(self, q: FloatArray) -> FloatArray:
        """T_parent_child (T, 4, 4) at states q (T,)."""

    @abstractmethod
    def ik(self, T_parent_child: FloatArray) -> FloatArray:
        """States (T,) of poses (T, 4, 4)."""

    @abstractmethod
    def moved(self, step: FloatArray) -> Self:
        """The joint a step (k,) away."""

    @abstractmethod
    def chart(self, step: FloatArray) -> FloatArray:
        """(k, k) J with moved(step + d) = moved(step).moved(J d) to first order."""

    @abstractmethod
    def gradient(self, T_parent_child: FloatArray, q: FloatArray, along_fk: FloatArray) -> FloatArray:
        """Gradient (k,) along small steps of the sum over frames of a cost of fk(ik(x)), states included.

        Args:
            T_parent_child: (T, 4, 4) measured, x.
            q: (T,) their states, ik(x).
            along_fk: (T, 6) gradient of each frame's cost along right perturbations of fk(q).
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
        """The joint as the rest of the station holds it, with its state counted from `zero` [m or rad]."""


@dataclass(frozen=True, eq=False)
class PaperRigid(PaperJoint):
    """fk(o) = o, ik = 0 (paper, 18 and 19)."""

    o: FloatArray

    name = "rigid"
    parameters = 6

    def fk(self, q: FloatArray) -> FloatArray:
        return np.broadcast_to(self.o, (*q.shape, 4, 4))

    def ik(self, T_parent_child: FloatArray) -> FloatArray:
        return np.zeros(T_parent_child.shape[:-2])

    def moved(self, step: FloatArray) -> Self:
        return type(self)(self.o @ se3.exp(step))

    def chart(self, step: FloatArray) -> FloatArray:
        return se3.right_jacobian(step)

    def gradient(self, T_parent_child: FloatArray, q: FloatArray, along_fk: FloatArray) -> FloatArray:
        return along_fk.sum(axis=0)

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
        return se3.translation(q[..., None] * self.u) @ self.o

    def ik(self, T_parent_child: FloatArray) -> FloatArray:
        return self._offsets(T_parent_child) @ self.u

    def _offsets(self, T_parent_child: FloatArray) -> FloatArray:
        """(T, 3) T^-1(x o^-1)."""
        p_child = -se3.inverse(self.o)[:3, 3]
        return T_parent_child[..., :3, 3] - T_parent_child[..., :3, :3] @ p_child

    def moved(self, step: FloatArray) -> Self:
        u = self.u + step[6:]
        o = se3.pose(self.o[:3, :3] @ se3.exp_so3(step[3:6]), self.o[:3, 3] + step[:3])
        return type(self)(o, u / np.linalg.norm(u))

    def chart(self, step: FloatArray) -> FloatArray:
        J = np.zeros((9, 9))
        J[:3, :3] = np.eye(3)
        J[3:6, 3:6] = se3.left_jacobian_so3(-step[3:6])
        u = self.u + step[6:]
        J[6:, 6:] = (np.eye(3) - np.outer(u, u) / (u @ u)) / np.linalg.norm(u)
        return J

    def gradient(self, T_parent_child: FloatArray, q: FloatArray, along_fk: FloatArray) -> FloatArray:
        along_p = along_fk[:, :3] @ self.o[:3, :3].T  # of fk's translation, in the parent's frame
        along_q = along_p @ self.u
        # ik(x) = u . (x_T - X_R p) with p = O_R^T o_T, which a step moves by O_R^T v - w x p.
        u_child = along_q @ (self.u @ T_parent_child[:, :3, :3])
        p_child = -se3.inverse(self.o)[:3, 3]
        along_v = along_p.sum(axis=0) - self.o[:3, :3] @ u_child
        along_w = along_fk[:, 3:].sum(axis=0) + np.cross(p_child, u_child)
        along_u = q @ along_p + along_q @ self._offsets(T_parent_child)
        return np.concatenate([along_v, along_w, along_u - (along_u @ self.u) * self.u])

    def with_child_offset(self, T_child_offset: FloatArray) -> Self:
        return type(self)(self.o @ T_child_offset, self.u)

    def with_parent_offset(self, T_offset_parent: FloatArray) -> Self:
        return type(self)(T_offset_parent @ self.o, T_offset_parent[:3, :3] @ self.u)

    def inverted(self) -> Self:
        inverse = se3.inverse(self.o)
        return type(self)(inverse, -inverse[:3, :3] @ self.u)

    def geometry(self, zero: float) -> JointGeometry:
        return JointGeometry(self.u, None, self.fk(np.array(zero)))


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
        return self.r @ _turn(q) @ self.c

    def ik(self, T_parent_child: FloatArray) -> FloatArray:
        R = self._rotations(T_parent_child)
        return np.arctan2(R[..., 1, 0] - R[..., 0, 1], R[..., 0, 0] + R[..., 1, 1])

    def _rotations(self, T_parent_child: FloatArray) -> FloatArray:
        """(T, 3, 3) of r^-1 x c^-1."""
        return self.r[:3, :3].T @ T_parent_child[..., :3, :3] @ self.c[:3, :3].T

    def moved(self, step: FloatArray) -> Self:
        by_r, by_c = se3.exp(step.reshape(2, 6))
        return type(self)(self.r @ by_r, self.c @ by_c)

    def chart(self, step: FloatArray) -> FloatArray:
        J = np.zeros((12, 12))
        J[:6, :6], J[6:, 6:] = se3.right_jacobian(step.reshape(2, 6))
        return J

    def gradient(self, T_parent_child: FloatArray, q: FloatArray, along_fk: FloatArray) -> FloatArray:
        to_child = se3.adjoint(se3.inverse(_turn(q) @ self.c))  # from a perturbation of r to one of fk; its z turns
        along_q = (along_fk * to_child[..., 5]).sum(axis=-1)
        along_r = np.einsum("ti,tij->j", along_fk, to_child)
        along_c = along_fk.sum(axis=0)
        # r exp(w) takes R of r^-1 x c^-1 to exp(-w) R, and c exp(w) to R exp(-R_c w).
        R = self._rotations(T_parent_child)
        W = _angle_slope(R)
        along_r[3:] -= along_q @ _axial(W @ np.swapaxes(R, -1, -2))
        along_c[3:] -= along_q @ _axial(np.swapaxes(R, -1, -2) @ W) @ self.c[:3, :3]
        return np.concatenate([along_r, along_c])

    def with_child_offset(self, T_child_offset: FloatArray) -> Self:
        return type(self)(self.r, self.c @ T_child_offset)

    def with_parent_offset(self, T_offset_parent: FloatArray) -> Self:
        return type(self)(T_offset_parent @ self.r, self.c)

    def inverted(self) -> Self:
        return type(self)(se3.inverse(self.c) @ FLIP, FLIP @ se3.inverse(self.r))

    def geometry(self, zero: float) -> JointGeometry:
        axis = self.r[:3, 2]
        return JointGeometry(axis, self.r[:3, 3] + self.c[2, 3] * axis, self.fk(np.array(zero)))


def _turn(q: FloatArray) -> FloatArray:
    """R_z(q) (T, 4, 4); without the exponential's generality, since the optimiser calls it at every step."""
    T = se3.identity(*q.shape)
    T[..., 0, 0] = T[..., 1, 1] = np.cos(q)
    T[..., 1, 0] = np.sin(q)
    T[..., 0, 1] = -T[..., 1, 0]
    return T


def _angle_slope(R: FloatArray) -> FloatArray:
    """Derivative (T, 3, 3) of the nearest turn about z with respect to the entries of R."""
    s, k = R[..., 1, 0] - R[..., 0, 1], R[..., 0, 0] + R[..., 1, 1]
    square = s**2 + k**2
    W = np.zeros(R.shape)
    W[..., 1, 0], W[..., 0, 1] = k / square, -k / square
    W[..., 0, 0] = W[..., 1, 1] = -s / square
    return W


def _axial(B: FloatArray) -> FloatArray:
    """(T, 3) vectors b with b . w = <B, hat(w)> for every w."""
    return np.stack([B[..., 2, 1] - B[..., 1, 2], B[..., 0, 2] - B[..., 2, 0], B[..., 1, 0] - B[..., 0, 1]], axis=-1)
