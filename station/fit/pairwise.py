"""Fit one joint type to the relative poses of many pairs of parts at once, with the states eliminated and outliers
told apart.

For a pair (a, b) the measured poses T_a_b(t) are explained by T(theta, q_t) with right perturbations of covariance
Sigma_t:

    e_v = R_meas^T (t_meas - t_model),  e_w = log(R_model^T R_meas),  e ~ N(0, Sigma_t)

To first order e is the right perturbation of the measured pose; unlike the full logarithm, e_v doesn't change with the
orientation, so that tracks of positions alone need no special residual. A frame is an inlier with this density, or,
with a share that is estimated, an outlier of constant density over the scene. Gauss-Newton steps with
Levenberg-Marquardt damping move the parameters theta; each frame's state is projected out of its whitened Jacobian
(the Schur complement) and put back after. Everything is batched over pairs and frames.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from station.errors import InvalidData
from station.fit.noise import Noise
from station.kinematics import se3
from station.kinematics.joints import JointFrames, JointType
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]

# Degrees of freedom of the Student weights that protect the closed-form start: heavy tails, yet settled in a few
# rounds.
STUDENT_FREEDOMS = 3.0
START_ROUNDS = 3
LM_ITERATIONS = 30
# A pair is settled when a step changes its -2 log likelihood by less than this; 1 would be a standard deviation.
COST_TOLERANCE = 1e-3
# Share of pairs still moving below which the others leave the batch.
SHRINK_BELOW = 0.7
DAMPING_START, DAMPING_FALL, DAMPING_RISE, DAMPING_MIN, DAMPING_MAX = 1e-3, 0.2, 8.0, 1e-9, 1e8
# Share of frames that are outliers: where it starts, and the Beta prior that keeps it off 0 and 1 (counts of frames).
OUTLIER_SHARE_START = 0.05
OUTLIER_PRIOR_OUT, OUTLIER_PRIOR_IN = 0.5, 10.0
# Relative eigenvalue of a scaled normal matrix below which a direction is not observed (positions alone, tiny motions).
OBSERVED_ABOVE = 1e-9
# Rotations have volume 8 pi^2 rad^3, as rotation vectors about any centre.
ROTATION_VOLUME = 8 * np.pi**2


@dataclass(frozen=True, eq=False)
class PairTracks:
    """Relative poses of P pairs over T frames.

    Attributes:
        T_a_b: (P, T, 4, 4), finite throughout; identity where not seen.
        seen: (P, T) both parts were seen.
        oriented: (P, T) seen, and the orientation was measured.
        noise: of the relative poses.
        scene_m3: volume in which an outlier may be.
    """

    T_a_b: FloatArray
    seen: BoolArray
    oriented: BoolArray
    noise: Noise
    scene_m3: float

    @property
    def dimensions(self) -> FloatArray:
        """(P, T) measured numbers a frame: 6, 3 without orientation, 0 unseen."""
        return 3.0 * self.seen + 3.0 * self.oriented

    @property
    def log_outlier_density(self) -> FloatArray:
        """(P, T) logarithm of the density of an outlier [1/m^3 or 1/(m^3 rad^3)]; 0 unseen."""
        return -1.0 * (self.seen * np.log(self.scene_m3) + self.oriented * np.log(ROTATION_VOLUME))

    def take(self, pairs: NDArray[np.intp] | slice) -> PairTracks:
        """The tracks of some of the pairs."""
        return PairTracks(
            self.T_a_b[pairs], self.seen[pairs], self.oriented[pairs], self.noise.take(pairs), self.scene_m3
        )


@dataclass(frozen=True, eq=False)
class Model:
    """P joints of one type: frames (P, ...), states q (P, T, s), noise scales (P, S), share of outliers (P,)."""

    frames: JointFrames
    q: FloatArray
    scales: FloatArray
    outlier_share: FloatArray

    def take(self, pairs: NDArray[np.intp] | BoolArray) -> Model:
        """The models of some of the pairs."""
        return Model(self.frames.take(pairs), self.q[pairs], self.scales[pairs], self.outlier_share[pairs])

    @staticmethod
    def joined(models: Sequence[Model]) -> Model:
        """The models one after another."""
        frames = JointFrames(
            np.concatenate([m.frames.T_parent_axis for m in models]),
            np.concatenate([m.frames.T_axis_child for m in models]),
            np.concatenate([m.frames.form for m in models]),
        )
        q, scales = np.concatenate([m.q for m in models]), np.concatenate([m.scales for m in models])
        return Model(frames, q, scales, np.concatenate([m.outlier_share for m in models]))


@dataclass(frozen=True, eq=False)
class JointFit:
    """A joint type fitted to P pairs.

    Attributes:
        joint: the type.
        model: parameters, states, noise scales.
        inlier: (P, T) probability that a frame is an inlier; 0 unseen.
        chi2: (P, T) whitened squared residual at the best state.
        log_density: (P, T) log of the inliers' Gaussian density at zero residual.
        state_information: (P, T, s, s) inverse covariance of the states given the parameters [1/unit^2].
        residual: (P, T, 6) [m, rad] measured against model.
        information: (P, n, n) normal matrix of the parameters, states projected out.
        coupling: (P, T, s, n) change of a frame's best states with the parameters.
    """

    joint: JointType
    model: Model
    inlier: FloatArray
    chi2: FloatArray
    log_density: FloatArray
    state_information: FloatArray
    residual: FloatArray
    information: FloatArray
    coupling: FloatArray

    def take(self, pairs: NDArray[np.intp]) -> JointFit:
        """The fits of some of the pairs."""
        return self._mapped(lambda array: array[pairs])

    def joined(self, other: JointFit) -> JointFit:
        """The fits of these pairs, then of the others."""
        theirs = iter(other._arrays())
        return self._mapped(lambda array: np.concatenate([array, next(theirs)]))

    def _arrays(self) -> list[FloatArray]:
        found: list[FloatArray] = []
        self._mapped(lambda array: found.append(array) or array)
        return found

    def _mapped(self, change: Callable[[FloatArray], FloatArray]) -> JointFit:
        m = self.model
        frames = JointFrames(change(m.frames.T_parent_axis), change(m.frames.T_axis_child), change(m.frames.form))
        model = Model(frames, change(m.q), change(m.scales), change(m.outlier_share))
        arrays = (self.inlier, self.chi2, self.log_density, self.state_information, self.residual)
        rest = [change(array) for array in (*arrays, self.information, self.coupling)]
        return JointFit(self.joint, model, *rest)


def model_poses(joint: JointType, model: Model) -> tuple[FloatArray, FloatArray]:
    """T_axis_child(q_t) and T_parent_child(q_t), (P, T, 4, 4)."""
    T_axis_child = joint.axis_motion(model.q, model.frames.form[:, None]) @ model.frames.T_axis_child[:, None]
    return T_axis_child, model.frames.T_parent_axis[:, None] @ T_axis_child


def residuals(T_meas: FloatArray, T_model: FloatArray) -> FloatArray:
    """(..., 6) e_v, e_w of measured against model poses (..., 4, 4)."""
    R = np.swapaxes(T_meas[..., :3, :3], -1, -2)
    e_v = (R @ (T_meas[..., :3, 3:] - T_model[..., :3, 3:]))[..., 0]
    e_w = se3.log_so3(np.swapaxes(T_model[..., :3, :3], -1, -2) @ T_meas[..., :3, :3])
    return np.concatenate([e_v, e_w], axis=-1)


def residual_jacobian(residual: FloatArray) -> FloatArray:
    """(..., 6, 6) derivative of `residuals` with respect to a right perturbation of the model pose.

    d e_v = -R_meas^T R_model dv,  d e_w = -Jl^-1(e_w) dw.
    """
    K = np.zeros((*residual.shape, 6))
    K[..., :3, :3] = -se3.exp_so3(-residual[..., 3:])
    K[..., 3:, 3:] = -se3.inverse_left_jacobian_so3(residual[..., 3:])
    return K


def joint_jacobians(joint: JointType, model: Model, T_axis_child: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Right perturbation of the model pose by the parameters (P, T, 6, n) and by the states (P, 6, s).

    With T = F M(q) C:  F exp(xi) gives Ad((M C)^-1) xi;  exp(xi) C gives Ad(C^-1) xi;  M exp(xi) gives Ad(C^-1) xi.
    """
    split, end = len(joint.axis_freedoms), len(joint.axis_freedoms) + len(joint.child_freedoms)
    by_child = se3.adjoint(se3.inverse(model.frames.T_axis_child))
    by_parameters = np.empty((*T_axis_child.shape[:2], 6, end + joint.form_freedoms))
    if split:
        by_parameters[..., :split] = se3.adjoint(se3.inverse(T_axis_child))[..., list(joint.axis_freedoms)]
    by_parameters[..., split:end] = by_child[:, None][..., list(joint.child_freedoms)]
    if joint.form_freedoms:
        by_parameters[..., end:] = by_child[:, None] @ joint.form_twists(model.q, model.frames.form[:, None])
    return by_parameters, by_child @ joint.state_twists(model.frames.form)


def stepped(joint: JointType, model: Model, step: FloatArray, dq: FloatArray) -> Model:
    """The model moved by parameter steps (P, n) and state steps (P, T, s)."""
    return replace(model, frames=stepped_frames(joint, model.frames, step), q=joint.moved(model.q, dq))


def stepped_frames(joint: JointType, frames: JointFrames, step: FloatArray) -> JointFrames:
    """Frames moved by parameter steps (..., n): those of T_parent_axis, of T_axis_child, of the form."""
    split, end = len(joint.axis_freedoms), len(joint.axis_freedoms) + len(joint.child_freedoms)
    xi_axis, xi_child = np.zeros((*step.shape[:-1], 6)), np.zeros((*step.shape[:-1], 6))
    xi_axis[..., list(joint.axis_freedoms)] = step[..., :split]
    xi_child[..., list(joint.child_freedoms)] = step[..., split:end]
    return JointFrames(
        frames.T_parent_axis @ se3.exp(xi_axis), se3.exp(xi_child) @ frames.T_axis_child, frames.form + step[..., end:]
    )


@dataclass(frozen=True, eq=False)
class _Linear:
    """Whitened residuals and Jacobians of P pairs at one model, states projected out."""

    residual: FloatArray  # (P, T, 6)
    whitened: FloatArray  # (P, T, 6)
    by_parameters: FloatArray  # (P, T, 6, n) whitened, orthogonal to by_states
    by_states: FloatArray  # (P, T, 6, s) whitened
    own: FloatArray  # (P, T, s) best change of the states at these parameters
    coupling: FloatArray  # (P, T, s, n)
    state_information: FloatArray  # (P, T, s, s)


def _linearise(joint: JointType, tracks: PairTracks, model: Model, whitener: FloatArray) -> _Linear:
    T_axis_child, T_model = model_poses(joint, model)
    e = residuals(tracks.T_a_b, T_model)
    WK = whitener @ residual_jacobian(e)
    by_parameters, by_states = joint_jacobians(joint, model, T_axis_child)
    A, B = WK @ by_parameters, WK @ by_states[:, None]
    r = (whitener @ e[..., None])[..., 0]
    B_t = np.swapaxes(B, -1, -2)
    information = B_t @ B
    solution = -small_inverse(information) @ B_t
    coupling = solution @ A
    return _Linear(e, r, A + B @ coupling, B, (solution @ r[..., None])[..., 0], coupling, information)


def small_inverse(S: FloatArray) -> FloatArray:
    """(..., s, s) inverse of symmetric S (..., s, s), s small; zero along directions that were not observed."""
    if S.shape[-1] == 0:
        return S
    if S.shape[-1] == 1:
        return np.where(S > 0, 1 / np.where(S > 0, S, 1.0), 0.0)
    values, vectors = np.linalg.eigh(S)
    observed = values > OBSERVED_ABOVE * values[..., -1:]
    inverse = np.where(observed, 1 / np.where(observed, values, 1.0), 0.0)
    return (vectors * inverse[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def _whitened(tracks: PairTracks, joint: JointType, model: Model, whitener: FloatArray) -> FloatArray:
    _, T_model = model_poses(joint, model)
    return (whitener @ residuals(tracks.T_a_b, T_model)[..., None])[..., 0]


def _log_densities(
    tracks: PairTracks, model: Model, chi2: FloatArray, log_density: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(P, T) log of the whole density of each frame, and the probability that it is an inlier."""
    share = model.outlier_share[:, None]
    inside = np.log1p(-share) + log_density - 0.5 * chi2
    outside = np.log(share) + tracks.log_outlier_density
    total = np.logaddexp(inside, outside)
    return total * tracks.seen, np.exp(inside - total) * tracks.seen


def _cost(tracks: PairTracks, model: Model, chi2: FloatArray, log_density: FloatArray) -> FloatArray:
    return -2 * _log_densities(tracks, model, chi2, log_density)[0].sum(axis=-1)


def _damped_step(linear: _Linear, weights: FloatArray, damping: FloatArray) -> tuple[FloatArray, FloatArray]:
    """LM step (P, n) and (P, T, s): columns scaled to unit length, so that one damping suits metres and radians."""
    H, g = _normal_equations(linear, weights)
    scale = np.sqrt(np.diagonal(H, axis1=-2, axis2=-1))
    scale = np.where(scale > 0, scale, 1.0)
    scaled = H / (scale[:, :, None] * scale[:, None, :]) + damping[:, None, None] * np.eye(H.shape[-1])
    step = -np.linalg.solve(scaled, (g / scale)[..., None])[..., 0] / scale
    return step, linear.own + np.einsum("ptsn,pn->pts", linear.coupling, step)


def _normal_equations(linear: _Linear, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    P, T, _, n = linear.by_parameters.shape
    A = (linear.by_parameters * np.sqrt(weights)[..., None, None]).reshape(P, T * 6, n)
    r = (linear.whitened * np.sqrt(weights)[..., None]).reshape(P, T * 6, 1)
    A_t = np.swapaxes(A, -1, -2)
    return A_t @ A, (A_t @ r)[..., 0]


def best_states(joint: JointType, frames: JointFrames, tracks: PairTracks) -> FloatArray:
    """(P, T, s) closed-form states of the measured poses; by position where there is no orientation."""
    M = se3.inverse(frames.T_parent_axis)[:, None] @ tracks.T_a_b
    zero, form = frames.T_axis_child[:, None], frames.form[:, None]
    by_pose = joint.axis_state(M, zero, form)
    if tracks.oriented.all():
        return by_pose
    by_position = joint.axis_state_of_position(M[..., :3, 3], zero[..., :3, 3], form)
    return np.where(tracks.oriented[..., None], by_pose, by_position)


def _start_weights(tracks: PairTracks, joint: JointType, frames: JointFrames) -> tuple[FloatArray, FloatArray]:
    """Student weights (P, T) and noise scales (P, S) of a start's residuals."""
    q = best_states(joint, frames, tracks)
    model = Model(frames, q, np.ones((len(q), 1)), np.full(len(q), OUTLIER_SHARE_START))
    e = residuals(tracks.T_a_b, model_poses(joint, model)[1])
    scales = tracks.noise.robust_scales(e, tracks.seen, tracks.oriented)
    whitener, _ = tracks.noise.whitener(scales, tracks.seen, tracks.oriented)
    chi2 = np.sum((whitener @ e[..., None])[..., 0] ** 2, axis=-1)
    weights = (STUDENT_FREEDOMS + tracks.dimensions) / (STUDENT_FREEDOMS + chi2)
    return weights * tracks.seen, scales


def _closed_form(joint: JointType, tracks: PairTracks, weights: FloatArray, by_pose: bool) -> tuple[JointFrames, ...]:
    if by_pose:
        return joint.starts(tracks.T_a_b, weights * tracks.oriented)
    return joint.position_starts(tracks.T_a_b[..., :3, 3], weights)


def start_models(joint: JointType, tracks: PairTracks, *, by_pose: bool) -> Model:
    """Closed-form start, reweighted a few rounds against outliers; each pair's likeliest of the type's readings."""
    readings = _closed_form(joint, tracks, tracks.seen.astype(np.float64), by_pose)
    best: Model | None = None
    best_cost = np.full(len(tracks.seen), np.inf)
    for index, frames in enumerate(readings):  # one to three readings of the data
        weights, scales = _start_weights(tracks, joint, frames)
        for _ in range(START_ROUNDS):  # each round's weights come from the last
            frames = _closed_form(joint, tracks, weights, by_pose)[index]
            weights, scales = _start_weights(tracks, joint, frames)
        share = np.full(len(best_cost), OUTLIER_SHARE_START)
        model = Model(frames, best_states(joint, frames, tracks), scales, share)
        whitener, log_density = tracks.noise.whitener(scales, tracks.seen, tracks.oriented)
        chi2 = np.sum(_whitened(tracks, joint, model, whitener) ** 2, axis=-1)
        cost = _cost(tracks, model, chi2, log_density)
        best = model if best is None else _choose(cost < best_cost, model, best)
        best_cost = np.fmin(cost, best_cost)
    if best is None:
        raise InvalidData(f"joint type {joint.name} offers no start for a fit")
    return best


def _choose(first: BoolArray, a: Model, b: Model) -> Model:
    """Model a for the pairs where `first` (P,), else b."""
    wide = first[:, None, None]
    frames = JointFrames(
        np.where(wide, a.frames.T_parent_axis, b.frames.T_parent_axis),
        np.where(wide, a.frames.T_axis_child, b.frames.T_axis_child),
        np.where(first[:, None], a.frames.form, b.frames.form),
    )
    tall = first[:, None]
    share = np.where(first, a.outlier_share, b.outlier_share)
    return Model(frames, np.where(wide, a.q, b.q), np.where(tall, a.scales, b.scales), share)


def _updated_noise(
    tracks: PairTracks, model: Model, linear: _Linear, whitener: FloatArray, inlier: FloatArray
) -> Model:
    """One round of the noise scales' restricted likelihood, and the outlier share's posterior mean."""
    scales = tracks.noise.updated_scales(
        model.scales,
        whitener,
        linear.whitened,
        linear.by_states,
        linear.state_information,
        inlier,
        linear.by_parameters.shape[-1],
    )
    seen = tracks.seen.sum(axis=-1)
    outliers = seen - inlier.sum(axis=-1)
    share = (outliers + OUTLIER_PRIOR_OUT) / (seen + OUTLIER_PRIOR_OUT + OUTLIER_PRIOR_IN)
    return replace(model, scales=scales, outlier_share=share)


def refine(
    joint: JointType,
    tracks: PairTracks,
    model: Model,
    *,
    iterations: int = LM_ITERATIONS,
    tolerance: float = COST_TOLERANCE,
) -> JointFit:
    """Maximise the likelihood of parameters, states, noise scales and outlier share from a start.

    Pairs that have settled, to `tolerance` of -2 log likelihood, leave the batch.
    """
    settled: list[tuple[NDArray[np.intp], Model]] = []
    rows, work = np.arange(len(model.q)), tracks
    damping, last = np.full(len(rows), DAMPING_START), np.full(len(rows), np.inf)
    for _ in range(iterations):  # each step starts where the last one ended
        model, damping, cost = _improved(joint, work, model, damping)
        moving = ~(np.abs(last - cost) <= tolerance)
        last = cost
        if moving.mean() < SHRINK_BELOW:
            settled.append((rows[~moving], model.take(~moving)))
            rows, model, damping, last = rows[moving], model.take(moving), damping[moving], last[moving]
            work = work.take(np.flatnonzero(moving))
        if not rows.size:
            break
    settled.append((rows, model))
    order = np.argsort(np.concatenate([rows for rows, _ in settled]))
    model = Model.joined([model for _, model in settled]).take(order)
    return _finished(joint, tracks, model, *tracks.noise.whitener(model.scales, tracks.seen, tracks.oriented))


def _improved(
    joint: JointType, tracks: PairTracks, model: Model, damping: FloatArray
) -> tuple[Model, FloatArray, FloatArray]:
    """One damped Gauss-Newton step, where it is better, and new noise scales; with damping and cost (P,)."""
    whitener, log_density = tracks.noise.whitener(model.scales, tracks.seen, tracks.oriented)
    linear = _linearise(joint, tracks, model, whitener)
    chi2 = np.sum(linear.whitened**2, axis=-1)
    log_total, inlier = _log_densities(tracks, model, chi2, log_density)
    cost = -2 * log_total.sum(axis=-1)
    tried = stepped(joint, model, *_damped_step(linear, inlier, damping))
    chi2 = np.sum(_whitened(tracks, joint, tried, whitener) ** 2, axis=-1)
    tried_cost = _cost(tracks, tried, chi2, log_density)
    better = tried_cost <= cost
    model = _choose(better, tried, model)
    damping = np.clip(damping * np.where(better, DAMPING_FALL, DAMPING_RISE), DAMPING_MIN, DAMPING_MAX)
    return _updated_noise(tracks, model, linear, whitener, inlier), damping, np.fmin(cost, tried_cost)


def _finished(
    joint: JointType, tracks: PairTracks, model: Model, whitener: FloatArray, log_density: FloatArray
) -> JointFit:
    linear = _linearise(joint, tracks, model, whitener)
    chi2 = np.sum(linear.whitened**2, axis=-1)
    _, inlier = _log_densities(tracks, model, chi2, log_density)
    information, _ = _normal_equations(linear, inlier)
    return JointFit(
        joint,
        model,
        inlier,
        chi2,
        log_density,
        linear.state_information * tracks.seen[..., None, None],
        linear.residual,
        information,
        linear.coupling,
    )


def fit_joint(
    joint: JointType,
    tracks: PairTracks,
    *,
    by_pose: bool,
    iterations: int = LM_ITERATIONS,
    tolerance: float = COST_TOLERANCE,
) -> JointFit:
    """Fit one joint type to all pairs, closed form then least squares; `by_pose` if orientations were measured."""
    start = start_models(joint, tracks, by_pose=by_pose)
    return refine(joint, tracks, start, iterations=iterations, tolerance=tolerance)


def parameter_covariance(information: FloatArray, unreduced: FloatArray | None = None) -> FloatArray:
    """(..., n, n) inverse of a normal matrix; directions that were not observed change nothing, and get no variance.

    Args:
        information: (..., n, n) with the states eliminated.
        unreduced: (..., n) its diagonal before that; its own if None. A direction that only shifts the zero of the
            states, as there is one where positions alone were measured, keeps a vanishing part of it.
    """
    diagonal = np.diagonal(information, axis1=-2, axis2=-1) if unreduced is None else unreduced
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(information / (scale[..., :, None] * scale[..., None, :]))
    inverse = np.where(values > OBSERVED_ABOVE, 1 / np.maximum(values, OBSERVED_ABOVE), 0.0)
    scaled = vectors / scale[..., :, None]
    return (scaled * inverse[..., None, :]) @ np.swapaxes(scaled, -1, -2)
