"""A camera's matrix and distortion from views of a flat board: weighted least squares over all views at once.

Unknowns are fx, fy, cx, cy, k1, k2, p1, p2, k3 and the board's pose in each view. Weak priors say what any camera is
like (see `Priors`): good views outweigh them by factors of a hundred and more; what bad views leave open stays near
what is plausible, with a standard deviation that says that it was left open, where plain least squares would give wild
values. Each view has its own noise, estimated from its residuals; corners far beyond it are dropped.

The poses are eliminated from the normal equations (Schur complement; B. Triggs et al., Bundle Adjustment, 2000, 6.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.errors import CalibrationError
from calibration.intrinsics import CameraModel, FloatArray, project, project_jacobian

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
LEAST_VIEWS = 3
LEAST_CORNERS = 6

# Starts: focal lengths as shares of the image's width (a wide webcam, a common one, a long lens).
START_SHARES = (0.6, 1.0, 1.8)
START_STEPS, MAX_STEPS = 12, 60
FIRST_DAMPING, DAMPING_FACTOR, LARGEST_DAMPING = 1e-3, 10.0, 1e8
SMALL_GAIN = 1e-9  # relative fall of the cost that ends the steps
POSE_STEPS = 6
# Reweighting: noise of each view, and corners beyond so many of its standard deviations are dropped.
ROUNDS = 5
STRAY_SIGMAS = 4.5
MAD_TO_SIGMA = 1.4826
SMALLEST_SIGMA_PX = 0.005
# A view's noise is drawn towards that of all by as many residuals as this.
SHARED_RESIDUALS = 20.0


@dataclass(frozen=True)
class Priors:
    """What is plausible before any view is seen, as standard deviations; each as an effect on the image.

    Attributes:
        focal: of log(f / width), about a focal length of the image's width.
        aspect: of log(fy / fx).
        centre: of the principal point about the image's middle, in image widths.
        radial: of what each of k1 r^2, k2 r^4, k3 r^6 does to the radius at the image's corner, as share of it.
        tangential: the same of 3 p r.
    """

    focal: float = 0.6
    aspect: float = 0.1
    centre: float = 0.1
    radial: float = 0.3
    tangential: float = 0.03


@dataclass(frozen=True, eq=False)
class Corners:
    """All corners of V views, view after view.

    Attributes:
        size_px: (width, height) of the images.
        view: (P,) of each corner, rising from 0.
        points_m: (P, 3) on the board.
        px: (P, 2) where they are seen.
    """

    size_px: tuple[int, int]
    view: IntArray
    points_m: FloatArray
    px: FloatArray

    @property
    def views(self) -> int:
        """How many views there are."""
        return int(self.view[-1]) + 1 if len(self.view) else 0

    def of(self, chosen: BoolArray) -> Corners:
        """The corners of the views (V,) that are chosen, numbered anew."""
        kept = chosen[self.view]
        number = np.cumsum(chosen) - 1
        return Corners(self.size_px, number[self.view[kept]], self.points_m[kept], self.px[kept])


def stack_views(size_px: tuple[int, int], points_m: Sequence[FloatArray], px: Sequence[FloatArray]) -> Corners:
    """Corners of the views (N_v, 3) on the board and (N_v, 2) in the image.

    Raises:
        CalibrationError: too few views, or too few corners in one.
    """
    if len(px) < LEAST_VIEWS:
        raise CalibrationError(f"{len(px)} views of the board; want at least {LEAST_VIEWS}, 15 for a good calibration")
    for number, corners in enumerate(px):
        if len(corners) < LEAST_CORNERS:
            raise CalibrationError(f"view {number} shows {len(corners)} corners; want at least {LEAST_CORNERS}")
    view = np.repeat(np.arange(len(px)), [len(corners) for corners in px])
    return Corners(size_px, view, np.concatenate(list(points_m)), np.concatenate(list(px)))


@dataclass(frozen=True, eq=False)
class CameraFit:
    """A fitted camera.

    Attributes:
        camera: with rms_px and standard deviations.
        covariance: (9, 9) of PARAMETERS.
        T_cam_board: (V, 4, 4).
        residual_px: (P, 2) seen less projected.
        used: (P,) False for corners that were dropped.
        sigma_px: (V,) standard deviation of a corner coordinate in each view.
    """

    camera: CameraModel
    covariance: FloatArray
    T_cam_board: FloatArray
    residual_px: FloatArray
    used: BoolArray
    sigma_px: FloatArray

    @property
    def std(self) -> FloatArray:
        """(9,) standard deviations of PARAMETERS."""
        return np.sqrt(np.diagonal(self.covariance))


def parameters_of(camera: CameraModel) -> FloatArray:
    """(9,) PARAMETERS of a camera."""
    return np.concatenate([camera.matrix[[0, 1], [0, 1]], camera.matrix[:2, 2], camera.distortion])


def camera_of(parameters: FloatArray, size_px: tuple[int, int]) -> CameraModel:
    """The camera with these PARAMETERS (9,)."""
    fx, fy, cx, cy = parameters[:4]
    return CameraModel(size_px, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), parameters[4:])


def fit_camera(corners: Corners, priors: Priors | None = None) -> CameraFit:
    """The camera that saw the corners, with the board's poses and honest uncertainties; see the module's text.

    Raises:
        CalibrationError: nothing fits: the corners aren't those of one flat board seen by one camera.
    """
    return _robust(_best_start(corners, priors or Priors()), corners, priors or Priors())


def refit_camera(fit: CameraFit, corners: Corners, chosen: BoolArray, priors: Priors | None = None) -> CameraFit:
    """The fit of the views (V,) chosen alone, starting from that of all."""
    state = _State(parameters_of(fit.camera), fit.T_cam_board[chosen])
    return _robust(state, corners.of(chosen), priors or Priors())


@dataclass(frozen=True, eq=False)
class _State:
    parameters: FloatArray
    T_cam_board: FloatArray


def _best_start(corners: Corners, priors: Priors) -> _State:
    """The best of a few focal lengths after some steps each, with robust weights."""
    width, height = corners.size_px
    tried: list[tuple[float, _State]] = []
    for share in START_SHARES:  # few starts
        f = share * width
        parameters = np.array([f, f, (width - 1) / 2, (height - 1) / 2, 0, 0, 0, 0, 0], np.float64)
        poses = board_poses(camera_of(parameters, corners.size_px), corners)
        if poses is None:
            continue
        state = _State(parameters, poses)
        for _ in range(2):  # the first weights are those of rough poses
            sigma, used = _noise(_residuals(state, corners), corners)
            state, _ = _descend(state, corners, sigma, used, priors, START_STEPS)
        residual = np.abs(_residuals(state, corners))
        tried.append((float(np.median(residual)), state))
    if not tried:
        raise CalibrationError(
            "the corners fit no pose of the board in front of a camera\n"
            "is the board the one that is described (squares, dictionary), and is it flat?"
        )
    return min(tried, key=lambda each: each[0])[1]


def board_poses(camera: CameraModel, corners: Corners) -> FloatArray | None:
    """(V, 4, 4) poses of the board in each view, by IPPE; None where a view has none before the camera."""
    poses = np.tile(np.eye(4), (corners.views, 1, 1))
    for v in range(corners.views):  # OpenCV solves one view at a time
        mine = corners.view == v
        done, rvec, tvec = cv2.solvePnP(
            corners.points_m[mine], corners.px[mine], camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE
        )
        if not done or not np.all(np.isfinite(tvec)) or np.ravel(tvec)[2] <= 0:
            return None
        poses[v, :3, :3], _ = cv2.Rodrigues(rvec)
        poses[v, :3, 3] = np.ravel(tvec)
    return poses


def refine_poses(camera: CameraModel, corners: Corners, T_cam_board: FloatArray) -> FloatArray:
    """Poses (V, 4, 4) at the least reprojection error with the camera as it is, corners far off left out."""
    state = _State(parameters_of(camera), T_cam_board)
    for _ in range(POSE_STEPS):
        sigma, used = _noise(_residuals(state, corners), corners)
        normal = _normal(state, corners, sigma, used, Priors())
        moved = _moved(
            state, np.zeros(len(PARAMETERS)), np.einsum("vij,vj->vi", normal.pose_inverse, normal.pose_gradient)
        )
        state = moved or state
    return state.T_cam_board


def _robust(state: _State, corners: Corners, priors: Priors) -> CameraFit:
    sigma, used = _noise(_residuals(state, corners), corners)
    for _ in range(ROUNDS):  # weights follow the residuals, and these the weights
        state, _ = _descend(state, corners, sigma, used, priors, MAX_STEPS)
        sigma, used = _noise(_residuals(state, corners), corners)
    residual = _residuals(state, corners)
    camera = camera_of(state.parameters, corners.size_px)
    normal = _normal(state, corners, sigma, used, priors)
    covariance = np.linalg.inv(_scaled(normal.reduced)) / np.outer(_root(normal.reduced), _root(normal.reduced))
    std = np.sqrt(np.diagonal(covariance))
    matrix_std = np.zeros((3, 3))
    matrix_std[[0, 1, 0, 1], [0, 1, 2, 2]] = std[:4]
    rms_px = float(np.sqrt(np.mean(np.asarray(residual[used] ** 2)) * 2))
    camera = CameraModel(
        camera.size_px, camera.matrix, camera.distortion, rms_px=rms_px, matrix_std=matrix_std, distortion_std=std[4:]
    )
    return CameraFit(camera, covariance, state.T_cam_board, residual, used, sigma)


def _noise(residual_px: FloatArray, corners: Corners) -> tuple[FloatArray, BoolArray]:
    """Noise (V,) of a coordinate in each view, and which corners (P,) aren't far beyond it.

    Robust first, for what is far; then the RMS of the rest, corrected for the pose that every view fits to itself.
    """
    size = np.abs(residual_px)
    middles = np.array([float(np.median(size[corners.view == v])) for v in range(corners.views)])
    robust = np.maximum(MAD_TO_SIGMA * middles, SMALLEST_SIGMA_PX)
    robust = np.maximum(robust, 0.5 * float(np.median(robust)))
    used = np.all(size <= STRAY_SIGMAS * robust[corners.view, None], axis=1)
    squares = np.bincount(corners.view, np.where(used, np.sum(size**2, axis=1), 0), minlength=corners.views)
    count = 2.0 * np.bincount(corners.view, used, minlength=corners.views)
    free = np.maximum(count - 6 - len(PARAMETERS) / corners.views, 1.0)
    shared = float(np.median(squares / free))
    variance = (squares + SHARED_RESIDUALS * shared) / (free + SHARED_RESIDUALS)
    return np.maximum(np.sqrt(variance), SMALLEST_SIGMA_PX), used


def _residuals(state: _State, corners: Corners) -> FloatArray:
    """(P, 2) seen less projected; large where a corner would be behind the camera."""
    T = state.T_cam_board[corners.view]
    p_cam = (T[:, :3, :3] @ corners.points_m[..., None])[..., 0] + T[:, :3, 3]
    seen = corners.px - project(camera_of(state.parameters, corners.size_px), p_cam)
    return np.where(np.isfinite(seen), seen, 1e6)


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations: of the parameters after the poses were eliminated, and what gives the poses' steps back."""

    reduced: FloatArray  # (9, 9)
    gradient: FloatArray  # (9,)
    cross: FloatArray  # (V, 9, 6)
    pose_inverse: FloatArray  # (V, 6, 6)
    pose_gradient: FloatArray  # (V, 6)


def _normal(
    state: _State, corners: Corners, sigma: FloatArray, used: BoolArray, priors: Priors, damping: float = 0.0
) -> _Normal:
    T = state.T_cam_board[corners.view]
    R = T[:, :3, :3]
    p_cam = (R @ corners.points_m[..., None])[..., 0] + T[:, :3, 3]
    camera = camera_of(state.parameters, corners.size_px)
    weight = np.where(used, 1 / sigma[corners.view], 0.0)[:, None, None]
    d_point = project_jacobian(camera, p_cam)
    turn = -(R @ hats(corners.points_m))
    J_pose = weight * np.concatenate([d_point, d_point @ turn], axis=-1)  # [translation in the camera, rotation]
    J = weight * parameter_jacobian(camera, p_cam)
    e = weight[..., 0] * (corners.px - project(camera, p_cam))
    starts = np.searchsorted(corners.view, np.arange(corners.views))
    prior_normal, prior_gradient = _prior(state.parameters, corners.size_px, priors)
    own = np.einsum("pki,pkj->ij", J, J) + prior_normal
    gradient = np.einsum("pki,pk->i", J, e) + prior_gradient
    cross = np.add.reduceat(np.einsum("pki,pkj->pij", J, J_pose), starts)
    poses = np.add.reduceat(np.einsum("pki,pkj->pij", J_pose, J_pose), starts)
    pose_gradient = np.add.reduceat(np.einsum("pki,pk->pi", J_pose, e), starts)
    own = own + damping * np.diag(np.diagonal(own))
    poses = poses + damping * np.eye(6) * np.diagonal(poses, axis1=1, axis2=2)[:, :, None]
    inverse = np.asarray(np.linalg.inv(poses), np.float64)
    gain = cross @ inverse
    reduced = own - np.einsum("vij,vkj->ik", gain, cross)
    return _Normal(reduced, gradient - np.einsum("vij,vj->i", gain, pose_gradient), cross, inverse, pose_gradient)


def parameter_jacobian(camera: CameraModel, p_cam: FloatArray) -> FloatArray:
    """Derivative (..., 2, 9) of the pixels of points (..., 3) in the camera with respect to PARAMETERS."""
    x, y = (p_cam[..., axis] / p_cam[..., 2] for axis in (0, 1))
    k1, k2, p1, p2, k3 = camera.distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    fx, fy = camera.matrix[0, 0], camera.matrix[1, 1]
    J = np.zeros((*x.shape, 2, 9))
    J[..., 0, 0], J[..., 1, 1] = u, v
    J[..., 0, 2] = J[..., 1, 3] = 1
    for column, power in ((4, r2), (5, r2**2), (8, r2**3)):
        J[..., 0, column], J[..., 1, column] = fx * x * power, fy * y * power
    J[..., 0, 6], J[..., 1, 6] = fx * 2 * x * y, fy * (r2 + 2 * y * y)
    J[..., 0, 7], J[..., 1, 7] = fx * (r2 + 2 * x * x), fy * 2 * x * y
    return J


def prior_std(camera: CameraModel, priors: Priors | None = None) -> FloatArray:
    """(9,) standard deviations of PARAMETERS before any view was seen."""
    priors = priors or Priors()
    width, height = camera.size_px
    fx, fy = camera.matrix[[0, 1], [0, 1]]
    corner = np.hypot(width / fx, height / fy) / 2
    k1, k2, k3 = (priors.radial / corner**power for power in (2, 4, 6))
    p = priors.tangential / (3 * corner)
    return np.array([
        priors.focal * fx, priors.focal * fy, priors.centre * width, priors.centre * width, k1, k2, p, p, k3
    ])  # fmt: skip


def _prior_residuals(q: FloatArray, size_px: tuple[int, int], priors: Priors) -> tuple[FloatArray, FloatArray]:
    """Residuals (9,) of the priors in standard deviations, and their derivative (9, 9)."""
    width, height = size_px
    std = prior_std(camera_of(q, size_px), priors)
    log_f = np.log(np.sqrt(q[0] * q[1]) / width) / priors.focal
    log_aspect = np.log(q[1] / q[0]) / priors.aspect
    middle = (q[2:4] - [(width - 1) / 2, (height - 1) / 2]) / std[2:4]
    residual = np.array([log_f, log_aspect, *middle, *(q[4:] / std[4:])])
    J = np.diag(np.concatenate([[0, 0], 1 / std[2:]]))
    J[0, :2] = 0.5 / q[:2] / priors.focal
    J[1, :2] = np.array([-1, 1]) / q[:2] / priors.aspect
    return residual, J


def _prior(q: FloatArray, size_px: tuple[int, int], priors: Priors) -> tuple[FloatArray, FloatArray]:
    residual, J = _prior_residuals(q, size_px, priors)
    return J.T @ J, -J.T @ residual


def _cost(state: _State, corners: Corners, sigma: FloatArray, used: BoolArray, priors: Priors) -> float:
    residual = _residuals(state, corners)[used] / sigma[corners.view[used], None]
    prior, _ = _prior_residuals(state.parameters, corners.size_px, priors)
    return float(np.sum(residual**2) + np.sum(prior**2))


def _descend(
    state: _State, corners: Corners, sigma: FloatArray, used: BoolArray, priors: Priors, steps: int
) -> tuple[_State, float]:
    """Levenberg-Marquardt with fixed weights; the state and its cost."""
    damping, cost = FIRST_DAMPING, _cost(state, corners, sigma, used, priors)
    for _ in range(steps):
        normal = _normal(state, corners, sigma, used, priors, damping)
        root = _root(normal.reduced)
        step = np.linalg.solve(_scaled(normal.reduced), normal.gradient / root) / root
        back = normal.pose_gradient - np.einsum("vij,i->vj", normal.cross, step)
        tried = _moved(state, step, np.einsum("vij,vj->vi", normal.pose_inverse, back))
        new_cost = np.inf if tried is None else _cost(tried, corners, sigma, used, priors)
        if tried is not None and new_cost <= cost:
            gained, state, cost = cost - new_cost, tried, new_cost
            damping /= DAMPING_FACTOR
            if gained <= SMALL_GAIN * cost:
                break
        else:
            damping *= DAMPING_FACTOR
            if damping > LARGEST_DAMPING:
                break
    return state, cost


def _moved(state: _State, step: FloatArray, pose_step: FloatArray) -> _State | None:
    """The state after a step; None where a focal length would be nought or less."""
    parameters = state.parameters + step
    if np.any(parameters[:2] <= 0) or not np.all(np.isfinite(parameters)):
        return None
    T = state.T_cam_board.copy()
    for v, turn in enumerate(pose_step[:, 3:]):  # a rotation vector at a time
        T[v, :3, :3] = T[v, :3, :3] @ cv2.Rodrigues(turn)[0]
    T[:, :3, 3] += pose_step[:, :3]
    return _State(parameters, T)


def hats(p: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) of the cross product with p (..., 3)."""
    zero = np.zeros(p.shape[:-1])
    rows = [[zero, -p[..., 2], p[..., 1]], [p[..., 2], zero, -p[..., 0]], [-p[..., 1], p[..., 0], zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _root(normal: FloatArray) -> FloatArray:
    return np.sqrt(np.diagonal(normal))


def _scaled(normal: FloatArray) -> FloatArray:
    """The matrix with a unit diagonal: px and coefficients of r^6 are of very different sizes."""
    return normal / np.outer(_root(normal), _root(normal))
