"""Residuals of joints against relative poses, and how they change with parameters and states; entries first.

Everything is told along the parent's axes: the errors d = t_meas - t and e = log(R_meas R^T) of position and
orientation, and motions by the velocity u of the child's origin and its angular velocity w. With T = F M(q) C, motions
of F, of C and of M turn about the axis frame's origin, the moved one's for the latter two:

    d changes by -u,  e by -Jr^-1(e) w,  u = v + w x (t - origin)

for a twist (v, w) in the axis frame's own directions. What the states can take up is projected out (Schur complement).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.fit.entrywise import cross, entries_first, entries_last, inverse_right_jacobian, log
from station.fit.pair_data import PairData
from station.fit.pair_model import Model
from station.fit.whitening import Whitening
from station.kinematics.joints import JointFrames, JointType
from station.logs import FloatArray

# Length of a state's direction beyond the others', as a share of the longest, below which it tells nothing of its own.
APART_ABOVE = 1e-6
# Information about a parameter, as a share of the most about any of the joint's, that is no more than rounding.
TOLD_ABOVE = 1e-14


@dataclass(frozen=True, eq=False)
class Errors:
    """A model's errors, and where its joint is.

    Attributes:
        R_parent_axis: (3, 3, P).
        R_parent_moved: (3, 3, P, T) of the moved axis frame.
        lever: (3, P, T) from the axis frame's origin to the child's.
        arm: (3, P, T) from the moved axis frame's origin to the child's.
        d: (3, P, T) [m].
        e: (3, P, T) [rad].
    """

    R_parent_axis: FloatArray
    R_parent_moved: FloatArray
    lever: FloatArray
    arm: FloatArray
    d: FloatArray
    e: FloatArray


def errors(joint: JointType, frames: JointFrames, q: FloatArray, R: FloatArray, t: FloatArray) -> Errors:
    """Of joints (P, ...) in states (P, T, s) against poses R (3, 3, P, T) and t (3, P, T)."""
    R_axis, t_axis = entries_first(frames.T_parent_axis)
    R_child, t_child = entries_first(frames.T_axis_child)
    R_moved, shift = joint.moved_axes(R_axis, q, frames.form)
    arm = np.einsum("ijpt,jp->ipt", R_moved, t_child)
    lever = arm + shift
    R_model = np.einsum("ijpt,jkp->ikpt", R_moved, R_child)
    d = t - lever - t_axis[..., None]
    return Errors(R_axis, R_moved, lever, arm, d, log(np.einsum("ijpt,kjpt->ikpt", R, R_model)))


@dataclass(frozen=True, eq=False)
class Linear:
    """Whitened derivatives of P pairs at one model, states projected out.

    Attributes:
        by_parameters: (6, n, P, T) at right angles to `states`.
        states: (6, s, P, T) orthonormal directions that the states move the residual in.
        along: (s, n, P, T) parts of the parameters' derivatives along `states`.
        coupling: (s, n, P, T) change of a frame's best states with the parameters.
        own: (P, T, s) best change of the states at these parameters.
        state_information: (P, T, s, s).
        state_scale: (s, P, T) deviations of the states, each given some of the others, so that their product is that of
            all; 0 where one is not told.
    """

    by_parameters: FloatArray
    states: FloatArray
    along: FloatArray
    coupling: FloatArray
    own: FloatArray
    state_information: FloatArray
    state_scale: FloatArray

    def normal_equations(self, residual: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """H (P, n, n) and g (P, n) with frames weighted (P, T); zero for parameters that nothing tells."""
        _, n, P, T = self.by_parameters.shape
        root = np.sqrt(weights)
        frames_last = np.empty((P, n, 6, T))
        np.multiply(self.by_parameters.transpose(2, 1, 0, 3), root[:, None, None], out=frames_last)
        r = np.ascontiguousarray((residual * root).swapaxes(0, 1)).reshape(P, 6 * T, 1)
        A = frames_last.reshape(P, n, 6 * T)
        H = A @ np.swapaxes(A, -1, -2)
        left = np.diagonal(H, axis1=-2, axis2=-1)
        whole = left + np.einsum("snpt,pt->pn", self.along**2, weights)
        told = left > TOLD_ABOVE * whole.max(axis=-1, keepdims=True)
        return np.where(told[:, :, None] & told[:, None, :], H, 0.0), np.where(told, (A @ r)[..., 0], 0.0)

    def state_step(self, step: FloatArray) -> FloatArray:
        """(P, T, s) change of the states that goes with a step (P, n)."""
        return self.own + np.einsum("snpt,pn->pts", self.coupling, step)


def linearised(joint: JointType, model: Model, at: Errors, whitening: Whitening, residual: FloatArray) -> Linear:
    """Derivatives of whitened residuals (6, P, T) at a model with these errors."""
    n = len(joint.axis_freedoms) + len(joint.child_freedoms) + joint.form_freedoms
    u, w = _motions(joint, model, at)
    whitened = whitening.by_motion(u, w, inverse_right_jacobian(at.e))
    A, B = whitened[:, :n], whitened[:, n:]
    states, inverse, scale = orthonormal(B)
    along = np.einsum("rspt,rnpt->snpt", states, A)
    own = -np.einsum("uspt,spt->ptu", inverse, np.einsum("rspt,rpt->spt", states, residual))
    coupling = -np.einsum("uspt,snpt->unpt", inverse, along)
    across = A - np.einsum("rspt,snpt->rnpt", states, along) if joint.states else A
    information = np.einsum("rspt,rupt->ptsu", B, B)
    return Linear(across, states, along, coupling, own, information, scale)


def state_steps(
    joint: JointType, frames: JointFrames, at: Errors, whitening: Whitening, residual: FloatArray
) -> FloatArray:
    """(P, T, s) best changes of the states alone, for whitened residuals (6, P, T)."""
    P, T = at.d.shape[1:]
    twists = np.broadcast_to(joint.state_twists(frames.form)[:, None], (P, T, 6, joint.states))
    B = whitening.by_motion(*_of_twists(twists, at), inverse_right_jacobian(at.e))
    states, inverse, _ = orthonormal(B)
    return -np.einsum("uspt,spt->ptu", inverse, np.einsum("rspt,rpt->spt", states, residual))


def _of_twists(twists: FloatArray, at: Errors) -> tuple[FloatArray, FloatArray]:
    """u and w (3, c, P, T) of twists (P, T, 6, c) of the moved axis frame."""
    v_axis, w_axis = np.split(np.moveaxis(twists, (-2, -1), (0, 1)), 2)
    w = np.einsum("ijpt,jcpt->icpt", at.R_parent_moved, w_axis)
    return np.einsum("ijpt,jcpt->icpt", at.R_parent_moved, v_axis) + cross(w, at.arm[:, None]), w


def _motions(joint: JointType, model: Model, at: Errors) -> tuple[FloatArray, FloatArray]:
    """u and w (3, n + s, P, T) of the parameters, those of F, of C, of the form, and of the states."""
    P, T = at.d.shape[1:]
    form = joint.form_freedoms
    end = len(joint.axis_freedoms) + len(joint.child_freedoms) + form
    u, w = np.zeros((3, end + joint.states, P, T)), np.zeros((3, end + joint.states, P, T))
    column = 0
    for freedoms, R, lever in (
        (joint.axis_freedoms, at.R_parent_axis[..., None], at.lever),
        (joint.child_freedoms, at.R_parent_moved, at.arm),
    ):
        for i in freedoms:
            if i < 3:
                u[:, column] = R[:, i]
            else:
                w[:, column] = R[:, i - 3]
                u[:, column] = cross(w[:, column], lever)
            column += 1
    twists = [np.broadcast_to(joint.state_twists(model.frames.form)[:, None], (P, T, 6, joint.states))]
    if form:
        twists.insert(0, joint.form_twists(model.q, model.frames.form[:, None]))
    for twist in twists:
        columns = slice(column, column + twist.shape[-1])
        u[:, columns], w[:, columns] = _of_twists(twist, at)
        column += twist.shape[-1]
    return u, w


def orthonormal(B: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Q (r, s, P, T) orthonormal and U (s, s, P, T) with Q = B U, by Gram and Schmidt, the longest column of B first.

    Where a column of B tells nothing beyond those before it there is a zero one. Last come the inverse lengths
    (s, P, T) of what columns had left when it was their turn, with the product |B^T B|^-1/2; 0 where nothing was.
    """
    if B.shape[1] < 2:
        return _orthonormal(B)
    order = np.argsort(-np.einsum("rspt,rspt->spt", B, B), axis=0)
    Q, U, scale = _orthonormal(np.take_along_axis(B, order[None], axis=1))
    back = np.argsort(order, axis=0)
    return Q, np.take_along_axis(U, back[:, None], axis=0), scale


def _orthonormal(B: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    s = B.shape[1]
    Q, U, scales = np.zeros_like(B), np.zeros((s, s, *B.shape[2:])), np.zeros(B.shape[1:])
    longest = np.zeros(B.shape[2:])
    for j in range(s):
        v = B[:, j].copy()
        U[j, j] = 1.0
        for k in range(j):  # one after the other keeps rounding small
            along = np.einsum("r...,r...->...", Q[:, k], v)
            v -= along * Q[:, k]
            U[: j + 1, j] -= along * U[: j + 1, k]
        square = np.einsum("r...,r...->...", v, v)
        longest = square if j == 0 else longest
        told = square > APART_ABOVE**2 * longest
        scale = np.where(told, 1 / np.sqrt(np.where(told, square, 1.0)), 0.0)
        Q[:, j], U[: j + 1, j], scales[j] = v * scale, U[: j + 1, j] * scale, scale
    return Q, U, scales


def residual_of_poses(at: Errors, data: PairData) -> FloatArray:
    """(P, T, 6) residuals e_v, e_w of `pair_model`, along the measured child's axes."""
    return entries_last(
        np.concatenate([np.einsum("jipt,jpt->ipt", data.R, at.d), np.einsum("jipt,jpt->ipt", data.R, at.e)]), 1
    )
