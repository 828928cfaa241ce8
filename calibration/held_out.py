"""Reprojection errors of views that the calibration did not see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.camera_fit import CameraFit, Corners, board_poses, refine_poses, refit_camera
from calibration.intrinsics import FloatArray, project

FOLDS = 5
# Fewer views than this leave too few for the fit: then each view is left out in turn.
VIEWS_FOR_FOLDS = 10
LEAST_LEFT = 3


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors of held-out views.

    Attributes:
        rms_px: RMS distance of the corners seen from where the other views' camera has them.
        by_view_px: (V,) the same of each view; NaN where it has no pose.
        focal_px: (folds,) mean focal lengths that the folds found.
    """

    rms_px: float
    by_view_px: FloatArray
    focal_px: FloatArray


def held_out_errors(fit: CameraFit, corners: Corners) -> HeldOut | None:
    """Leave a fifth of the views out at a time (or one); fit the rest; find the poses of those left out with it.

    None where there are too few views for that.
    """
    views = corners.views
    folds = FOLDS if views >= VIEWS_FOR_FOLDS else views
    if views <= LEAST_LEFT:
        return None
    by_view, squares, count = np.full(views, np.nan), 0.0, 0
    focal: list[float] = []
    for fold in range(folds):  # a fit each
        out = np.arange(views) % folds == fold
        other = refit_camera(fit, corners, ~out)
        focal.append(float(np.mean(other.camera.matrix[[0, 1], [0, 1]])))
        left = corners.of(out)
        poses = board_poses(other.camera, left)
        if poses is None:
            continue
        used = fit.used[out[corners.view]]
        error = _errors(other, left, poses)
        for k, v in enumerate(np.flatnonzero(out)):
            mine = error[(left.view == k) & used]
            by_view[v] = np.sqrt(np.mean(mine)) if len(mine) else np.nan
            squares, count = squares + float(mine.sum()), count + len(mine)
    return HeldOut(float(np.sqrt(squares / max(count, 1))), by_view, np.array(focal))


def _errors(fit: CameraFit, left: Corners, poses: FloatArray) -> FloatArray:
    """(P,) squared distances after the poses were refined with the camera held fixed."""
    poses = refine_poses(fit.camera, left, poses)
    T = poses[left.view]
    p_cam = (T[:, :3, :3] @ left.points_m[..., None])[..., 0] + T[:, :3, 3]
    return np.sum((left.px - project(fit.camera, p_cam)) ** 2, axis=-1)
