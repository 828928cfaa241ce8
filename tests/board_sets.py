"""Rendered sets of views of a board: good ones, and bad ones of every kind, for tests and benchmarks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import cv2
import numpy as np

from calibration.board_detection import BoardFinder, grey_of
from calibration.boards import CharucoBoard
from calibration.camera_calibration import Shot, is_telling
from calibration.camera_fit import Corners, stack_views
from calibration.view_quality import assess_view
from station.simulate.board_views import BoardRenderer, some_pose, varied_poses
from station.simulate.scene import CameraOptics

BOARD = CharucoBoard(7, 10, 0.025, 0.0175, "DICT_5X5_100")
VIEWS = 15


def some_camera(rng: np.random.Generator) -> CameraOptics:
    """A webcam of 640x480: any common lens, blur and noise."""
    fx = rng.uniform(480, 760)
    cx, cy = 319.5 + 8 * rng.normal(), 239.5 + 8 * rng.normal()
    matrix = np.array([[fx, 0, cx], [0, fx * (1 + 0.002 * rng.normal()), cy], [0, 0, 1]])
    tangential = 0.001 * rng.normal(size=2)
    distortion = np.array([rng.uniform(-0.3, 0.15), rng.uniform(-0.1, 0.15), *tangential, 0.0])
    return CameraOptics((640, 480), matrix, distortion, blur_px=rng.uniform(0.5, 1.0), noise_grey=rng.uniform(1, 3))


def good_poses(optics: CameraOptics, rng: np.random.Generator, count: int = VIEWS) -> list[np.ndarray]:
    """As the wizard asks for them."""
    return varied_poses(BOARD, optics, rng, count)


def frontal_poses(optics: CameraOptics, rng: np.random.Generator, count: int = VIEWS) -> list[np.ndarray]:
    """All over the image, never tilted by more than 3 deg."""
    places = [(0.35 + 0.15 * (k % 3), 0.4 + 0.1 * (k // 3 % 3)) for k in range(count)]
    return [some_pose(BOARD, optics, rng, place, rng.uniform(0, 3), rng.uniform(0.4, 0.6)) for place in places]


def corner_poses(optics: CameraOptics, rng: np.random.Generator, count: int = VIEWS) -> list[np.ndarray]:
    """Tilted, but all in the upper left corner."""
    return [
        some_pose(BOARD, optics, rng, tuple(rng.uniform(0.08, 0.2, 2)), rng.uniform(15, 40), rng.uniform(0.5, 0.6))
        for _ in range(count)
    ]


def rendered(
    optics: CameraOptics, poses: Sequence[np.ndarray], seed: int, board: CharucoBoard = BOARD, jpeg: int | None = None
) -> list[np.ndarray]:
    """The images, through JPEG of some quality if asked for."""
    renderer = BoardRenderer(board, optics, seed)
    images = [renderer.render(pose, k) for k, pose in enumerate(poses)]
    if jpeg is None:
        return images
    return [cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, jpeg])[1], 1) for image in images]


def shots_of(images: Sequence[np.ndarray], board: CharucoBoard = BOARD) -> list[Shot]:
    """The views in which the board is found."""
    finder = BoardFinder(board)
    views = [finder.find(image) for image in images]
    return [
        Shot(f"{k}.png", grey_of(image), view, assess_view(view, image, board))
        for k, (image, view) in enumerate(zip(images, views, strict=True))
        if is_telling(view, board)
    ]


def corners_of(shots: Sequence[Shot], board: CharucoBoard = BOARD) -> Corners:
    """Their corners, as the fit takes them."""
    points = board.corner_points()
    views = [shot.view for shot in shots]
    return stack_views(views[0].size_px, [points[view.ids] for view in views], [view.corners_px for view in views])


def true_parameters(optics: CameraOptics) -> np.ndarray:
    """(9,) as calibration.camera_fit.PARAMETERS."""
    return np.array([*optics.matrix[[0, 1], [0, 1]], *optics.matrix[:2, 2], *optics.distortion])


# Images of sets in which nothing is found: they tell no more if they are more.
SHOWN = 4
BadSet = tuple[CharucoBoard, list[np.ndarray]]


def _blurred(optics: CameraOptics, rng: np.random.Generator) -> BadSet:
    return BOARD, rendered(replace(optics, blur_px=2.6), good_poses(optics, rng, SHOWN), 1)


def _moving(optics: CameraOptics, rng: np.random.Generator) -> BadSet:
    renderer = BoardRenderer(BOARD, optics, 1)
    images: list[np.ndarray] = []
    for k, pose in enumerate(good_poses(optics, rng, SHOWN)):
        moving = np.tile(pose, (5, 1, 1))
        moving[:, 0, 3] += np.linspace(-0.5, 0.5, 5) * 7.5 / optics.matrix[0, 0] * pose[2, 3]  # 7.5 px in the exposure
        images.append(renderer.render(moving, k))
    return BOARD, images


# What is described, and what was seen, of every kind of bad set.
BAD_SETS: dict[str, Callable[[CameraOptics, np.random.Generator], BadSet]] = {
    "all frontal": lambda optics, rng: (BOARD, rendered(optics, frontal_poses(optics, rng), 1)),
    "all in one corner": lambda optics, rng: (BOARD, rendered(optics, corner_poses(optics, rng), 1)),
    "blurred": _blurred,
    "moving": _moving,
    "four views": lambda optics, rng: (BOARD, rendered(optics, good_poses(optics, rng, 4), 1)),
    "described with other columns": lambda optics, rng: (
        replace(BOARD, columns=6, rows=9),
        rendered(optics, good_poses(optics, rng, SHOWN), 1),
    ),
    "described with another dictionary": lambda optics, rng: (
        replace(BOARD, dictionary="DICT_4X4_100"),
        rendered(optics, good_poses(optics, rng, SHOWN), 1),
    ),
    "described with larger markers": lambda optics, rng: (
        replace(BOARD, marker_m=0.02),
        rendered(optics, good_poses(optics, rng), 1),
    ),
}
