"""What a fit of pairs takes, moves and returns: tracks of relative poses, models of joints, fits.

For a pair (a, b) the measured poses T_a_b(t) are explained by T(theta, q_t) with right perturbations of covariance
Sigma_t:

    e_v = R_meas^T (t_meas - t_model),  e_w = log(R_model^T R_meas),  e ~ N(0, Sigma_t)

To first order e is the right perturbation of the measured pose; unlike the full logarithm, e_v doesn't change with the
orientation, so that tracks of positions alone need no special residual.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from station.fit.noise import Noise
from station.fit.pair_data import PairData, pair_data
from station.kinematics import se3
from station.kinematics.joints import JointFrames, JointType
from station.logs import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]

# Share of frames that are outliers: where it starts.
OUTLIER_SHARE_START = 0.05
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
        scene_m3: (P,) volume in which an outlier may be.
    """

    T_a_b: FloatArray
    seen: BoolArray
    oriented: BoolArray
    noise: Noise
    scene_m3: FloatArray

    @property
    def dimensions(self) -> FloatArray:
        """(P, T) measured numbers a frame: 6, 3 without orientation, 0 unseen."""
        return 3.0 * self.seen + 3.0 * self.oriented

    @property
    def log_outlier_density(self) -> FloatArray:
        """(P, T) logarithm of the density of an outlier [1/m^3 or 1/(m^3 rad^3)]; 0 unseen."""
        return -1.0 * (self.seen * np.log(self.scene_m3)[:, None] + self.oriented * np.log(ROTATION_VOLUME))

    @property
    def scene_m(self) -> FloatArray:
        """(P,) side of the volume."""
        return self.scene_m3 ** (1 / 3)

    @property
    def lab_m(self) -> FloatArray:
        """(P,) what stands for a metre where sizes usual in a lab are told: more than one in a scene that is larger."""
        return np.maximum(self.scene_m, 1.0)

    @cached_property
    def data(self) -> PairData:
        """The same with entries first; worked out when it is first asked for."""
        return pair_data(self.T_a_b, self.seen, self.oriented, self.noise, self.log_outlier_density, self.scene_m)

    def take(self, pairs: NDArray[np.intp] | slice) -> PairTracks:
        """The tracks of some of the pairs."""
        return PairTracks(
            self.T_a_b[pairs], self.seen[pairs], self.oriented[pairs], self.noise.take(pairs), self.scene_m3[pairs]
        )

    @staticmethod
    def all_of(tracks: Sequence[PairTracks]) -> PairTracks:
        """The tracks one after another; all have as many frames, and a noise of the same kind."""
        if len(tracks) == 1:
            return tracks[0]
        return PairTracks(
            np.concatenate([each.T_a_b for each in tracks]),
            np.concatenate([each.seen for each in tracks]),
            np.concatenate([each.oriented for each in tracks]),
            Noise.all_of([each.noise for each in tracks]),
            np.concatenate([each.scene_m3 for each in tracks]),
        )


@dataclass(frozen=True, eq=False)
class Model:
    """P joints of one type.

    Attributes:
        frames: (P, ...).
        q: (P, T, s) states.
        scales: (P, S) of the noise.
        outlier_share: (P,) of all frames.
        flip_share: (P,) of the inliers, whose position is right but not their orientation.
    """

    frames: JointFrames
    q: FloatArray
    scales: FloatArray
    outlier_share: FloatArray
    flip_share: FloatArray

    def mapped(self, change: Callable[[FloatArray], FloatArray]) -> Model:
        """With each array changed."""
        return Model.of([change(array) for array in self.arrays])

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All arrays."""
        f = self.frames
        return f.T_parent_axis, f.T_axis_child, f.form, self.q, self.scales, self.outlier_share, self.flip_share

    @staticmethod
    def of(arrays: Sequence[FloatArray]) -> Model:
        """A model of its `arrays`."""
        return Model(JointFrames(*arrays[:3]), *arrays[3:])

    def take(self, pairs: IntArray | BoolArray) -> Model:
        """The models of some of the pairs."""
        return self.mapped(lambda array: array[pairs])

    def where(self, chosen: BoolArray, other: Model) -> Model:
        """This model for the chosen pairs (P,), for the rest the other."""
        return Model.of(
            [
                np.where(chosen.reshape(-1, *[1] * (mine.ndim - 1)), mine, theirs)
                for mine, theirs in zip(self.arrays, other.arrays, strict=True)
            ]
        )

    def with_rows(self, rows: IntArray, some: Model) -> Model:
        """With other models for some of the pairs."""
        theirs = iter(some.arrays)

        def changed(array: FloatArray) -> FloatArray:
            array = array.copy()
            array[rows] = next(theirs)
            return array

        return self.mapped(changed)


@dataclass(frozen=True, eq=False)
class JointFit:
    """A joint type fitted to P pairs.

    Attributes:
        joint: the type.
        model: parameters, states, noise scales.
        inlier: (P, T) probability that a frame is an inlier; 0 unseen.
        chi2: (P, T) whitened squared residual at the best state.
        log_density: (P, T) log of the inliers' density at zero residual: less chi2 / 2, it is that of the residual.
        state_information: (P, T, s, s) inverse covariance of the states given the parameters [1/unit^2].
        residual: (P, T, 6) [m, rad] measured against model; no rotation where only the orientation was wrong.
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

    def take(self, pairs: IntArray) -> JointFit:
        """The fits of some of the pairs."""
        return self._mapped(lambda array: array[pairs])

    @staticmethod
    def all_of(fits: Sequence[JointFit]) -> JointFit:
        """The fits one after another."""
        columns = zip(*(fit._arrays for fit in fits), strict=True)
        return fits[0]._mapped(lambda _: np.concatenate(next(columns)))

    @property
    def _arrays(self) -> list[FloatArray]:
        found: list[FloatArray] = []
        self._mapped(lambda array: found.append(array) or array)
        return found

    def _mapped(self, change: Callable[[FloatArray], FloatArray]) -> JointFit:
        arrays = (self.inlier, self.chi2, self.log_density, self.state_information, self.residual)
        rest = [change(array) for array in (*arrays, self.information, self.coupling)]
        return JointFit(self.joint, self.model.mapped(change), *rest)


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


def stepped_frames(joint: JointType, frames: JointFrames, step: FloatArray) -> JointFrames:
    """Frames moved by parameter steps (..., n): those of T_parent_axis, of T_axis_child, of the form."""
    return moved_frames(joint, frames, se3.exp(frame_twists(joint, step)), step)


def frame_twists(joint: JointType, step: FloatArray) -> FloatArray:
    """(2, ..., 6) twists of T_parent_axis and of T_axis_child by parameter steps (..., n)."""
    split, end = len(joint.axis_freedoms), len(joint.axis_freedoms) + len(joint.child_freedoms)
    twists = np.zeros((2, *step.shape[:-1], 6))
    twists[0][..., list(joint.axis_freedoms)] = step[..., :split]
    twists[1][..., list(joint.child_freedoms)] = step[..., split:end]
    return twists


def moved_frames(joint: JointType, frames: JointFrames, motions: FloatArray, step: FloatArray) -> JointFrames:
    """Frames moved by the motions (2, ..., 4, 4) of `frame_twists`, the form by its steps (..., n)."""
    end = len(joint.axis_freedoms) + len(joint.child_freedoms)
    of_axis, of_child = motions
    return JointFrames(frames.T_parent_axis @ of_axis, of_child @ frames.T_axis_child, frames.form + step[..., end:])


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
