"""Stored frames: a video file or a folder of images, read as fast as the reader wants, without losing any."""

from __future__ import annotations

import re
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import Image
from drivers.errors import DamagedFrames, NoCamera, NoFrames, WrongSize
from drivers.quiet_opencv import quiet_opencv

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm", ".jp2")
# Bare streams without a container: FFmpeg makes up their frame rate and their time stamps.
BARE_SUFFIXES = (".mjpeg", ".mjpg", ".h264", ".264", ".h265", ".265", ".hevc")
# As the sensor has them: a tag that says "turn me" would make one camera's pictures two cameras'.
AS_TAKEN = cv2.IMREAD_COLOR_BGR | cv2.IMREAD_IGNORE_ORIENTATION
# A video that ends earlier than it says by more than this (frames, and share of its length) has lost its end. Less is
# common in whole ones: some containers only say how long they are, sound included.
SLACK_FRAMES = 1.5
SLACK_SHARE = 0.01


@dataclass(frozen=True, eq=False, slots=True)
class StoredFrame:
    """One image of a file or folder.

    Attributes:
        index: counts the frames that were read, from 0.
        t_s: the container's own time stamp, from its first frame's on; of images and streams without stamps
            `index / fps`; None where nobody knows, or where a stamp doesn't rise above the one before.
        image: (H, W, 3) uint8 BGR.
    """

    index: int
    t_s: float | None
    image: Image


class StoredFrames(Protocol):
    """A video or folder that was found to hold frames. Each iteration begins anew, at the first frame.

    Iterating raises, after all frames that could be read were given, `DamagedFrames` (with their number) where more
    should be there, and `WrongSize` at a frame of another size than the first.

    Attributes:
        name: as in error texts.
        size_px: (width, height) of all frames.
        fps: frames a second, nominal; None where nobody knows.
        count: number of frames as the container says it, without having read them; None where it doesn't.
    """

    @property
    def name(self) -> str: ...

    @property
    def size_px(self) -> tuple[int, int]: ...

    @property
    def fps(self) -> float | None: ...

    @property
    def count(self) -> int | None: ...

    def __iter__(self) -> Iterator[StoredFrame]: ...


def open_stored_frames(source: str | Path, *, fps: float | None = None) -> StoredFrames:
    """Look at a video file, a folder of images, or one image.

    Args:
        source: its path.
        fps: frames a second of images and of bare streams, which have no time stamps; a container's own go before it.

    Raises:
        NoCamera: it isn't there.
        NoFrames: there is nothing to read in it: an empty file, no video, a folder without images.
        DamagedFrames: the first image can't be decoded.
    """
    path = Path(source)
    if not path.exists():
        raise NoCamera(f"there is no {path}; give a video file or a folder of images")
    if path.is_dir():
        return ImageFiles(path, images_in(path), fps=fps)
    if path.stat().st_size == 0:
        raise NoFrames(f"{path} is an empty file; want a video")
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return ImageFiles(path, (path,), fps=fps)
    return VideoFile(path, fps=fps)


def decode_image(data: NDArray[np.uint8]) -> Image | None:
    """The picture (H, W, 3) in an encoded one (N,); None if it is none, or cut short."""
    try:
        with quiet_opencv():
            image = cv2.imdecode(data, AS_TAKEN)
    except cv2.error:  # no bytes, or a size that can't be
        return None
    return None if image is None else np.asarray(image, dtype=np.uint8)


def natural_order(name: str) -> list[tuple[int, int, str]]:
    """Sort key of a file name, by which frame_2 comes before frame_10, in whatever case."""
    parts = re.split(r"(\d+)", name)
    return [(0, int(part), part) if part.isdecimal() else (1, 0, part.casefold()) for part in parts if part]


def images_in(folder: Path) -> tuple[Path, ...]:
    """The image files of a folder in natural order, hidden ones left out; raises NoFrames where there are none."""
    files = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and path.name[0] != "."]
    if not files:
        raise NoFrames(f"{folder} has no images in it; want files that end in {' '.join(IMAGE_SUFFIXES)}")
    return tuple(sorted(files, key=lambda path: (natural_order(path.name), path.name)))


class ImageFiles:
    """Image files in the order given, all of one size.

    Args:
        folder: for the name.
        files: at least one.
        fps: frames a second, if anybody knows.

    Raises:
        DamagedFrames: the first image can't be decoded.
    """

    def __init__(self, folder: Path, files: tuple[Path, ...], *, fps: float | None = None) -> None:
        self.name = str(folder)
        self.files = files
        self.fps = fps
        self.count: int | None = len(files)
        first = self._image(0)
        self.size_px = (first.shape[1], first.shape[0])

    def __iter__(self) -> Iterator[StoredFrame]:
        for index in range(len(self.files)):
            image = self._image(index)
            _check_size(image, self.size_px, str(self.files[index]), index)
            yield StoredFrame(index, None if self.fps is None else index / self.fps, image)

    def _image(self, index: int) -> Image:
        file = self.files[index]
        data = np.fromfile(file, dtype=np.uint8)
        image = decode_image(data)
        if image is None:
            text = f"{file} is no image that OpenCV reads; {index} of {len(self.files)} were read before it"
            raise DamagedFrames(f"{text}\nremove it or save it anew", frames=index)
        return image


class VideoFile:
    """A video file that OpenCV's FFmpeg reads.

    Args:
        path: of the file.
        fps: frames a second of a bare stream.

    Raises:
        NoFrames: it has no video that can be decoded.
    """

    def __init__(self, path: Path, *, fps: float | None = None) -> None:
        self.name = str(path)
        self._bare = path.suffix.lower() in BARE_SUFFIXES
        with self._opened() as capture:
            if not capture.grab():
                raise NoFrames(f"{path} has no frame that could be decoded; it may be damaged or not wholly written")
            self.size_px = (
                round(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
                round(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
            )
            own_fps, count = capture.get(cv2.CAP_PROP_FPS), capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self.fps = fps if self._bare else own_fps if own_fps > 0 else None
        self.count = round(count) if count > 0 else None

    def __iter__(self) -> Iterator[StoredFrame]:
        with self._opened() as capture:
            index, last_s = 0, -1.0
            while capture.grab():
                stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                good, image = capture.retrieve()
                if not good:
                    raise self._damaged(index)
                frame = np.asarray(image, dtype=np.uint8)
                _check_size(frame, self.size_px, self.name, index)
                yield StoredFrame(index, self._time_s(index, stamp_s, last_s), frame)
                last_s = max(last_s, stamp_s)
                index += 1
        if self._ended_early(index, last_s):
            raise self._damaged(index)

    def _time_s(self, index: int, stamp_s: float, last_s: float) -> float | None:
        if self._bare:
            return None if self.fps is None else index / self.fps
        return stamp_s if stamp_s > last_s else None

    def _ended_early(self, frames: int, last_s: float) -> bool:
        """Whether both the frames and the time are short of what the container says.

        Either alone is no sign of damage: the number may be a guess from the length, the rate may vary.
        """
        if self.count is None or self.fps is None or frames >= self.count:
            return False
        length_s = self.count / self.fps
        return last_s + max(SLACK_FRAMES / self.fps, SLACK_SHARE * length_s) < length_s

    def _damaged(self, frames: int) -> DamagedFrames:
        says = "" if self.count is None else f"; it says that it has {self.count}"
        text = f"{self.name} is damaged or cut short: {frames} frames could be read, none after them{says}"
        return DamagedFrames(text, frames=frames)

    @contextmanager
    def _opened(self) -> Generator[cv2.VideoCapture]:
        with quiet_opencv():
            capture = cv2.VideoCapture(self.name, cv2.CAP_FFMPEG)
        try:
            if not capture.isOpened():
                raise NoFrames(f"{self.name} is no video that OpenCV reads; it may be damaged or not wholly written")
            capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
            yield capture
        finally:
            capture.release()


def _check_size(image: Image, size_px: tuple[int, int], where: str, index: int) -> None:
    have = (image.shape[1], image.shape[0])
    if have != size_px:
        raise WrongSize(
            f"{where}: frame {index} has {have[0]}x{have[1]} px; the first has {size_px[0]}x{size_px[1]}\n"
            "frames of one camera have one size: sort them into folders by size"
        )
