"""What `station calibrate camera` does, as a function: views of a board, live or stored, to a calibrated camera."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration import camera_calibration
from calibration.boards import CharucoBoard, check_ruler, parse_spec
from calibration.camera_calibration import CameraCalibration, RefineMarkers
from calibration.intrinsics import CameraModel, FloatArray
from calibration.sheets import largest_board
from station.calibrating.files import BOARD_FILE, CAMERA_FILE, VIEWS_FOLDER, clear_calibration, write_calibration
from station.calibrating.view_taking import CameraWish, Progress, store_view, take_views
from station.errors import InvalidData
from station.formats.board import parse_board
from station.formats.rig import RENDERED
from station.formats.text import read_text
from station.rig_reading import read_rig
from station.session import check_output_folder

__all__ = [
    "Calibrated",
    "MeasuredBoard",
    "Progress",
    "calibrate_camera",
    "parse_ruler",
    "read_board",
    "require_measured",
]

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class MeasuredBoard:
    """A board, and whether its printed rulers were measured."""

    board: CharucoBoard
    measured: bool


@dataclass(frozen=True)
class Calibrated:
    """A calibration, where it was written, the command that computes it again, and what else is to be said."""

    folder: Path
    camera_file: Path
    calibration: CameraCalibration
    again: str
    notices: tuple[str, ...] = ()


def read_board(choice: str | None, source: str | None) -> MeasuredBoard:
    """The board that a camera is calibrated with.

    Args:
        choice: a board.toml, or a word such as "charuco:7x10:25:17.5:DICT_5X5_100"; None for the board.toml beside
            the views in `source`.

    Raises:
        InvalidData: neither is there.
        InvalidFile: a bad board.toml.
        CalibrationError: a bad word.
    """
    if choice is not None and choice.startswith("charuco:"):
        return MeasuredBoard(parse_spec(choice), measured=False)
    if choice is not None:
        return MeasuredBoard(*parse_board(read_text(Path(choice), "board", "or charuco:..."), choice))
    if source == RENDERED:
        return MeasuredBoard(largest_board("a4", 25.0, 17.5, "DICT_5X5_100"), measured=True)
    beside = () if source is None else (Path(source) / BOARD_FILE, Path(source).parent / BOARD_FILE)
    for path in beside:
        if path.is_file():
            return MeasuredBoard(*parse_board(read_text(path, "board"), str(path)))
    raise InvalidData(
        "no board: want --board with the board.toml that 'station board' wrote, or the description that is printed on "
        "the sheet (charuco:...)\nprint one with: station board --out board.pdf"
    )


def parse_ruler(text: str) -> tuple[float, float]:
    """Measured rulers (across, down), mm, of "99.6x99.9", or of "99.6" for both; raises StationError."""
    parts = text.lower().replace("mm", "").split("x")
    try:
        lengths = [float(part) for part in parts]
    except ValueError:
        lengths = []
    if len(lengths) not in (1, 2):
        raise InvalidData(
            f"measured length '{text}': want millimetres across x down, such as 99.6x99.9, or one for both"
        )
    ruler = lengths[0], lengths[-1]
    check_ruler(ruler)
    return ruler


def require_measured(board: MeasuredBoard, measured_mm: tuple[float, float] | None) -> CharucoBoard:
    """The board at the printer's scale; raises InvalidData where nobody measured it."""
    if measured_mm is not None:
        return board.board.measured(measured_mm)
    if board.measured:
        return board.board
    raise InvalidData(
        "the printed rulers were not measured: printers scale by up to some percent, across and down unlike\n"
        "measure both 100 mm rulers on the sheet and say --measured-mm ACROSSxDOWN, such as --measured-mm 99.6x99.9"
    )


def calibrate_camera(
    source: str | None,
    board: CharucoBoard,
    out: Path,
    *,
    rig: str | None = None,
    size_px: tuple[int, int] | None = None,
    fps: float | None = None,
    force: bool = False,
    on_look: Callable[[Progress], None] = lambda progress: None,
    stop: Callable[[], bool] = lambda: False,
    say: Callable[[str], None] = lambda stage: None,
) -> Calibrated:
    """Calibrate a camera from views of a board; writes camera.toml, calibration.json, coverage.png and the views.

    Args:
        source: a folder of images, a video, a live camera (index, device, address), or "rendered": a board waved before
            a simulated camera. None is the rig's camera.
        board: at the printer's scale.
        out: new or empty folder.
        rig: whose camera it is, as the rig sets it; stored images must have its size.
        size_px, fps: asked of a live camera; the frames as they come if None.
        force: write over what is in the folder.
        on_look: is told of every frame.
        stop: says when a person has had enough of showing the board to a live camera.
        say: is told what is done next.

    Raises:
        StationError: an output folder that is occupied, a source that can't be read, a board that isn't seen.
        CalibrationError: views that no camera can have seen.
        CameraError: a live camera that isn't there or stalls.
    """
    check_output_folder(out, force=force)
    table = None if rig is None else read_rig(rig)[0]
    if source is None and table is None:
        raise InvalidData(
            "no source: want a camera's index, device or address, a video, a folder of images, or --rig RIG"
        )
    settings = CameraWish(source, size_px, fps, table)
    views = out / VIEWS_FOLDER
    in_place = source is not None and Path(source).resolve() == views.resolve()
    say("views")
    taken = take_views(settings, board, views, on_look, stop)
    say("fit")
    done = camera_calibration.calibrate_camera(taken.shots, board, marker_refinement(board))
    if not (in_place or taken.stored):
        clear_calibration(out)
        for shot in taken.shots:
            store_view(views, shot)
    write_calibration(out, done, board, datetime.now(UTC))
    again = f"station calibrate camera {shlex.quote(str(views))} --out {shlex.quote(str(out))} --force"
    return Calibrated(out, out / CAMERA_FILE, done, again, taken.notices)


def marker_refinement(board: CharucoBoard) -> RefineMarkers:
    """As the station's detector finds markers' corners, of which it then corrects the edge shift."""
    from station.perception.corners import MarkerDetector, RoughMarkers

    def refine(
        grey: Image, ids: NDArray[np.int64], corners_px: FloatArray, camera: CameraModel
    ) -> tuple[NDArray[np.int64], FloatArray]:
        found = MarkerDetector(board.dictionary, camera).refine(grey, RoughMarkers(ids, corners_px))
        return found.ids, found.corners_px

    return refine
