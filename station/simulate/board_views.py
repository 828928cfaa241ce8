"""Rendered views of a ChArUco board through a real lens, in the order light, blur, gamma, noise.

Backward mapping: each pixel has several samples, each with its exact undistorted ray; the board's plane takes a ray to
a texture whose texels hold the exact share of black. Not modelled: shadows, depth of focus, a board that isn't flat.
"""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.boards import CharucoBoard
from station.errors import InvalidData
from station.logs import FloatArray
from station.simulate.rays import undistorted
from station.simulate.scene import CameraOptics, check_poses

Image = NDArray[np.uint8]
Singles = NDArray[np.float32]

# Samples of a pixel along each axis.
SAMPLES = 3
# Texels per pixel of the image where the board is nearest.
TEXELS_PER_PX = 2.0
MAX_TEXELS = 4000
# Linear light: white paper, print, and what is behind the board.
PAPER, INK, BEHIND = 0.8, 0.035, 0.25
# White around the board, in squares.
RIM_SQUARES = 0.6
# The light falls off towards the corners of the image by this part.
FALLOFF = 0.15
# A common webcam's focal length, in image widths.
COMMON_FOCAL = 0.953


class BoardRenderer:
    """Renders what a camera sees of a board. Not for two threads at once.

    Args:
        board: as printed: its `stretch` is drawn.
        optics: the camera.
        seed: of the sensor's noise.
    """

    def __init__(self, board: CharucoBoard, optics: CameraOptics, seed: int) -> None:
        self._board = board
        self._optics = optics
        self._seed = seed

    def render(self, T_cam_board: FloatArray, frame_index: int) -> Image:
        """The image (H, W, 3) uint8 BGR.

        Args:
            T_cam_board: (4, 4) pose of the board (x right, y down, z into the paper) in the camera, or (S, 4, 4) at S
                instants of the exposure, whose light is averaged.
            frame_index: gives the noise, together with the seed.

        Raises:
            InvalidData: for poses that are no rigid motions.
        """
        instants = np.asarray(T_cam_board, np.float64).reshape(-1, 4, 4)
        check_poses(instants, "T_cam_board")
        light = (
            np.mean([self._light(pose) for pose in instants], axis=0) if len(instants) > 1 else self._light(instants[0])
        )
        optics = self._optics
        light = light * self._falloff
        if optics.blur_px:
            light = cv2.GaussianBlur(light, (0, 0), optics.blur_px, borderType=cv2.BORDER_REPLICATE)
        grey = 255 * np.clip(light * np.float32(optics.light), 0, 1) ** np.float32(1 / optics.gamma)
        if optics.noise_grey:
            random = np.random.Generator(np.random.SFC64(np.random.SeedSequence((self._seed, frame_index))))
            grey += np.float32(optics.noise_grey) * random.standard_normal(grey.shape, np.float32)
        return np.asarray(cv2.cvtColor(cv2.convertScaleAbs(grey), cv2.COLOR_GRAY2BGR), np.uint8)

    @cached_property
    def _rays(self) -> tuple[Singles, Singles]:
        """Undistorted directions x / z, y / z, each (H * SAMPLES, W * SAMPLES); NaN where there are none."""
        width, height = self._optics.size_px
        fx, fy = self._optics.matrix[[0, 1], [0, 1]]
        cx, cy = self._optics.matrix[:2, 2]
        u = ((np.arange(width * SAMPLES) + 0.5) / SAMPLES - 0.5 - cx) / fx
        v = ((np.arange(height * SAMPLES) + 0.5) / SAMPLES - 0.5 - cy) / fy
        rows = [undistorted(u, np.full(len(u), each), self._optics.distortion) for each in v]  # a row fits the cache
        x, y = (np.array([row[axis] for row in rows], np.float32) for axis in (0, 1))
        return x, y

    @cached_property
    def _falloff(self) -> Singles:
        width, height = self._optics.size_px
        x, y = (np.arange(width) + 0.5) / width * 2 - 1, (np.arange(height) + 0.5) / height * 2 - 1
        return (1 - FALLOFF / 2 * (x[None, :] ** 2 + y[:, None] ** 2)).astype(np.float32)

    def _light(self, T_cam_board: FloatArray) -> Singles:
        """Linear light (H, W) before blur, noise and gamma."""
        texels_per_m = self._texels_per_m(T_cam_board)
        texture = self._texture(texels_per_m)
        plane = np.linalg.inv(T_cam_board[:3, [0, 1, 3]])  # of a ray: (x, y, 1) / depth on the board
        rim_m = RIM_SQUARES * self._board.square_m
        x, y = self._rays
        column, row, inverse_depth = (
            np.asarray(cv2.addWeighted(x, m[0], y, m[1], m[2]), np.float32)
            for m in (
                texels_per_m[0] * (plane[0] + rim_m * plane[2]) - 0.5 * plane[2],
                texels_per_m[1] * (plane[1] + rim_m * plane[2]) - 0.5 * plane[2],
                plane[2],
            )
        )
        # Rays that meet the plane behind the camera, and lost ones, see what is behind the board.
        away = np.float32(-1e6)
        seen = inverse_depth > 0
        inverse_depth[~seen] = 1
        column, row = np.where(seen, column / inverse_depth, away), np.where(seen, row / inverse_depth, away)
        light = cv2.remap(texture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=[BEHIND])
        height, width = self._falloff.shape
        return np.asarray(cv2.resize(light, (width, height), interpolation=cv2.INTER_AREA), np.float32)

    def _texels_per_m(self, T_cam_board: FloatArray) -> FloatArray:
        """Texels across and down for a metre of paper, for edges that are half a pixel wide where it is nearest."""
        width, height = self._board.size_m
        corners = np.array([(0, 0, 0, 1), (width, 0, 0, 1), (0, height, 0, 1), (width, height, 0, 1)])
        points = (T_cam_board @ corners.T)[:3].T
        if np.any(points[:, 2] <= 0):
            raise InvalidData("a corner of the board is behind the camera; want a pose that is wholly before it")
        f = self._optics.matrix[[0, 1], [0, 1]]
        moves = T_cam_board[None, :2, :2] - points[:, :2, None] / points[:, 2:, None] * T_cam_board[None, 2:3, :2]
        px_per_m = np.linalg.norm(f[:, None] * moves / points[:, 2, None, None], axis=1).max(axis=0)
        most = MAX_TEXELS / max(self._board.size_m)
        return np.minimum(TEXELS_PER_PX * px_per_m, most)

    def _texture(self, texels_per_m: FloatArray) -> Singles:
        """Light of the paper and what is behind its rim: the exact mean over each texel."""
        x_edges, y_edges, white = self._cells
        rim_m = RIM_SQUARES * self._board.square_m
        shares: list[Singles] = []
        for edges_m, per_m in ((x_edges, texels_per_m[0]), (y_edges, texels_per_m[1])):
            edges = (edges_m + rim_m) * per_m
            count = int(np.ceil(edges[-1] + rim_m * per_m))
            ends = np.clip(edges[None, :] - np.arange(count)[:, None], 0, 1)
            shares.append(np.diff(ends, axis=1).astype(np.float32))
        black = shares[1] @ (1 - white) @ shares[0].T
        return np.asarray(PAPER - (PAPER - INK) * black, np.float32)

    @cached_property
    def _cells(self) -> tuple[FloatArray, FloatArray, Singles]:
        """The board cut along all its edges: where the cuts are (m), and which cells (rows, columns) are white."""
        rectangles = self._board.black_rectangles()
        x, y, w, h = np.round(rectangles, 9).T  # edges that are one differ by rounding
        x_edges, y_edges = (_edges(low, extent) for low, extent in ((x, w), (y, h)))
        white = np.ones((len(y_edges) - 1, len(x_edges) - 1), np.float32)
        x0, x1 = np.searchsorted(x_edges, x - 1e-9), np.searchsorted(x_edges, x + w - 1e-9)
        y0, y1 = np.searchsorted(y_edges, y - 1e-9), np.searchsorted(y_edges, y + h - 1e-9)
        for k in range(len(rectangles)):  # once a board
            white[y0[k] : y1[k], x0[k] : x1[k]] = 0
        across, down = self._board.stretch
        return np.asarray(x_edges * across), np.asarray(y_edges * down), white


def _edges(low: FloatArray, extent: FloatArray) -> FloatArray:
    """Where rectangles begin and end, each place once, rising."""
    return np.unique(np.round(np.concatenate([low, low + extent]), 9))


def placed(
    board: CharucoBoard, optics: CameraOptics, centre_px: tuple[float, float], distance_m: float, turn: FloatArray
) -> FloatArray:
    """The pose (4, 4) with the board's middle seen at a pixel, so far along the camera's axis, turned by (3, 3)."""
    (fx, _, cx), (_, fy, cy), _ = optics.matrix
    x, y = undistorted(np.array([(centre_px[0] - cx) / fx]), np.array([(centre_px[1] - cy) / fy]), optics.distortion)
    T = np.eye(4)
    T[:3, :3] = turn
    middle = np.array([*board.size_m, 0.0]) / 2
    T[:3, 3] = distance_m * np.array([x[0], y[0], 1.0]) - turn @ middle
    return T


def turned(tilt_rad: float, towards_rad: float, roll_rad: float) -> FloatArray:
    """A rotation (3, 3): rolled in the board's plane, then tilted about an axis in the image plane at `towards_rad`."""
    axis = np.array([np.cos(towards_rad), np.sin(towards_rad), 0.0]) * tilt_rad
    tilt, _ = cv2.Rodrigues(axis)
    roll, _ = cv2.Rodrigues(np.array([0.0, 0.0, roll_rad]))
    return np.asarray(tilt @ roll, np.float64)


def some_pose(
    board: CharucoBoard,
    optics: CameraOptics,
    rng: np.random.Generator,
    place: tuple[float, float],
    tilt_deg: float,
    distance_m: float,
) -> FloatArray:
    """A pose (4, 4) at a place of the image (shares of its size), tilted any way, in any of four rolls.

    The distance is that of a camera with COMMON_FOCAL; others see the board as large from elsewhere.
    """
    width, height = optics.size_px
    roll = np.pi / 2 * rng.integers(4) + rng.normal(scale=np.radians(8))
    turn = turned(np.radians(tilt_deg), rng.uniform(0, 2 * np.pi), roll)
    distance_m *= optics.matrix[0, 0] / width / COMMON_FOCAL
    return placed(board, optics, (place[0] * width, place[1] * height), distance_m, turn)


def varied_poses(board: CharucoBoard, optics: CameraOptics, rng: np.random.Generator, count: int) -> list[FloatArray]:
    """Poses as a calibration wants them: all over the image, tilted by 15 to 45 deg, near enough to fill it."""
    scatter = 0.03 * rng.normal(size=(count, 2))
    return [
        some_pose(
            board,
            optics,
            rng,
            (0.3 + 0.2 * (k % 3) + scatter[k, 0], 0.35 + 0.15 * (k // 3 % 3) + scatter[k, 1]),
            rng.uniform(15, 45),
            rng.uniform(0.32, 0.5),
        )
        for k in range(count)
    ]
