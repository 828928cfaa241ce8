"""A stored video's frames, each with the stamp that it counts by: the container's, a file's, or of a given rate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from calibration.intrinsics import CameraModel
from drivers.camera import Frame
from drivers.errors import CameraError
from drivers.stored_frames import StoredFrames, open_stored_frames
from station.errors import InvalidFile
from station.formats.text import read_text
from station.formats.timestamps import parse_timestamps

NS_PER_S = 1_000_000_000
# Two shapes of image are the same within this, relative: sizes are whole numbers.
SAME_SHAPE = 0.005


class Video:
    """Frames in order, each with a stamp; iterating begins anew at the first frame.

    Frames without a stamp are left out: those that a file of stamps doesn't list, and those that the container gives no
    time, or one that doesn't rise.

    Args:
        stored: the frames.
        stamps_ns: stamps by frame, in place of the video's own.

    Attributes:
        frames_seen: frames that the latest iteration met, up to now.
        left_out: those of them that had no stamp.
    """

    def __init__(self, stored: StoredFrames, stamps_ns: Mapping[int, int] | None = None) -> None:
        self._stored = stored
        self._stamps_ns = stamps_ns
        self.frames_seen = 0
        self.left_out = 0

    @property
    def name(self) -> str:
        """As in error texts."""
        return self._stored.name

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self._stored.size_px

    @property
    def count(self) -> int | None:
        """Number of frames as the container says it."""
        return self._stored.count

    def __iter__(self) -> Iterator[Frame]:
        self.frames_seen = self.left_out = 0
        for stored in self._stored:
            self.frames_seen += 1
            t_ns = self._stamp_ns(stored.index, stored.t_s)
            if t_ns is None:
                self.left_out += 1
            else:
                yield Frame(stored.index, t_ns, stored.image)

    def stamps_without_frame(self) -> int:
        """How many of the given stamps are of frames beyond the last that the latest iteration met."""
        return sum(frame >= self.frames_seen for frame in self._stamps_ns or ())

    def _stamp_ns(self, index: int, t_s: float | None) -> int | None:
        if self._stamps_ns is not None:
            return self._stamps_ns.get(index)
        return None if t_s is None else round(t_s * NS_PER_S)


def open_video(source: str | Path, *, timestamps: Path | None = None, fps: float | None = None) -> Video:
    """Open a video file or a folder of images.

    Args:
        source: its path.
        timestamps: a file `frame,t_s` whose stamps are used in place of the video's own.
        fps: frames a second of images without stamps.

    Raises:
        InvalidFile: no such video, none that can be read, one without stamps; a live camera.
    """
    if "://" in str(source) or str(source).isdecimal() or str(source).startswith("/dev/"):
        raise InvalidFile(
            f"'{source}' is a live camera; this command takes a video file or a folder of images\n"
            "put the camera into a rig.toml and watch it with: station capture --hand RIG --out DIR"
        )
    stamps_ns = None
    if timestamps is not None:
        stamps_ns = parse_timestamps(read_text(timestamps, "time stamps"), str(timestamps))
    try:
        stored = open_stored_frames(source, fps=fps)
    except CameraError as error:
        raise InvalidFile(str(error)) from error
    if stamps_ns is None and stored.fps is None and Path(source).is_dir():
        raise InvalidFile(
            f"{source} has images without times\n"
            "give their rate with --fps, or the time of each with --timestamps (frame,t_s)"
        )
    return Video(stored, stamps_ns)


def camera_for(video: Video, camera: CameraModel, *, scale: bool = False) -> CameraModel:
    """The camera, at the video's size.

    Args:
        scale: scale a calibration of another size of the same shape, for a video that shows the whole of that picture.

    Raises:
        InvalidFile: it is for another size, and mustn't or can't be scaled.
    """
    have, want = video.size_px, camera.size_px
    if have == want:
        return camera
    same_shape = abs(have[0] * want[1] / (have[1] * want[0]) - 1) < SAME_SHAPE
    if scale and same_shape:
        return camera.scaled_to(have)
    text = (
        f"{video.name} has frames of {have[0]} x {have[1]} px, the calibration is for {want[0]} x {want[1]} px\n"
        "calibrate at the size that is filmed"
    )
    if same_shape:
        text += "; if the video shows the whole picture, only smaller or larger, add --scale-camera"
    elif have == want[::-1]:
        text += "; this video was filmed with the camera turned by a quarter"
    raise InvalidFile(text)
