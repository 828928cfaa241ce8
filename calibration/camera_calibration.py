"""From views of a board to a calibrated camera with all that is known of it: numbers, uncertainties, verdict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.board_detection import BoardView, Grey, IntArray
from calibration.boards import CharucoBoard
from calibration.camera_fit import CameraFit, Corners, fit_camera, refit_camera, stack_views
from calibration.edge_shift import LEAST_MARKERS, EdgeShift, estimate_edge_shift
from calibration.errors import CalibrationError
from calibration.held_out import HeldOut, held_out_errors
from calibration.intrinsics import CameraModel, FloatArray, project
from calibration.verdict import MARKER_SHARE, Verdict, judge, map_std_px
from calibration.view_quality import ViewQuality, assess_view, cover
from calibration.wrong_board import marker_share

# A view tells something with so many corners, in at least two rows and two columns.
LEAST_CORNERS = 8
# A view of which fewer corners than this share fit the camera that the others found is left out, and one whose corners
# are off by so many times what is common in the others, and by more than so much.
LEAST_FITTING = 0.5
STRAY_VIEW, STRAY_VIEW_PX = 6.0, 0.2
LEAST_VIEWS = 3

# Takes a grey image, ids (M,) and rough corners (M, 4, 2) of its markers, and the camera; gives ids and corners of
# those that are to be believed.
RefineMarkers = Callable[[Grey, IntArray, FloatArray, CameraModel], tuple[IntArray, FloatArray]]


@dataclass(frozen=True, eq=False)
class Shot:
    """A grey image (H, W), by what name it is known, and what it shows of the board."""

    name: str
    image: Grey
    view: BoardView
    quality: ViewQuality


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A calibrated camera, from which views, and how far it can be trusted.

    Attributes:
        camera: with rms_px, standard deviations and, where it was found, edge_shift_px.
        fit: of the views in `shots`.
        shots: the views that were used.
        left_out: names of the views that fit no camera together with the others.
        held_out: None where there are too few views for it.
        edge_shift: None where markers weren't refined, or are of another size than described.
        cover: (rows, columns) corners in each cell of the image.
        map_std_px: (rows, columns) standard deviation of where the camera has a direction, over the image.
        marker_share: side of the board's markers as seen, by that described.
        verdict: in words.
    """

    camera: CameraModel
    fit: CameraFit
    shots: tuple[Shot, ...]
    left_out: tuple[str, ...]
    held_out: HeldOut | None
    edge_shift: EdgeShift | None
    cover: FloatArray
    map_std_px: FloatArray
    marker_share: float | None
    verdict: Verdict


def is_telling(view: BoardView, board: CharucoBoard) -> bool:
    """Whether a view shows enough corners of the board: not few, not all in one line."""
    rows, columns = np.divmod(view.ids, board.columns - 1)
    return len(view) >= LEAST_CORNERS and len(np.unique(rows)) > 1 and len(np.unique(columns)) > 1


def calibrate_camera(
    shots: Sequence[Shot], board: CharucoBoard, refine_markers: RefineMarkers | None = None
) -> CameraCalibration:
    """Calibrate a camera from views of the board as it was measured.

    Args:
        shots: each `is_telling`.
        refine_markers: as the station refines markers' corners, to find the shift of black edges as it will see them.

    Raises:
        CalibrationError: fewer than three views, images of several sizes, corners that fit no camera.
    """
    _check_sizes(shots)
    kept, left_out = list(shots), list[str]()
    corners = _stacked(kept, board)
    fit = fit_camera(corners)
    fitting = np.bincount(corners.view, fit.used, minlength=len(kept)) / np.bincount(corners.view)
    bad = fitting < LEAST_FITTING
    bad |= fit.sigma_px > max(STRAY_VIEW * float(np.median(fit.sigma_px)), STRAY_VIEW_PX)
    if np.any(bad) and np.sum(~bad) >= LEAST_VIEWS:
        left_out = [shot.name for shot, is_bad in zip(kept, bad, strict=True) if is_bad]
        kept = [shot for shot, is_bad in zip(kept, bad, strict=True) if not is_bad]
        fit = refit_camera(fit, corners, ~bad)
        corners = corners.of(~bad)
    held_out = held_out_errors(fit, corners)
    share, shift = _markers(fit, kept, board, refine_markers)
    focal_px = float(np.mean(fit.camera.matrix[[0, 1], [0, 1]]))
    kept = [replace(shot, quality=assess_view(shot.view, shot.image, board, focal_px)) for shot in kept]
    covered = cover([shot.view for shot in kept])
    camera = fit.camera
    if shift is not None:
        camera = replace(camera, edge_shift_px=shift.shift_px, edge_shift_std_px=shift.std_px)
    return CameraCalibration(
        camera=camera,
        fit=fit,
        shots=tuple(kept),
        left_out=tuple(left_out),
        held_out=held_out,
        edge_shift=shift,
        cover=covered,
        map_std_px=map_std_px(fit),
        marker_share=share,
        verdict=judge(fit, held_out, [shot.quality for shot in kept], covered, share),
    )


def _check_sizes(shots: Sequence[Shot]) -> None:
    sizes: dict[tuple[int, int], str] = {}
    for shot in shots:
        sizes.setdefault(shot.view.size_px, shot.name)
    if len(sizes) > 1:
        each = ", ".join(f"{width}x{height} px ({name})" for (width, height), name in sizes.items())
        raise CalibrationError(f"the views are of several sizes: {each}\nwant images of one camera at one setting")


def _stacked(shots: Sequence[Shot], board: CharucoBoard) -> Corners:
    if len(shots) < LEAST_VIEWS:
        raise CalibrationError(
            f"{len(shots)} views show the board; want at least {LEAST_VIEWS}, 15 for a good calibration"
        )
    points = board.corner_points()
    views = [shot.view for shot in shots]
    return stack_views(views[0].size_px, [points[view.ids] for view in views], [view.corners_px for view in views])


def _markers(
    fit: CameraFit, shots: Sequence[Shot], board: CharucoBoard, refine: RefineMarkers | None
) -> tuple[float | None, EdgeShift | None]:
    """What the markers' edges say: their size against the description's, and how far black edges are shifted."""
    if refine is None:
        return None, None
    seen: list[FloatArray] = []
    ids: list[IntArray] = []
    view: list[IntArray] = []
    for number, shot in enumerate(shots):  # a view is an image
        names, corners = refine(shot.image, shot.view.marker_ids, shot.view.marker_corners_px, fit.camera)
        seen.append(corners)
        ids.append(names)
        view.append(np.full(len(names), number))
    corners_px, marker, number = np.concatenate(seen), np.concatenate(ids), np.concatenate(view)
    share = marker_share(fit, corners_px, number, board)
    if share is None or len(marker) < LEAST_MARKERS or abs(share - 1) > MARKER_SHARE[0]:
        return share, None
    T = fit.T_cam_board[number][:, None]
    p_cam = (T[..., :3, :3] @ board.marker_points()[marker][..., None])[..., 0] + T[..., :3, 3]
    return share, estimate_edge_shift(corners_px, project(fit.camera, p_cam), number)
