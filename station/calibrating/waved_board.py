"""A board waved before a simulated camera, on a virtual clock: the calibration's wizard without hardware."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.boards import CharucoBoard
from drivers.camera import Image
from drivers.clock import Clock
from drivers.rendered_camera import RenderedCamera
from station.logs import FloatArray
from station.simulate.board_views import BoardRenderer, varied_poses
from station.simulate.scene import CameraOptics

# The demo's camera.
OPTICS = CameraOptics(
    (640, 480),
    np.array([[610.0, 0.0, 322.0], [0.0, 609.0, 243.0], [0.0, 0.0, 1.0]]),
    np.array([0.06, -0.13, 0.0006, -0.0004, 0.05]),
)
FPS = 15.0
EXPOSURE_S = 0.01
# At each pose the board rests, then moves to the next; after the last it rests for good.
POSES = 40
REST_S, MOVE_S = 0.5, 0.3
SEED = 0


def waved_board_camera(board: CharucoBoard, clock: Clock, optics: CameraOptics = OPTICS) -> RenderedCamera:
    """The camera, not started yet."""
    renderer = BoardRenderer(board, optics, SEED)
    poses = np.array(varied_poses(board, optics, np.random.default_rng(SEED), POSES))
    start_ns = clock.now_ns()

    def render(t_mid_ns: int, index: int) -> Image:
        return renderer.render(_pose_at(poses, (t_mid_ns - start_ns) * 1e-9), index)

    return RenderedCamera(
        render, size_px=optics.size_px, fps=FPS, exposure_s=EXPOSURE_S, latency_s=0.0, clock=clock, realtime=False
    )


def _pose_at(poses: FloatArray, t_s: float) -> FloatArray:
    """Where the board is (4, 4): a screw motion takes it from one pose to the next."""
    number = min(int(t_s / (REST_S + MOVE_S)), len(poses) - 1)
    share = (t_s - number * (REST_S + MOVE_S) - REST_S) / MOVE_S
    if share <= 0 or number + 1 == len(poses):
        return poses[number]
    here, there = RigidTransform.from_matrix(poses[number]), RigidTransform.from_matrix(poses[number + 1])
    step = (here.inv() * there).as_exp_coords()
    return np.asarray((here * RigidTransform.from_exp_coords(step * min(share, 1.0))).as_matrix(), np.float64)
