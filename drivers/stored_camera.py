"""Stored frames played as a camera's: at their own times, waiting for their reader, none lost."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from drivers.camera import Frame, Setting
from drivers.clock import Clock
from drivers.errors import CameraEnded, CameraError, WrongSize
from drivers.stored_frames import StoredFrame, StoredFrames, open_stored_frames

NS = 1_000_000_000


class StoredCamera:
    """A video file or a folder of images.

    A frame is due at its own time after `start` and has that time as its stamp, however late it is read. Frames
    without a time come as fast as they are read, stamped then.

    Args:
        source: path of the file or folder.
        size_px: (width, height) that the frames must have; None for whatever they have.
        fps: frames a second of images and bare streams, which have no times.
        clock: that the frames are played on; it may be a virtual one.
    """

    def __init__(self, source: str | Path, *, size_px: tuple[int, int] | None, fps: float | None, clock: Clock) -> None:
        self._source = Path(source)
        self._want_px = size_px
        self._want_fps = fps
        self._clock = clock
        self._frames: StoredFrames | None = None
        self._rest: Iterator[StoredFrame] = iter(())
        self._next: StoredFrame | None = None
        self._start_ns = 0
        self._given = 0

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height); raises CameraError where neither was it asked for nor is the camera started."""
        size_px = self._want_px if self._frames is None else self._frames.size_px
        if size_px is None:
            raise CameraError(f"'{self._source}': its frames' size isn't known before start(); call start() first")
        return size_px

    @property
    def fps(self) -> float | None:
        """Frames a second: after `start` as the file says, if it says anything."""
        return self._want_fps if self._frames is None else self._frames.fps

    @property
    def dropped(self) -> int:
        """None ever are."""
        return 0

    @property
    def stale(self) -> int:
        """None are looked for."""
        return 0

    @property
    def settings(self) -> Mapping[str, Setting]:
        """What the file says; nothing before `start`."""
        if self._frames is None:
            return {}
        width, height = self._frames.size_px
        return {
            "source": str(self._source),
            "size_px": f"{width}x{height}",
            "fps": self._frames.fps,
            "frames": self._frames.count,
        }

    def start(self) -> None:
        """Open the file or folder; its first frame is due now.

        Raises:
            NoCamera: there is none, or nothing to read in it.
            WrongSize: its frames have another size.
        """
        self.close()
        frames = open_stored_frames(self._source, fps=self._want_fps)
        if self._want_px is not None and frames.size_px != tuple(self._want_px):
            have, want = frames.size_px, self._want_px
            raise WrongSize(
                f"'{self._source}': it gives {have[0]}x{have[1]} px; want {want[0]}x{want[1]}\n"
                "set the size to its own, with a calibration made at that size"
            )
        self._frames, self._rest, self._given = frames, iter(frames), 0
        self._start_ns = self._clock.now_ns()

    def read(self, until_ns: int) -> Frame | None:
        """The next frame if it is due by `until_ns`, else None with the clock at `until_ns`.

        Raises:
            CameraEnded: all frames were read.
            DamagedFrames: all that could be read were.
            CameraError: the camera isn't started.
        """
        if self._frames is None:
            raise CameraError(f"'{self._source}': read before start(); call start() first")
        if self._next is None:
            self._next = next(self._rest, None)
        stored = self._next
        if stored is None:
            raise CameraEnded(f"'{self._source}': it ended after {self._given} frames")
        due_ns = self._clock.now_ns() if stored.t_s is None else self._start_ns + round(stored.t_s * NS)
        self._clock.sleep_until_ns(min(due_ns, until_ns))
        if due_ns > until_ns:
            return None
        self._next = None
        self._given += 1
        return Frame(stored.index, due_ns, stored.image, "arrival" if stored.t_s is None else "file")

    def close(self) -> None:
        """Let go of the file."""
        self._frames, self._rest, self._next = None, iter(()), None
