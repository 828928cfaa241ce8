"""Views of a board, taken from images, a video or a live camera, and stored without loss."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calibration.boards import CharucoBoard
from calibration.camera_calibration import LEAST_VIEWS, Shot
from calibration.pictures import encode_png
from calibration.view_selection import Look, ViewSelector
from calibration.wrong_board import explain_missing
from drivers.camera_sources import is_stored, open_camera
from drivers.clock import Clock, MonotonicClock, VirtualClock
from drivers.errors import CameraError, CameraStalled, DamagedFrames
from drivers.stored_frames import StoredFrames, VideoFile, open_stored_frames
from station.calibrating.files import BOARD_FILE, clear_calibration
from station.errors import InvalidData, InvalidFile
from station.formats.board import format_board
from station.formats.rig import RENDERED, RigTable
from station.rig import frame_size, real_camera

if TYPE_CHECKING:
    from drivers.camera import Camera

Image = NDArray[np.uint8]

# A folder of more images than this is taken for a video: views are chosen from it.
EVERY_UP_TO = 60
# A video in which the board rests for fewer views is looked through again, for sharp frames of it in motion.
ENOUGH_AT_REST = 8
# Images kept to say why no board is found in them.
KEPT_IMAGES = 8
# Seconds after which a live camera's views are what they are; and between two looks at whether to stop.
LONGEST_S, LOOK_S = 600.0, 0.2
# A live set that is still incomplete after so many views is what it is.
MOST_VIEWS = 30
NS_PER_S = 1e9


@dataclass(frozen=True)
class Progress:
    """How far the search for views has come: the last look, the selector of all, the frame's number, of how many."""

    look: Look
    selector: ViewSelector
    frame: int
    frames: int | None


@dataclass(frozen=True)
class CameraWish:
    """Where views come from: see `calibrate_camera`."""

    source: str | None
    size_px: tuple[int, int] | None
    fps: float | None
    rig: RigTable | None


@dataclass(frozen=True)
class Taken:
    """Views, whether they are in the folder of views already, and what is to be said of their source."""

    shots: tuple[Shot, ...]
    stored: bool
    notices: tuple[str, ...] = ()


OnLook = Callable[[Progress], None]


def take_views(wish: CameraWish, board: CharucoBoard, folder: Path, on_look: OnLook, stop: Callable[[], bool]) -> Taken:
    """Views of the board from the source; those of a live camera are stored in the folder as they are taken.

    Raises:
        InvalidFile: stored frames that can't be read.
        InvalidData: the board isn't seen often enough, with what is seen instead.
        CameraError: a live camera that isn't there or stalls.
    """
    source = wish.source
    if source is not None and is_stored(source):
        selector, images, notices = _from_files(source, wish, board, on_look)
        _check_found(selector, board, source, images)
        return Taken(tuple(selector.shots), stored=False, notices=tuple(notices))
    with contextlib.ExitStack() as stack:
        camera, clock = _opened(wish, board)
        stack.callback(camera.close)
        camera.start()
        selector, images = _from_camera(camera, clock, board, folder, on_look, stop)
    _check_found(selector, board, source or "the rig's camera", images)
    return Taken(tuple(selector.shots), stored=True)


def store_view(folder: Path, shot: Shot) -> None:
    """Write a view's image as PNG, without loss."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / shot.name).write_bytes(encode_png(shot.image))


def _from_files(
    source: str, wish: CameraWish, board: CharucoBoard, on_look: OnLook
) -> tuple[ViewSelector, list[Image], list[str]]:
    """Every image of a folder; of a video, or very many images, those where the board rests, is sharp and elsewhere."""
    try:
        frames = open_stored_frames(source)
    except CameraError as error:
        raise InvalidFile(str(error)) from error
    _check_size(frames.size_px, wish, source)
    video = isinstance(frames, VideoFile)
    every = not video and (frames.count or 0) <= EVERY_UP_TO
    selector, images = ViewSelector(board, wait_for_rest=video, every=every), list[Image]()
    notices = _look_at(frames, selector, images, on_look)
    if video and len(selector.shots) < ENOUGH_AT_REST and selector.frames_with_board:
        selector = ViewSelector(board, wait_for_rest=False)
        _look_at(frames, selector, [], on_look)
    return selector, images, notices


def _look_at(frames: StoredFrames, selector: ViewSelector, images: list[Image], on_look: OnLook) -> list[str]:
    """Look at all frames, keep some in `images`; what is to be said of frames that couldn't be read."""
    files = getattr(frames, "files", None)
    stride = max((frames.count or 1) // KEPT_IMAGES, 1)
    try:
        for frame in frames:
            stem = None if files is None else files[frame.index].stem
            name = f"view_{len(selector.shots) + 1:03d}.png" if stem is None else f"{stem}.png"
            if any(shot.name == name for shot in selector.shots):  # a.png and a.jpg
                name = f"{stem}_{frame.index}.png"
            if frame.index % stride == 0 and len(images) < KEPT_IMAGES:
                images.append(frame.image)
            look = selector.look(frame.image, name)
            on_look(Progress(look, selector, frame.index + 1, frames.count))
    except DamagedFrames as error:
        if not selector.shots:
            raise InvalidFile(str(error)) from error
        return [str(error).splitlines()[0]]
    except CameraError as error:
        raise InvalidFile(str(error)) from error
    return []


def _opened(wish: CameraWish, board: CharucoBoard) -> tuple[Camera, Clock]:
    """The live camera that is wished for, not started, and its clock."""
    if wish.source == RENDERED:
        from station.calibrating.waved_board import waved_board_camera

        clock = VirtualClock()
        return waved_board_camera(board, clock), clock
    real_clock = MonotonicClock()
    if wish.source is not None:
        size_px = frame_size(wish.rig) if wish.rig is not None else wish.size_px
        return open_camera(wish.source, size_px=size_px, fps=wish.fps, clock=real_clock), real_clock
    if wish.rig is None or wish.rig.camera.source == RENDERED:
        raise InvalidData(
            "the rig's camera is rendered and sees the arm, no board\n"
            "try the calibration without hardware with: station calibrate camera rendered --out DIR"
        )
    return real_camera(wish.rig, real_clock), real_clock


def _from_camera(
    camera: Camera, clock: Clock, board: CharucoBoard, folder: Path, on_look: OnLook, stop: Callable[[], bool]
) -> tuple[ViewSelector, list[Image]]:
    """Views until the set is complete, the person has had enough, or the camera has no more frames."""
    selector, images = ViewSelector(board), list[Image]()
    clear_calibration(folder.parent)
    folder.mkdir(parents=True, exist_ok=True)
    (folder.parent / BOARD_FILE).write_text(format_board(board, measured=True), encoding="utf-8")
    end_ns = clock.now_ns() + round(LONGEST_S * NS_PER_S)
    number = 0
    while not (selector.complete or stop() or clock.now_ns() >= end_ns or len(selector.shots) >= MOST_VIEWS):
        try:
            frame = _newest(camera, clock)
        except CameraStalled:
            if len(selector.shots) < LEAST_VIEWS:
                raise
            break  # it ended, or vanished: there are views to calibrate with
        if frame is None:
            continue
        number += 1
        if len(images) < KEPT_IMAGES:
            images.append(frame)
        look = selector.look(frame, f"view_{len(selector.shots) + 1:03d}.png")
        if look.taken:
            store_view(folder, selector.shots[-1])
        on_look(Progress(look, selector, number, None))
    return selector, images


def _newest(camera: Camera, clock: Clock) -> Image | None:
    """The newest frame that has arrived: looking at each takes longer than a frame's time on a slow machine."""
    frame = camera.read(clock.now_ns() + round(LOOK_S * NS_PER_S))
    if isinstance(clock, VirtualClock):
        return None if frame is None else frame.image
    while frame is not None and (later := camera.read(clock.now_ns())) is not None:
        frame = later
    return None if frame is None else frame.image


def _check_size(size_px: tuple[int, int], wish: CameraWish, source: str) -> None:
    want = frame_size(wish.rig) if wish.rig is not None else wish.size_px
    if want is not None and size_px != want:
        raise InvalidData(
            f"{source}: its images have {size_px[0]}x{size_px[1]} px, the camera is set to {want[0]}x{want[1]} px\n"
            "calibrate with images of the size that is captured, or set size_px to theirs"
        )


def _check_found(selector: ViewSelector, board: CharucoBoard, source: str, images: list[Image]) -> None:
    if len(selector.shots) >= LEAST_VIEWS:
        return
    found = f"{source}: {len(selector.shots) or 'no'} usable view{'' if len(selector.shots) == 1 else 's'}"
    found += f" of the board in {selector.frames} images; want at least {LEAST_VIEWS}, 15 for a good calibration"
    if selector.frames_with_board:
        raise InvalidData(f"{found}\nshow the board larger, sharper, and each time at another place and tilt")
    looked_for = f"looked for {board.said}"
    raise InvalidData(f"{found}\n{looked_for}\n{explain_missing(images, board) if images else 'no image was read'}")
