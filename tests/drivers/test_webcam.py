"""Webcam: a real video file through the real OpenCV, and what a live camera does through a fake capture."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.camera import Camera, Frame
from drivers.clock import MonotonicClock, VirtualClock
from drivers.errors import CameraError, CameraStalled, NoCamera
from drivers.webcam import Webcam

MS = 1_000_000
SIZE = (64, 48)
FRAMES = 20
FILE_FPS = 100.0
# Grey levels. JPEG at OpenCV's default quality keeps a flat image within this.
JPEG_GREY = 3


def write_video(path: Path, fps: float = FILE_FPS, frames: int = FRAMES) -> Path:
    """A Motion JPEG file whose frame k is flat grey 10 k."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, SIZE)
    for k in range(frames):
        writer.write(np.full((SIZE[1], SIZE[0], 3), 10 * k, dtype=np.uint8))
    writer.release()
    return path


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return write_video(tmp_path / "grey.avi")


def soon(seconds: float = 5.0) -> int:
    return time.monotonic_ns() + round(seconds * 1e9)


def read_to_the_end(camera: Camera) -> list[Frame]:
    frames: list[Frame] = []
    with pytest.raises(CameraStalled, match="ended after"):
        while frame := camera.read(soon()):
            frames.append(frame)
    return frames


def webcam_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "webcam"]


def test_a_file_is_read_whole_and_in_order(video: Path) -> None:
    camera = Webcam(str(video), SIZE, 30.0, MonotonicClock())
    camera.start()
    frames = read_to_the_end(camera)
    assert [frame.index for frame in frames] == list(range(FRAMES))
    levels = np.array([frame.image.mean() for frame in frames])
    np.testing.assert_allclose(levels, 10 * np.arange(FRAMES), atol=JPEG_GREY)
    assert frames[0].image.shape == (SIZE[1], SIZE[0], 3)
    assert frames[0].image.dtype == np.uint8
    assert camera.dropped == 0
    assert camera.fps == FILE_FPS
    camera.close()


def test_a_file_plays_at_its_own_speed_and_waits_for_a_slow_reader(video: Path) -> None:
    clock = VirtualClock(start_ns=5 * MS)
    camera = Webcam(str(video), SIZE, 30.0, clock)
    camera.start()
    time.sleep(0.1)  # the reader's queue is full by now
    frames = read_to_the_end(camera)
    assert [frame.t_ns for frame in frames] == [5 * MS + 10 * MS * k for k in range(FRAMES)]
    assert camera.dropped == 0
    camera.close()


def test_no_frame_by_the_time_given_is_none(tmp_path: Path) -> None:
    camera = Webcam(str(write_video(tmp_path / "slow.avi", fps=4.0)), SIZE, 4.0, MonotonicClock())
    camera.start()
    assert camera.read(soon()) is not None
    until_ns = soon(0.03)
    assert camera.read(until_ns) is None
    assert time.monotonic_ns() >= until_ns
    camera.close()


def test_close_ends_the_thread_and_a_camera_starts_again(video: Path) -> None:
    camera = Webcam(str(video), SIZE, 30.0, MonotonicClock())
    camera.close()
    for _ in range(2):
        camera.start()
        first = camera.read(soon())
        assert first is not None and first.index == 0
        camera.close()
        assert not webcam_threads()
    with pytest.raises(CameraError, match=r"call start\(\)"):
        camera.read(soon())


@pytest.mark.parametrize("source", [97, "/dev/video97", "no_such_file.avi"])
def test_a_missing_camera_is_one_error_and_no_chatter(source: int | str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(NoCamera, match=r"there is no .*(video97|no_such_file\.avi).*this machine has"):
        Webcam(source, SIZE, 30.0, MonotonicClock()).start()
    assert capfd.readouterr() == ("", "")
    assert not webcam_threads()


def test_a_file_that_is_no_video_is_no_camera(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "notes.avi"
    path.write_text("no video\n" * 100)
    with pytest.raises(NoCamera, match="is no video that OpenCV reads"):
        Webcam(str(path), SIZE, 30.0, MonotonicClock()).start()
    assert capfd.readouterr() == ("", "")


def test_another_size_is_refused(video: Path) -> None:
    camera = Webcam(str(video), (640, 480), 30.0, MonotonicClock())
    with pytest.raises(CameraError, match="gives 64x48 px; want 640x480"):
        camera.start()
    assert not webcam_threads()


class FakeCapture:
    """A live camera on a virtual clock: a frame every 10 ms, 4 ms to decode it, silent after `frames`."""

    def __init__(self, clock: VirtualClock, frames: int, reader_is_ready: threading.Event) -> None:
        self._clock = clock
        self._left = frames
        self._ready = reader_is_ready
        self._shape = {cv2.CAP_PROP_FRAME_WIDTH: 0.0, cv2.CAP_PROP_FRAME_HEIGHT: 0.0, cv2.CAP_PROP_FPS: 0.0}
        self.released = False

    def isOpened(self) -> bool:
        return True

    def set(self, prop: int, value: float) -> bool:
        self._shape[prop] = value
        return True

    def get(self, prop: int) -> float:
        return self._shape[prop]

    def grab(self) -> bool:
        if not self._left:
            self._ready.wait(5)
            return False
        self._left -= 1
        self._clock.sleep_until_ns((self._clock.now_ns() // (10 * MS) + 1) * 10 * MS)
        return True

    def retrieve(self) -> tuple[bool, np.ndarray]:
        self._clock.sleep_until_ns(self._clock.now_ns() + 4 * MS)
        return True, np.zeros((SIZE[1], SIZE[0], 3), np.uint8)

    def release(self) -> None:
        self.released = True


class Live:
    """A webcam on a fake capture; `finished` is set once the test wants the silence after the last frame."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, frames: int) -> None:
        self.clock = VirtualClock()
        self.finished = threading.Event()
        self.capture = FakeCapture(self.clock, frames, self.finished)
        monkeypatch.setattr(cv2, "VideoCapture", lambda source: self.capture)
        self.camera = Webcam("fake://camera", SIZE, 100.0, self.clock, stall_s=1.0)


@pytest.fixture
def live(monkeypatch: pytest.MonkeyPatch) -> Iterator[Live]:
    live = Live(monkeypatch, frames=30)
    yield live
    live.finished.set()
    live.camera.close()


def test_frames_are_stamped_before_they_are_decoded(live: Live) -> None:
    live.camera.start()
    frame = live.camera.read(10_000 * MS)
    assert frame is not None
    assert frame.t_ns % (10 * MS) == 0  # decoding would have added 4 ms


def test_frames_nobody_reads_are_counted(live: Live) -> None:
    live.camera.start()
    while live.clock.now_ns() < 304 * MS:  # 30 frames are taken; nobody reads
        time.sleep(0.001)
    time.sleep(0.02)
    frames: list[Frame] = []
    while frame := live.camera.read(live.clock.now_ns()):
        frames.append(frame)
    indices = [frame.index for frame in frames]
    assert indices == list(range(30 - len(frames), 30))
    assert live.camera.dropped == 30 - len(frames) > 0


def test_a_camera_that_falls_silent_has_stalled(live: Live) -> None:
    live.camera.start()
    live.finished.set()
    count = 0
    with pytest.raises(CameraStalled, match="no frame for 1 s"):
        while live.camera.read(3_600_000 * MS):
            count += 1
    assert count + live.camera.dropped == 30
    assert live.clock.now_ns() >= 1300 * MS
    live.camera.close()
    assert live.capture.released
