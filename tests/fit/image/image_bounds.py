"""How well states and geometry can be known from corners at all: the Cramer-Rao bound of simulated views, numerically.

Shares nothing with the fit: objects move by the definitions of the joints, OpenCV projects, central differences make
derivatives. Unknown are all joints' axes, points, pitches and zero poses, further trackers' mounts, a static root's
pose; in each frame the states and a moving root's pose, which the Schur complement takes out; and of the camera what is
asked for. Outliers count as not seen, covariances as known.

A joint's zero is arbitrary: bounds of states are those of their differences from their mean over the frames in which
they are observed. A spherical joint's states err by rotations on the right, exp(q) = exp(truth) exp(error), as what
its zero takes up is a constant of these.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.intrinsics import CameraModel
from station.logs import BoolArray, FloatArray
from tests.benchmarks.made_joints import STATES, MadeJoint, MadeObject, inverse, normals, poses
from tests.fit.image.seen_objects import pixels
from tests.fit.image.simulated_views import Watched, corners_px, shifted

# [m, rad, m/rad, px, s]: what a central difference leaves out, and rounding, are below 1e-7 of a derivative.
STEP = 1e-5
# Relative eigenvalue of a scaled information matrix below which nothing is observed: rounding of the differences.
OBSERVED_ABOVE = 1e-11
# Share of a unit vector above which it is counted among what isn't observed.
UNOBSERVED_SHARE = 1e-3
AXIS_NUMBERS = {"prismatic": 2, "revolute": 2, "screw": 2, "spherical": 0}
POINT_NUMBERS = {"prismatic": 0, "revolute": 2, "screw": 2, "spherical": 3}
PITCH_NUMBERS = {"prismatic": 0, "revolute": 0, "screw": 1, "spherical": 0}
SIX = np.zeros(6)


@dataclass(frozen=True, eq=False)
class JointBound:
    """Of one joint, in the frame of the part that its parent body is named by.

    Attributes:
        axis: (2, 2) [rad^2] least covariance of the direction, along `normals` of the true axis; (0, 0) without one.
        point: (2, 2) [m^2] along them of the point nearest the child's mean position, (3, 3) of a spherical joint's
            centre; (0, 0) without one.
        states: (T, s) least variances; inf where a state isn't observed.
        axis_error: what the best linear estimate of the very noise errs by, (2,), point_error (2 or 3,), state_errors
            (T, s), NaN where not observed: other estimates can be held against it without the scatter of the noise.
        true: the joint in those frames, its point where `point` says.
    """

    axis: FloatArray
    point: FloatArray
    states: FloatArray
    axis_error: FloatArray
    point_error: FloatArray
    state_errors: FloatArray
    true: MadeJoint

    @property
    def state_rms(self) -> float:
        """Root mean square over the frames in which the state is observed, of a vector's length if it is one."""
        seen = np.all(np.isfinite(self.states), axis=-1)
        return float(np.sqrt(self.states[seen].sum(axis=-1).mean()))

    @property
    def efficient_rms(self) -> float:
        """The same of the best linear estimate of the very noise."""
        return float(np.sqrt(np.nanmean(np.sum(self.state_errors**2, axis=-1))))


@dataclass(frozen=True, eq=False)
class ImageBound:
    """Of all joints, and least standard deviations of the camera's numbers by their names."""

    joints: tuple[JointBound, ...]
    camera_std: dict[str, float]


@dataclass(frozen=True, eq=False)
class _Numbers:
    """Some of the numbers of a problem: n, and the corners (T, M, 4, 2) where these (n,) are added to the true ones."""

    count: int
    corners: Callable[[FloatArray], FloatArray]
    prior_std: float = np.inf


def image_bounds(
    watched: Watched, *, frame_parts: Sequence[int] | None = None, camera: dict[str, float] | None = None
) -> ImageBound:
    """Bounds of what was watched.

    Args:
        watched: with the noise that is in it.
        frame_parts: of each body the tracker (index into the parts) that gives it its frame; its first if None.
        camera: deviations before, by name, of the camera's unknown numbers "edge_shift_px", "focal", "readout_s"; inf
            for one that nothing is known of. An edge shift of which nothing is known if None. Of a rolling shutter
            with that exception a frame is taken to be seen at one time.
    """
    made = _at_feet(reframed(watched.made, frame_parts))
    firsts = tuple(frame_parts or (made.body_of.index(b) for b in range(len(made.joints) + 1)))
    unknown = {"edge_shift_px": np.inf} if camera is None else camera
    joints, columns = _joint_numbers(watched, made)
    rest = [*_mount_numbers(watched, made, firsts), *_camera_numbers(watched, made, unknown)]
    root = _root_numbers(watched, made)
    states = [_state_numbers(watched, made, j) for j in range(len(made.joints))]
    moving = made.root == "moving"
    fixed = [*joints, *([] if moving else [root]), *rest]
    own = [*states, *([root] if moving else [])]
    whitening = _whitening(watched)
    A, B = (_derivative(numbers, whitening) for numbers in (fixed, own))
    solved = _solved(A, B, _white_errors(watched, whitening), np.concatenate([[x.prior_std] * x.count for x in fixed]))
    found: list[JointBound] = []
    start = 0
    for joint, (axis, point) in zip(made.joints, columns, strict=True):
        end = start + STATES[joint.type]
        found.append(_joint_bound(solved, joint, axis, point, slice(start, end)))
        start = end
    std = np.sqrt(np.diagonal(solved.covariance)[A.shape[-1] - len(unknown) :])
    return ImageBound(tuple(found), dict(zip(unknown, std.tolist(), strict=True)))


def _corners(watched: Watched, made: MadeObject, camera: CameraModel | None = None) -> FloatArray:
    """(T, M, 4, 2)."""
    px = pixels(camera or watched.true_camera, watched.seen.corners_m(made.T_ref_part))
    return shifted(px, watched.seeing.edge_shift_px)


def reframed(made: MadeObject, frame_parts: Sequence[int] | None) -> MadeObject:
    """The same with bodies' frames where some of their trackers are."""
    if frame_parts is None:
        return made
    T = [made.T_body_part[k] for k in frame_parts]
    joints: list[MadeJoint] = []
    for joint in made.joints:
        back, zero = inverse(T[joint.parent]), joint.T_parent_child_zero
        point = back[:3, :3] @ joint.point_m + back[:3, 3]
        joints.append(
            replace(
                joint,
                axis=back[:3, :3] @ joint.axis,
                point_m=point,
                T_parent_child_zero=back @ zero @ T[joint.child],
            )
        )
    mounts = np.stack([inverse(T[b]) @ mount for b, mount in zip(made.body_of, made.T_body_part, strict=True)])
    q = tuple(  # a rotation vector is in the parent's axes
        q @ T[joint.parent][:3, :3] if joint.type == "spherical" else q
        for joint, q in zip(made.joints, made.q, strict=True)
    )
    return replace(made, joints=tuple(joints), q=q, T_ref_root=made.T_ref_root @ T[0], T_body_part=mounts)


def _at_feet(made: MadeObject) -> MadeObject:
    """The same with axes' points nearest to the mean positions of the children's frames."""
    joints: list[MadeJoint] = []
    for joint, q in zip(made.joints, made.q, strict=True):
        mean = (joint.motion(q) @ joint.T_parent_child_zero)[:, :3, 3].mean(axis=0)
        foot = joint.point_m + joint.axis * (joint.axis @ (mean - joint.point_m))
        joints.append(joint if joint.type == "spherical" else replace(joint, point_m=foot))
    return replace(made, joints=tuple(joints))


def _joint_numbers(watched: Watched, made: MadeObject) -> tuple[list[_Numbers], list[tuple[slice, slice]]]:
    """Numbers of all joints' geometry, and where in them each one's axis and point are."""
    numbers: list[_Numbers] = []
    columns: list[tuple[slice, slice]] = []
    start = 0
    for j, joint in enumerate(made.joints):
        counts = (AXIS_NUMBERS[joint.type], POINT_NUMBERS[joint.type], PITCH_NUMBERS[joint.type], 6)
        ends = start + np.cumsum(counts)
        columns.append((slice(start, int(ends[0])), slice(int(ends[0]), int(ends[1]))))

        def corners(x: FloatArray, j: int = j) -> FloatArray:
            moved = (*made.joints[:j], _moved(made.joints[j], x), *made.joints[j + 1 :])
            return _corners(watched, replace(made, joints=moved))

        numbers.append(_Numbers(sum(counts), corners))
        start = int(ends[-1])
    return numbers, columns


def _moved(joint: MadeJoint, x: FloatArray) -> MadeJoint:
    """A joint with axis, point, pitch and zero pose off by numbers x (n,)."""
    kind, across = joint.type, normals(joint.axis)
    a, p, h, zero = np.split(x, np.cumsum([AXIS_NUMBERS[kind], POINT_NUMBERS[kind], PITCH_NUMBERS[kind]]))
    axis = joint.axis + (a @ across if len(a) else 0.0)
    point = joint.point_m + (p if len(p) == 3 else p @ across if len(p) else 0.0)
    return replace(
        joint,
        axis=axis / np.linalg.norm(axis),
        point_m=point,
        pitch_m_per_rad=joint.pitch_m_per_rad + float(h.sum()),
        T_parent_child_zero=joint.T_parent_child_zero @ poses(zero[3:], zero[:3]),
    )


def _mount_numbers(watched: Watched, made: MadeObject, firsts: tuple[int, ...]) -> list[_Numbers]:
    def moved(k: int) -> Callable[[FloatArray], FloatArray]:
        def corners(x: FloatArray) -> FloatArray:
            mounts = np.array(made.T_body_part)
            mounts[k] = mounts[k] @ poses(x[3:], x[:3])
            return _corners(watched, replace(made, T_body_part=mounts))

        return corners

    return [_Numbers(6, moved(k)) for k in range(len(made.body_of)) if k not in firsts]


def _root_numbers(watched: Watched, made: MadeObject) -> _Numbers:
    def corners(x: FloatArray) -> FloatArray:
        return _corners(watched, replace(made, T_ref_root=made.T_ref_root @ poses(x[3:], x[:3])))

    return _Numbers(6, corners)


def _state_numbers(watched: Watched, made: MadeObject, j: int) -> _Numbers:
    """Of one joint in all frames at once: no frame's corners depend on another's."""

    def corners(x: FloatArray) -> FloatArray:
        q = made.q[j]
        if made.joints[j].type == "spherical":
            moved = (Rotation.from_rotvec(q) * Rotation.from_rotvec(x)).as_rotvec()
        else:
            moved = q + x
        return _corners(watched, replace(made, q=(*made.q[:j], moved, *made.q[j + 1 :])))

    return _Numbers(STATES[made.joints[j].type], corners)


def _camera_numbers(watched: Watched, made: MadeObject, stds: dict[str, float]) -> list[_Numbers]:
    plain = replace(watched, seeing=replace(watched.seeing, edge_shift_px=0.0))

    def shift(x: FloatArray) -> FloatArray:
        return shifted(_corners(plain, made), watched.seeing.edge_shift_px + float(x[0]))

    def focal(x: FloatArray) -> FloatArray:
        matrix = np.array(watched.true_camera.matrix)
        matrix[[0, 1], [0, 1]] *= 1.0 + x[0]
        return _corners(watched, made, replace(watched.true_camera, matrix=matrix))

    def readout(x: FloatArray) -> FloatArray:
        seen, camera = watched.seen, watched.true_camera
        return corners_px(seen, camera, watched.views.t_s, watched.seeing.readout_s + float(x[0]))

    by_name = {"edge_shift_px": shift, "focal": focal, "readout_s": readout}
    return [_Numbers(1, by_name[name], std) for name, std in stds.items()]


def _grid(watched: Watched, values: FloatArray) -> FloatArray:
    """(T, M, ...) of values (N, ...) of the sightings that are none of the outliers; 0 of others."""
    views, good = watched.views, ~watched.outlier
    found = np.zeros((len(views.t_s), len(views.marker_id), *values.shape[1:]))
    found[views.frame[good], views.marker[good]] = values[good]
    return found


def _whitening(watched: Watched) -> FloatArray:
    """(T, M, 8, 8) W with W^T W the inverse of the noise's true covariance."""
    true = watched.views.covariance_px2 / watched.seeing.stated**2
    return _grid(watched, np.asarray(np.linalg.inv(np.linalg.cholesky(true)), dtype=np.float64))


def _white_errors(watched: Watched, whitening: FloatArray) -> FloatArray:
    """(T, 8 M)."""
    white = whitening @ _grid(watched, watched.error_px)[..., None]
    return white.reshape(len(white), -1)


def _derivative(numbers: list[_Numbers], whitening: FloatArray) -> FloatArray:
    """(T, 8 M, n) of the whitened corners by all numbers."""
    T, M = whitening.shape[:2]
    columns = [np.zeros((T, 8 * M, 0))]
    for each in numbers:
        for direction in np.eye(each.count):
            ahead, behind = (each.corners(sign * STEP * direction) for sign in (1.0, -1.0))
            slope = ((ahead - behind) / (2 * STEP)).reshape(T, M, 8, 1)
            columns.append((whitening @ slope).reshape(T, 8 * M, 1))
    return np.concatenate(columns, axis=-1)


@dataclass(frozen=True, eq=False)
class _Solved:
    """Least squares of the linearised problem.

    Attributes:
        covariance: (n, n) of the fixed numbers, as far as they are observed; known: (n,) whether one is at all.
        error: (n,) of them by the very noise.
        own: (T, s, s) covariance of each frame's numbers if the fixed ones were known; own_error (T, s) likewise.
        by_fixed: (T, s, n) how they change with the fixed ones.
        observed: (T, s).
    """

    covariance: FloatArray
    known: BoolArray
    error: FloatArray
    own: FloatArray
    own_error: FloatArray
    by_fixed: FloatArray
    observed: BoolArray

    def least(self, columns: slice) -> FloatArray:
        """Covariance of some of the fixed numbers; infinite variances of those that aren't observed."""
        found, known = self.covariance[columns, columns], self.known[columns]
        return np.where(known[:, None] & known, found, np.diag(np.where(known, 0.0, np.inf)))


def _solved(A: FloatArray, B: FloatArray, noise: FloatArray, prior_std: FloatArray) -> _Solved:
    B_t = np.swapaxes(B, -1, -2)
    own, observed = _inverse(B_t @ B)
    by_fixed = own @ (B_t @ A)
    rows = (A - B @ by_fixed).reshape(-1, A.shape[-1])
    covariance, known = _inverse((rows.T @ rows + np.diag(prior_std**-2.0))[None])
    error = covariance[0] @ (rows.T @ noise.ravel())
    own_error = (own @ (B_t @ noise[..., None]))[..., 0]
    return _Solved(covariance[0], known[0], error, own, own_error, by_fixed, observed)


def _inverse(H: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(..., n, n) inverse information where there is any, and whether (..., n) each number is observed."""
    diagonal = np.diagonal(H, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(H / (scale[..., :, None] * scale[..., None, :]))
    seen = values > OBSERVED_ABOVE * values[..., -1:]
    known = vectors / scale[..., None]
    inverted = (known * np.where(seen, 1 / np.where(seen, values, 1.0), 0.0)[..., None, :]) @ np.swapaxes(known, -1, -2)
    hidden = np.linalg.norm(np.where(seen[..., None, :], 0.0, vectors), axis=-1)
    return inverted, (hidden < UNOBSERVED_SHARE) & (diagonal > 0)


def _joint_bound(solved: _Solved, joint: MadeJoint, axis: slice, point: slice, own: slice) -> JointBound:
    observed = np.all(solved.observed[:, own], axis=-1)
    count = max(int(observed.sum()), 1)
    by_fixed = solved.by_fixed[:, own] - solved.by_fixed[observed, own].mean(axis=0)
    alone = np.diagonal(solved.own, axis1=-2, axis2=-1)[:, own]
    together = alone[observed].sum(axis=0) / count**2
    shared = np.einsum("tsi,ij,tsj->ts", by_fixed, solved.covariance, by_fixed)
    variances = np.where(observed[:, None], alone * (1 - 2 / count) + together + shared, np.inf)
    errors = solved.own_error[:, own] - solved.by_fixed[:, own] @ solved.error
    errors = np.where(observed[:, None], errors - errors[observed].mean(axis=0), np.nan)
    return JointBound(
        solved.least(axis),
        solved.least(point),
        variances,
        solved.error[axis],
        solved.error[point],
        errors,
        joint,
    )
