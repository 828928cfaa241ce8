"""Stored frames played as a camera's, on virtual clocks and the real one."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import Camera, Frame
from drivers.clock import MonotonicClock, VirtualClock
from drivers.errors import CameraEnded, CameraError, DamagedFrames, NoFrames, WrongSize
from drivers.stored_camera import StoredCamera
from tests.drivers.videos import FRAMES, SIZE, textured, write_images, write_video

MS = 1_000_000
LATE = 10**18
# Grey levels. JPEG at OpenCV's default quality keeps a flat image within this.
JPEG_GREY = 3


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return write_video(tmp_path / "grey.avi", fps=100.0)


def read_to_the_end(camera: Camera) -> list[Frame]:
    frames: list[Frame] = []
    with pytest.raises(CameraEnded, match=r"ended after \d+ frames"):
        while frame := camera.read(LATE):
            frames.append(frame)
    return frames


def stored(path: Path, clock: VirtualClock | MonotonicClock | None = None, fps: float | None = None) -> StoredCamera:
    camera = StoredCamera(path, size_px=None, fps=fps, clock=clock or VirtualClock())
    camera.start()
    return camera


def test_a_file_is_read_whole_and_in_order(video: Path) -> None:
    camera = stored(video)
    frames = read_to_the_end(camera)
    assert [frame.index for frame in frames] == list(range(FRAMES))
    levels = np.array([frame.image.mean() for frame in frames])
    np.testing.assert_allclose(levels, 10 * np.arange(FRAMES), atol=JPEG_GREY)
    assert (camera.size_px, camera.fps, camera.dropped, camera.stale) == (SIZE, 100.0, 0, 0)
    assert camera.settings == {"source": str(video), "size_px": "64x48", "fps": 100.0, "frames": FRAMES}
    camera.close()


def test_frames_have_their_own_times_however_late_they_are_read(video: Path) -> None:
    clock = VirtualClock(start_ns=5 * MS)
    camera = stored(video, clock)
    clock.sleep_until_ns(100 * MS)
    frames = read_to_the_end(camera)
    assert [frame.t_ns for frame in frames] == [5 * MS + 10 * MS * k for k in range(FRAMES)]
    assert {frame.stamp for frame in frames} == {"file"}


def test_a_frame_that_is_not_due_yet_is_none_and_the_clock_at_until(video: Path) -> None:
    clock = VirtualClock()
    camera = stored(video, clock)
    assert camera.read(0) is not None
    assert camera.read(10 * MS - 1) is None and clock.now_ns() == 10 * MS - 1
    frame = camera.read(LATE)
    assert frame is not None and frame.index == 1 and clock.now_ns() == 10 * MS


def test_on_the_real_clock_a_file_plays_at_its_own_speed(video: Path) -> None:
    camera = stored(video, MonotonicClock())
    for frame in read_to_the_end(camera):
        assert time.monotonic_ns() >= frame.t_ns
    camera.close()


def test_images_play_at_the_rate_given_or_as_fast_as_they_are_read(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "shots", ["1.png", "2.png", "3.png"])
    assert [frame.t_ns for frame in read_to_the_end(stored(folder, fps=10.0))] == [0, 100 * MS, 200 * MS]
    frames = read_to_the_end(stored(folder))
    assert [(frame.t_ns, frame.stamp) for frame in frames] == [(0, "arrival")] * 3


def test_a_camera_starts_again_from_the_first_frame(video: Path) -> None:
    camera = StoredCamera(video, size_px=SIZE, fps=None, clock=VirtualClock())
    camera.close()
    for _ in range(2):
        camera.start()
        first = camera.read(LATE)
        assert first is not None and first.index == 0
        camera.close()
    with pytest.raises(CameraError, match=r"call start\(\)"):
        camera.read(LATE)


def test_another_size_is_refused(video: Path) -> None:
    with pytest.raises(WrongSize, match=r"gives 64x48 px; want 640x480"):
        StoredCamera(video, size_px=(640, 480), fps=None, clock=VirtualClock()).start()


def test_a_file_that_is_no_video_has_no_frames(tmp_path: Path) -> None:
    path = tmp_path / "notes.avi"
    path.write_text("no video\n" * 100)
    with pytest.raises(NoFrames, match=r"is no video that OpenCV reads"):
        stored(path)


def test_a_damaged_file_gives_what_it_has_before_it_says_so(tmp_path: Path) -> None:
    path = write_video(tmp_path / "v.avi", picture=textured)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    camera = stored(path)
    given = 0
    with pytest.raises(DamagedFrames) as error:
        while camera.read(LATE):
            given += 1
    assert given == error.value.frames > 5
