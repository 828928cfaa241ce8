"""States of single frames sought by damped least squares, with the parameters of the tree as they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.fit.image.corner_data import CornerData
from station.fit.image.views import COORDINATES
from station.fit.skeleton import Skeleton, TreeModel, with_moved_states
from station.fit.tree_elimination import UNOBSERVED
from station.fit.tree_motion import TreePoses, joint_twists, root_twists, tree_poses
from station.logs import FloatArray

# Degrees of freedom of the heavy tails: where all is far off, nothing is left out for that.
STUDENT_FREEDOMS = 3.0
DAMPING_START, DAMPING_FALL, DAMPING_RISE, DAMPING_MAX = 1e-4, 0.1, 10.0, 1e8
# Frames whose next step promises to change chi squared by less than this are settled.
SETTLED = 1e-3
# Frames that are worked on at once.
FRAMES_AT_ONCE = 1000


def sought(skeleton: Skeleton, model: TreeModel, data: CornerData, rounds: int, *, tails: bool) -> TreeModel:
    """The model with each frame's states where its corners are likeliest, from where they are; damped, frame by frame.

    Args:
        skeleton: of the tree.
        model: parameters, which stay, and states.
        data: corners in the same frames.
        rounds: at most.
        tails: whether errors have heavy tails, so that a start may be far off; else they are as in the fit of the tree.
    """
    frames = len(model.q)
    for start in range(0, frames, FRAMES_AT_ONCE):  # memory asks for this loop
        rows = np.arange(start, min(start + FRAMES_AT_ONCE, frames))
        model = model.with_states(rows, _searched(skeleton, model.take(rows), data.take(rows), rounds, tails=tails))
    return model


def chi2_of(skeleton: Skeleton, model: TreeModel, data: CornerData) -> FloatArray:
    """(T, M) whitened squared residuals."""
    return data.chi2(tree_poses(skeleton, model).parts, model.shared)


def costs_of(skeleton: Skeleton, model: TreeModel, data: CornerData) -> FloatArray:
    """(T,) -2 log likelihood of each frame's corners, but for a constant."""
    return data.costs(chi2_of(skeleton, model, data)).sum(axis=-1)


def tails_of(data: CornerData, chi2: FloatArray) -> FloatArray:
    """(T, M) -2 log of Student densities, but for a constant."""
    freedoms = STUDENT_FREEDOMS + COORDINATES
    return np.where(data.seen, freedoms * np.log1p(chi2 / STUDENT_FREEDOMS), 0.0)


def _searched(skeleton: Skeleton, model: TreeModel, data: CornerData, rounds: int, *, tails: bool) -> TreeModel:
    damping = np.full(len(model.q), DAMPING_START)
    chi2 = chi2_of(skeleton, model, data)
    going = np.arange(len(model.q))
    for _ in range(rounds):  # each step starts where the last one ended
        some, seen, so_far = model.take(going), data.take(going), chi2[going]
        weights = _student_weights(seen, so_far) if tails else seen.weights(so_far)
        found = state_equations(skeleton, some, seen, weights)
        step, promise = found.step(damping[going])
        tried = with_moved_states(skeleton, some, step)
        tried_chi2 = chi2_of(skeleton, tried, seen)
        better = _cost(seen, tried_chi2, tails=tails) < _cost(seen, so_far, tails=tails)
        model = model.with_states(going[better], tried.take(np.flatnonzero(better)))
        chi2[going[better]] = tried_chi2[better]
        damping[going] = np.minimum(damping[going] * np.where(better, DAMPING_FALL, DAMPING_RISE), DAMPING_MAX)
        going = going[promise > SETTLED]
        if not going.size:
            break
    return model


def _student_weights(data: CornerData, chi2: FloatArray) -> FloatArray:
    return data.seen * (STUDENT_FREEDOMS + COORDINATES) / (STUDENT_FREEDOMS + chi2)


def _cost(data: CornerData, chi2: FloatArray, *, tails: bool) -> FloatArray:
    """(T,)."""
    return (tails_of(data, chi2) if tails else data.costs(chi2)).sum(axis=-1)


@dataclass(frozen=True, eq=False)
class StateEquations:
    """Second derivatives (T, s, s) and gradients (T, s) of half the weighted squared residuals, by the states alone."""

    H: FloatArray
    g: FloatArray

    def step(self, damping: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(T, s) change of the states, damped by so much (T,) of their own information; what it promises (T,)."""
        step = np.asarray(-np.linalg.solve(self._lifted(damping), self.g[..., None])[..., 0], dtype=np.float64)
        return step, -np.sum(step * self.g, axis=-1)

    @property
    def std(self) -> FloatArray:
        """(T, s) deviations of the states, with the parameters held; large where nothing observes one."""
        variance = np.diagonal(np.linalg.inv(self._lifted(np.zeros(len(self.g)))), axis1=-2, axis2=-1)
        return np.asarray(np.sqrt(np.abs(variance)), dtype=np.float64)

    def _lifted(self, damping: FloatArray) -> FloatArray:
        diagonal = np.diagonal(self.H, axis1=-2, axis2=-1)
        lifted = np.where(diagonal > 0, diagonal * (UNOBSERVED + damping[:, None]), 1.0)
        return self.H + lifted[..., None] * np.eye(diagonal.shape[-1])


def state_equations(skeleton: Skeleton, model: TreeModel, data: CornerData, weights: FloatArray) -> StateEquations:
    """Equations at a model; sightings count by their weights (T, M)."""
    poses = tree_poses(skeleton, model)
    centre = poses.parts[..., :3, 3].mean(axis=1)
    whitened, by_twist = data.derivatives(poses.parts, model.shared, centre)
    by_states = by_twist[..., :6] @ state_twists(skeleton, model, poses, centre)[:, data.part]
    frames, s = len(model.q), skeleton.states
    B = by_states.reshape(frames, -1, s)
    weighted_t = np.swapaxes((by_states * weights[..., None, None]).reshape(B.shape), -1, -2)
    return StateEquations(weighted_t @ B, (weighted_t @ whitened.reshape(frames, -1, 1))[..., 0])


def state_twists(skeleton: Skeleton, model: TreeModel, poses: TreePoses, centre: FloatArray) -> FloatArray:
    """(T, K, 6, s) twists of the parts along the reference's axes about `centre` (T, 3) by the frames' own numbers."""
    found = np.zeros((len(centre), len(skeleton.body_of), 6, skeleton.states))
    for j in range(len(skeleton.joints)):
        by_states = joint_twists(skeleton, model, poses, j, centre).by_states
        moved = np.flatnonzero(skeleton.hanging[j])
        found[:, moved, :, skeleton.state_columns(j)] = by_states[:, None]
    found[..., skeleton.joint_states :] = root_twists(skeleton, poses, centre).by_states[:, None]
    return found
