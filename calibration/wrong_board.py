"""What images show instead of the board that is described: another dictionary, other squares, blur."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.board_detection import BoardFinder, Grey, grey_of, marker_detector, read_markers
from calibration.boards import CharucoBoard, load_dictionary
from calibration.camera_fit import CameraFit
from calibration.errors import CalibrationError
from calibration.intrinsics import FloatArray
from calibration.verdict import undistorted_rays

# Images that are looked at.
LOOKED_AT = 6
# Markers of another dictionary that are no accident.
LEAST_OTHERS = 4
MOST_COLUMNS = 24
DICTIONARY_IMAGES = 2
# Spread of an image's sharpest edges that hides the board.
HIDING_BLUR_PX = 1.8
# One dictionary of each family: the largest.
LARGEST = (
    *(f"DICT_{n}X{n}_1000" for n in (4, 5, 6, 7)),
    *(f"DICT_APRILTAG_{name}" for name in ("16h5", "25h9", "36h10", "36h11")),
    "DICT_ARUCO_ORIGINAL",
    "DICT_ARUCO_MIP_36h12",
)
# An image is smoothed by so much, against noise, before its steepest slopes (above this percentile) are looked at.
SMOOTHING_PX = 1.0
SHARPEST_PERCENT = 99.7


@dataclass(frozen=True)
class OtherBoard:
    """A board that fits what is seen better than the one described: how many markers agree with each."""

    board: CharucoBoard
    agree: int
    described_agree: int


def explain_missing(images: Sequence[Grey], board: CharucoBoard) -> str:
    """Why the board isn't found in images that should show it, in words."""
    chosen = [grey_of(image) for image in images[:: max(len(images) // LOOKED_AT, 1)]][:LOOKED_AT]
    if (other := likely_board(chosen, board)) is not None:
        return _said(other, board)
    blur_px = float(np.median([edge_spread_px(image) for image in chosen])) if chosen else 0.0
    if blur_px > HIDING_BLUR_PX:
        return (
            f"they are blurred: their sharpest edges spread over {blur_px:.1f} px, want {HIDING_BLUR_PX:g} at most\n"
            "focus the camera and lock the focus, hold the board still, use more light or a shorter exposure"
        )
    return "no marker of any dictionary is read in them: is the board in view, large enough, flat, lit and in focus?"


def _said(other: OtherBoard, board: CharucoBoard) -> str:
    seen = other.board
    if seen.dictionary != board.dictionary:
        return (
            f"what is seen are markers of {seen.dictionary} ({other.agree} of them), not of {board.dictionary}\n"
            "give the board's own description, as printed on the sheet: --board charuco:..."
        )
    layout = f"{seen.columns} squares across" + (" that begin with a white one (:legacy)" if seen.legacy else "")
    return (
        f"its markers lie as on a board of {layout} ({other.agree} of them agree), not as on one of "
        f"{board.columns}{' (:legacy)' if board.legacy else ''} ({other.described_agree} agree)\n"
        "give the board's own description, as printed on the sheet: --board charuco:..."
    )


def likely_board(images: Sequence[Grey], board: CharucoBoard) -> OtherBoard | None:
    """A board that fits the images clearly better than `board`: of other columns, or of another dictionary."""
    described = [read_markers(marker_detector(board.dictionary), grey_of(image)) for image in images]
    ids, sides = max(described, key=lambda each: len(each[0]), default=(np.zeros(0, np.int64), np.zeros((0, 4, 2))))
    if len(ids) >= LEAST_OTHERS:
        return _other_columns(ids, sides, board)
    names, best = _dictionary_of(images, board.dictionary), len(ids)
    if names is None or names[1] <= best:
        return None
    try:
        other = replace(board, dictionary=names[0])
    except CalibrationError:  # that dictionary is too small for a board of so many squares
        other = replace(board, dictionary=names[0], columns=3, rows=3)
    return OtherBoard(other, names[1], best)


def _dictionary_of(images: Sequence[Grey], but: str) -> tuple[str, int] | None:
    """The dictionary of which most markers are read in one image, and how many; the smallest of its family.

    A dictionary such as DICT_5X5_50 holds the first 50 markers of DICT_5X5_1000.
    """
    family = but.rpartition("_")[0]
    others = [name for name in LARGEST if not name.startswith(family)]
    best, count, largest_id = "", 0, 0
    for name in others:  # OpenCV's detector knows one dictionary
        detector = marker_detector(name)
        for image in images[:DICTIONARY_IMAGES]:
            ids = read_markers(detector, image)[0]
            if len(ids) > count:
                best, count, largest_id = name, len(ids), int(ids.max())
    if count < LEAST_OTHERS:
        return None
    if best.endswith("_1000"):
        best = next(f"{best[:-5]}_{size}" for size in (50, 100, 250, 1000) if largest_id < size)
    return best, count


def edge_spread_px(grey: Grey) -> float:
    """Standard deviation (px) of the blur of an image's sharpest edges, in the worse of the two directions."""
    smooth = cv2.GaussianBlur(grey, (0, 0), SMOOTHING_PX).astype(np.float64)
    contrast = float(np.ptp(np.percentile(smooth, (2, 98))))
    spread: list[float] = []
    for axis in (0, 1):
        slope = float(np.percentile(np.abs(np.diff(smooth, axis=axis)), SHARPEST_PERCENT))
        spread.append((contrast / max(slope, 1e-9)) ** 2 / (2 * np.pi) - SMOOTHING_PX**2)
    return float(np.sqrt(max(*spread, 0.0)))


def _other_columns(ids: np.ndarray, sides_px: FloatArray, board: CharucoBoard) -> OtherBoard | None:
    """The number of columns with which most markers lie in one plane, if it isn't the described one's."""
    described = _agree(ids, sides_px, board)
    best, agree = board, described
    for columns in range(3, MOST_COLUMNS + 1):
        for legacy in (False, True):
            rows = max(int(np.ceil(2 * (ids.max() + 1) / columns)) + 1, 3)
            rows += (rows + board.rows) % 2  # whether legacy boards begin with white depends on it
            dictionary = board.dictionary
            if columns * rows // 2 + 1 > len(load_dictionary(dictionary).bytesList):
                continue
            other = replace(board, columns=columns, rows=rows, legacy=legacy)
            if (count := _agree(ids, sides_px, other)) > agree:
                best, agree = other, count
    if best is board or agree < max(1.5 * described, described + LEAST_OTHERS - 1):
        return None
    return OtherBoard(best, agree, described)


def _agree(ids: np.ndarray, sides_px: FloatArray, board: CharucoBoard) -> int:
    finder = BoardFinder(board)
    known = ids < board.marker_count
    return int(np.sum(finder.agreeing(ids[known], sides_px[known])))


def marker_share(
    fit: CameraFit, marker_corners_px: FloatArray, view: NDArray[np.int64], board: CharucoBoard
) -> float | None:
    """Side of the markers as seen (corners (M, 4, 2) in views (M,)), by that described; None where there are none.

    The plane of each view takes their corners to the paper, whose scale is that of the squares.
    """
    if not len(view):
        return None
    rays = undistorted_rays(fit.camera, marker_corners_px)
    plane = np.linalg.inv(fit.T_cam_board[view][:, :3, [0, 1, 3]])
    on_paper = rays @ np.swapaxes(plane, -1, -2)
    flat = on_paper[..., :2] / on_paper[..., 2:]
    sides_m = np.linalg.norm(np.roll(flat, -1, axis=1) - flat, axis=-1).mean(axis=1)
    return float(np.nanmedian(sides_m)) / (board.marker_m * float(np.mean(board.stretch)))
