"""How good a view of a board is for a calibration: how sharp, how tilted and which way, how near, what it covers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calibration.board_detection import BoardView, Grey, grey_of
from calibration.boards import CharucoBoard
from calibration.intrinsics import FloatArray

# Cells of the image in which corners are counted: across and down.
COVER_CELLS = (8, 6)
# Profiles across edges: samples, and half length in squares, within the white between square and marker.
PROFILE_SAMPLES = 41
PROFILE_SQUARES = 0.14
# The focal length that tilts are judged with before one is known, in image widths: a common webcam's.
GUESSED_FOCAL = 0.95
LEAST_TILT_CORNERS = 6
# Samples at each end of a profile that show black and white.
END_SAMPLES = 6


@dataclass(frozen=True, eq=False)
class ViewQuality:
    """What a view is worth.

    Attributes:
        blur_px: standard deviation of the blur of edges, the larger of those along the board's two directions.
        tilt_rad: between the board's normal and the line of sight to its middle.
        facing: (2,) unit vector in the image to which the board's front is turned, x right, y down; zero if frontal.
        centre_px: (2,) the seen corners' middle.
        span: the seen corners' extent, as share of the image's diagonal.
        roll_rad: angle of the board's x axis in the image.
    """

    blur_px: float
    tilt_rad: float
    facing: FloatArray
    centre_px: FloatArray
    span: float
    roll_rad: float


def assess_view(view: BoardView, image: Grey, board: CharucoBoard, focal_px: float | None = None) -> ViewQuality:
    """How good a view with at least LEAST_TILT_CORNERS corners is; `focal_px` where it is known already."""
    width, height = view.size_px
    f = focal_px or GUESSED_FOCAL * width
    matrix = np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]])
    points = board.corner_points()[view.ids]
    _, rvec, tvec = cv2.solvePnP(points, view.corners_px, matrix, np.zeros(5), flags=cv2.SOLVEPNP_IPPE)
    R, _ = cv2.Rodrigues(rvec)
    towards = R @ np.append(points.mean(axis=0)[:2], 0.0) + np.ravel(tvec)
    normal = -np.asarray(R, np.float64)[:, 2]  # out of the paper
    sight = -towards / np.linalg.norm(towards)
    tilt = np.arctan2(np.linalg.norm(np.cross(normal, sight)), normal @ sight)
    aside = normal[:2] - sight[:2]
    extent = view.corners_px.max(axis=0) - view.corners_px.min(axis=0)
    return ViewQuality(
        blur_px=blur_of(view, grey_of(image), board),
        tilt_rad=float(tilt),
        facing=aside / max(float(np.linalg.norm(aside)), 1e-9),
        centre_px=view.corners_px.mean(axis=0),
        span=float(np.linalg.norm(extent) / np.hypot(width, height)),
        roll_rad=float(np.arctan2(R[1, 0], R[0, 0])),
    )


def blur_of(view: BoardView, grey: Grey, board: CharucoBoard) -> float:
    """Standard deviation (px) of the blur of the edges between squares, the larger of both directions; NaN if unseen.

    Seen through gamma: in the middle of the edges between two corners that are both seen, from black to white.
    """
    lines = [_edge_blur(view, grey, board, step) for step in (1, board.columns - 1)]
    known = [blur for blur in lines if np.isfinite(blur)]
    return max(known) if known else float("nan")


def _edge_blur(view: BoardView, grey: Grey, board: CharucoBoard, step: int) -> float:
    """Median blur of the edges between corners whose ids differ by `step`: contrast by steepest slope.

    That of an edge blurred by a Gaussian is sqrt(2 pi) of its standard deviation.
    """
    place = {int(name): k for k, name in enumerate(view.ids)}
    pairs = [
        (k, place[name + step])
        for name, k in place.items()
        if name + step in place and (step != 1 or (name + 1) % (board.columns - 1))
    ]
    if not pairs:
        return float("nan")
    first, last = (view.corners_px[[pair[end] for pair in pairs]] for end in (0, 1))
    along = last - first
    square_px = np.linalg.norm(along, axis=1)
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / square_px[:, None]
    across = np.linspace(-1, 1, PROFILE_SAMPLES) * PROFILE_SQUARES * square_px[:, None]
    spots = ((first + last) / 2)[:, None] + across[..., None] * normal[:, None]
    x, y = (np.ascontiguousarray(spots[..., axis], np.float32) for axis in (0, 1))
    profile = np.asarray(cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float64)
    slope = np.abs(np.diff(profile, axis=1)).max(axis=1) / (across[:, 1] - across[:, 0])
    contrast = np.abs(profile[:, -END_SAMPLES:].mean(axis=1) - profile[:, :END_SAMPLES].mean(axis=1))
    return float(np.median(contrast / np.maximum(slope, 1e-9)) / np.sqrt(2 * np.pi))


def cover(views: Sequence[BoardView]) -> FloatArray:
    """(rows, columns) how many corners of all views fall into each cell of the image."""
    columns, rows = COVER_CELLS
    counts = np.zeros((rows, columns))
    for view in views:
        cell = np.clip(view.corners_px / view.size_px * [columns, rows], 0, [columns - 1, rows - 1]).astype(int)
        np.add.at(counts, (cell[:, 1], cell[:, 0]), 1)
    return counts


def moved_px(one: BoardView, other: BoardView) -> float:
    """Median move of the corners that both views show; infinite if they share none."""
    _, a, b = np.intersect1d(one.ids, other.ids, return_indices=True)
    if not len(a):
        return float("inf")
    return float(np.median(np.linalg.norm(one.corners_px[a] - other.corners_px[b], axis=1)))
