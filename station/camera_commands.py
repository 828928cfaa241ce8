"""What `station calibrate camera` does, as a function: views of a board, live or stored, to a calibrated camera."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calibration.boards import CharucoBoard, check_ruler, load_dictionary, parse_spec
from calibration.camera_calibration import CameraCalibration, RefineMarkers, calibrate_camera
from calibration.errors import CalibrationError
from calibration.pictures import encode_png
from calibration.view_selection import WANTED_VIEWS, Look, ViewSelector
from calibration.wrong_board import explain_missing
from drivers.clock import Clock, MonotonicClock, VirtualClock
from drivers.errors import CameraEnded, CameraError
from station.calibration_files import BOARD_FILE, CAMERA_FILE, VIEWS_FOLDER, clear_calibration, write_calibration
from station.errors import InvalidData, InvalidFile
from station.formats.board import parse_board
from station.formats.text import read_text
from station.session import check_output_folder

if TYPE_CHECKING:
    from drivers.camera import Camera

Image = NDArray[np.uint8]

# The board that a camera is shown without hardware, to try the wizard.
REHEARSAL = "rendered"
# A folder of more images than this is taken for a video: the views are chosen from it.
EVERY_UP_TO = 60
# Images that are kept to say why no board is found in them.
KEPT_IMAGES = 8
# A video in which the board rests for fewer views than this is looked through again for sharp frames of it in motion.
ENOUGH_AT_REST = 8
# Seconds after which a live camera's views are what they are, and between two looks at whether to stop.
LONGEST_S, LOOK_S = 300.0, 0.1
NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class MeasuredBoard:
    """A board, and whether its printed rulers were measured."""

    board: CharucoBoard
    measured: bool


@dataclass(frozen=True)
class Progress:
    """How far the search for views has come: the last look, all looks' selector, and the frame's number of so many."""

    look: Look
    selector: ViewSelector
    frame: int
    frames: int | None


@dataclass(frozen=True)
class Calibrated:
    """A calibration, where it was written, and the command that computes it again from the stored views."""

    folder: Path
    camera_file: Path
    calibration: CameraCalibration
    again: str


def read_board(choice: str | None, source: str | None) -> MeasuredBoard:
    """The board that a camera is calibrated with.

    Args:
        choice: a board.toml, or a word such as "charuco:7x10:25:18.75:DICT_5X5_100"; None for the board.toml beside
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
        raise InvalidData(f"measured length '{text}': want millimetres across x down, such as 99.6x99.9, or one for both")
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


def calibrate(
    source: str,
    board: CharucoBoard,
    out: Path,
    *,
    size_px: tuple[int, int] | None = None,
    fps: float | None = None,
    rig: str | None = None,
    force: bool = False,
    on_look: Callable[[Progress], None] = lambda progress: None,
    stop: Callable[[], bool] = lambda: False,
    say: Callable[[str], None] = lambda stage: None,
) -> Calibrated:
    """Calibrate a camera from views of a board and write camera.toml, calibration.json, coverage.png and the views.

    Args:
        source: a folder of images, a video, a live camera (index, device, address), or "rendered" to try it without one.
        board: at the printer's scale.
        out: new or empty folder.
        size_px, fps: asked of a live camera; the frames as they come if None.
        rig: whose camera it is: its settings are used for a live camera, and stored images must have its size.
        force: write over what is in the folder.
        on_look: is told of every frame.
        stop: says when a person has had enough of showing the board to a live camera.
        say: is told what is done next.

    Raises:
        StationError: an output folder that is occupied, a source that can't be read, too few views.
        CalibrationError: views that no camera can have seen.
        CameraError: a live camera that isn't there or stalls.
    """
    check_output_folder(out, force=force)
    in_place = Path(source).resolve() == (out / VIEWS_FOLDER).resolve()
    want_px = _rig_size(rig) if rig is not None else size_px
    say("views")
    taking = _Taking(board, out / VIEWS_FOLDER, want_px, in_place, on_look, stop)
    if source == REHEARSAL:
        from station.waved_board import waved_board

        clock = VirtualClock()
        taking.from_camera(waved_board(board, clock), clock)
    elif Path(source).exists() and not _is_device(source):
        taking.from_files(source)
    else:
        live_clock = MonotonicClock()
        taking.from_camera(_live_camera(source, size_px, fps, rig, live_clock), live_clock)
    selector = taking.selector
    _check_found(selector, board, source, taking.images)
    say("fit")
    done = calibrate_camera(selector.shots, board, marker_refinement(board))
    clear_calibration(out, keep=[out / VIEWS_FOLDER / shot.name for shot in selector.shots] if not in_place else ())
    taking.store()
    write_calibration(out, done, board, datetime.now(UTC))
    again = f"station calibrate camera {out / VIEWS_FOLDER} --out {out} --force"
    return Calibrated(out, out / CAMERA_FILE, done, again)
