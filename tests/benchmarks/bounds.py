"""Cramer-Rao bounds of made objects: how well any unbiased fit can know the axes and points, computed numerically.

The noise-free poses are differentiated by central differences with respect to all parameters (axes, points, pitches,
zero poses, mounts, a static root's pose) and to all states (the joints', a moving root's pose); each frame's states are
eliminated by the Schur complement. A joint's zero is arbitrary: it is put at its state in the first frame, which leaves
axis and point as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from station.logs import FloatArray
from tests.benchmarks.made_joints import STATES, MadeJoint, MadeObject, normals, poses

STEP = 1e-5  # [m, rad, m/rad]: central differences are then good to 1e-10
# Relative eigenvalue of a scaled information matrix below which nothing is observed: rounding of the differences.
OBSERVED_ABOVE = 1e-11
# Draws for the median of a norm: good to 0.5 %.
DRAWS = 40_001
AXIS_NUMBERS = {"rigid": 0, "prismatic": 2, "revolute": 2, "screw": 2, "spherical": 0}
POINT_NUMBERS = {"rigid": 0, "prismatic": 0, "revolute": 2, "screw": 2, "spherical": 3}
PITCH_NUMBERS = {"rigid": 0, "prismatic": 0, "revolute": 0, "screw": 1, "spherical": 0}


@dataclass(frozen=True, eq=False)
class Bound:
    """Least covariance (n, n) of the parameters, and `efficient` (n,): the errors of the best linear estimate.

    The latter belongs to the very noise that the log has; its errors are as large as the bound says, so an estimate can
    be held against it without the scatter of the noise. Columns of a joint: axis (2), point (2 or 3), pitch, zero (6).
    """

    covariance: FloatArray
    efficient: FloatArray
    axis_columns: tuple[slice, ...]
    point_columns: tuple[slice, ...]

    def axis(self, joint: int) -> FloatArray:
        """(2, 2) [rad^2] covariance of the direction of a joint's axis, along `normals(axis)`."""
        return self.covariance[self.axis_columns[joint], self.axis_columns[joint]]

    def point(self, joint: int) -> FloatArray:
        """(2, 2) [m^2] along `normals(axis)`, or (3, 3) for a spherical joint's centre."""
        return self.covariance[self.point_columns[joint], self.point_columns[joint]]


def median_norm(covariance: FloatArray) -> float:
    """Median length of a Gaussian vector with this covariance (k, k); NaN for k = 0."""
    if not covariance.size:
        return np.nan
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(len(covariance)), covariance, DRAWS, method="eigh")
    return float(np.median(np.linalg.norm(draws, axis=-1)))


def bound(
    made: MadeObject,
    noise: FloatArray,
    std_m: float,
    std_rad: float,
    *,
    seen: FloatArray | None = None,
    positions_only: bool = False,
    frame_parts: Sequence[int] | None = None,
) -> Bound:
    """The bound of a made object.

    Args:
        made: the object; axis and point are told in the frames of its bodies.
        noise: (T, K, 6) right perturbations in the log [m, rad], independent, of deviations `std_m` and `std_rad`.
        std_m: of each axis.
        std_rad: of each axis.
        seen: (T, K) 1 where a part was seen, else 0; everywhere if None.
        positions_only: whether orientations were not measured.
        frame_parts: a part for each body that has one, fixed to its body's frame; the first ones if None.
    """
    T, K = noise.shape[:2]
    weights = np.tile(np.repeat([1 / std_m, 0.0 if positions_only else 1 / std_rad], 3), (T, K, 1))
    if seen is not None:
        weights = weights * seen[..., None]
    first = [made.body_of.index(body) for body in sorted(set(made.body_of))]
    moved = [k for k in range(K) if k not in (first if frame_parts is None else frame_parts)]
    A = weights.reshape(T, 6 * K, 1) * _by_parameters(made, moved)
    B = weights.reshape(T, 6 * K, 1) * _by_states(made)
    information = np.linalg.pinv(_swapped(B) @ B, rcond=OBSERVED_ABOVE, hermitian=True)
    A_free = A - B @ (information @ (_swapped(B) @ A))
    covariance = _inverse(np.einsum("tri,trj->ij", A_free, A_free))
    error = covariance @ np.einsum("tri,tr->i", A_free, (weights * noise).reshape(T, 6 * K))
    starts = np.cumsum([0, *(_numbers(joint) for joint in made.joints)])[:-1]
    ends = [start + AXIS_NUMBERS[joint.type] for start, joint in zip(starts, made.joints, strict=True)]
    axes = tuple(slice(start, end) for start, end in zip(starts, ends, strict=True))
    points = tuple(slice(end, end + POINT_NUMBERS[j.type]) for end, j in zip(ends, made.joints, strict=True))
    return Bound(covariance, error, axes, points)


def _swapped(A: FloatArray) -> FloatArray:
    return np.swapaxes(A, -1, -2)


def _inverse(H: FloatArray) -> FloatArray:
    scale = np.sqrt(np.where(np.diagonal(H) > 0, np.diagonal(H), 1.0))
    scaled = np.linalg.pinv(H / np.outer(scale, scale), rcond=OBSERVED_ABOVE, hermitian=True)
    return scaled / np.outer(scale, scale)


def _numbers(joint: MadeJoint) -> int:
    return AXIS_NUMBERS[joint.type] + POINT_NUMBERS[joint.type] + PITCH_NUMBERS[joint.type] + 6


def _moved_joint(joint: MadeJoint, step: FloatArray) -> MadeJoint:
    """The joint displaced by its columns (n_j,)."""
    across = normals(joint.axis)
    of_axis, of_point, of_pitch, v, w = np.split(
        step, np.cumsum([AXIS_NUMBERS[joint.type], POINT_NUMBERS[joint.type], PITCH_NUMBERS[joint.type], 3])
    )
    axis = joint.axis + of_axis @ across[: len(of_axis)]
    point = joint.point_m + of_point @ (np.eye(3) if len(of_point) == 3 else across[: len(of_point)])
    return replace(
        joint,
        axis=axis / np.linalg.norm(axis),
        point_m=point,
        pitch_m_per_rad=joint.pitch_m_per_rad + float(of_pitch.sum()),
        T_parent_child_zero=joint.T_parent_child_zero @ poses(w, v),
    )


def _displaced(made: MadeObject, step: FloatArray, mounts: Sequence[int]) -> MadeObject:
    """The object displaced by all parameters (n,)."""
    ends = np.cumsum([_numbers(joint) for joint in made.joints]).tolist()
    *of_joints, rest = np.split(step, ends)
    joints = tuple(_moved_joint(joint, delta) for joint, delta in zip(made.joints, of_joints, strict=True))
    T_body_part, T_ref_root = made.T_body_part.copy(), made.T_ref_root
    for k, xi in zip(mounts, rest[: 6 * len(mounts)].reshape(-1, 6), strict=True):
        T_body_part[k] = T_body_part[k] @ poses(xi[3:], xi[:3])
    if made.root == "static":
        T_ref_root = T_ref_root @ poses(rest[-3:], rest[-6:-3])
    return replace(made, joints=joints, T_body_part=T_body_part, T_ref_root=T_ref_root)


def _by_parameters(made: MadeObject, mounts: Sequence[int]) -> FloatArray:
    """(T, 6 K, n) right perturbations of the parts' poses."""
    n = sum(_numbers(joint) for joint in made.joints) + 6 * len(mounts) + 6 * (made.root == "static")
    return _differences(made, [(_displaced(made, s, mounts), _displaced(made, -s, mounts)) for s in STEP * np.eye(n)])


def _by_states(made: MadeObject) -> FloatArray:
    """(T, 6 K, s); zero for the joints' states in the first frame, which say where zero is."""
    pairs: list[tuple[MadeObject, MadeObject]] = []
    for j, joint in enumerate(made.joints):
        for step in STEP * np.eye(STATES[joint.type]):
            changed = [(*made.q[:j], made.q[j] + sign * step, *made.q[j + 1 :]) for sign in (1, -1)]
            pairs.append((replace(made, q=changed[0]), replace(made, q=changed[1])))
    by_joints = _differences(made, pairs)
    by_joints[:1] = 0.0
    if made.root != "moving":
        return by_joints
    moved = [[made.T_ref_root @ poses(s * xi[3:], s * xi[:3]) for s in (1, -1)] for xi in STEP * np.eye(6)]
    roots = [(replace(made, T_ref_root=a), replace(made, T_ref_root=b)) for a, b in moved]
    return np.concatenate([by_joints, _differences(made, roots)], axis=-1)


def _differences(made: MadeObject, pairs: Sequence[tuple[MadeObject, MadeObject]]) -> FloatArray:
    T_ref_part = made.T_ref_part
    columns = [(_perturbation(T_ref_part, a) - _perturbation(T_ref_part, b)) / (2 * STEP) for a, b in pairs]
    T, K = T_ref_part.shape[:2]
    return np.stack(columns, axis=-1).reshape(T, 6 * K, -1) if columns else np.zeros((T, 6 * K, 0))


def _perturbation(T_ref_part: FloatArray, made: MadeObject) -> FloatArray:
    """(T, K, 6) right perturbations that take the poses to those of another object."""
    other = made.T_ref_part
    R = _swapped(T_ref_part[..., :3, :3])
    v = (R @ (other[..., :3, 3:] - T_ref_part[..., :3, 3:]))[..., 0]
    return np.concatenate([v, Rotation.from_matrix(R @ other[..., :3, :3]).as_rotvec()], axis=-1)
