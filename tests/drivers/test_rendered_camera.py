"""RenderedCamera: the times of a real camera, exact on a virtual clock and kept on the real one."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import Frame
from drivers.clock import MonotonicClock, VirtualClock
from drivers.errors import CameraError
from drivers.rendered_camera import RenderedCamera

MS = 1_000_000
SIZE = (8, 6)


class Scene:
    """Renders flat frames, remembers what it was asked, and takes its time."""

    def __init__(self, takes_s: float = 0.0) -> None:
        self.asked: list[tuple[int, int]] = []
        self.takes_s = takes_s

    def __call__(self, t_ns: int, index: int) -> np.ndarray:
        self.asked.append((t_ns, index))
        time.sleep(self.takes_s)
        return np.full((SIZE[1], SIZE[0], 3), index % 256, np.uint8)


def virtual(scene: Scene, clock: VirtualClock, fps: float = 50.0) -> RenderedCamera:
    """20 ms a frame, 8 ms of exposure, 5 ms of latency: frame k arrives at start + 20 k + 13 ms."""
    camera = RenderedCamera(
        scene, size_px=SIZE, fps=fps, exposure_s=0.008, latency_s=0.005, clock=clock, realtime=False
    )
    camera.start()
    return camera


def real(scene: Scene, fps: float = 100.0, latency_s: float = 0.002) -> RenderedCamera:
    return RenderedCamera(
        scene, size_px=SIZE, fps=fps, exposure_s=0.004, latency_s=latency_s, clock=MonotonicClock(), realtime=True
    )


def soon() -> int:
    return time.monotonic_ns() + 5_000 * MS


def read_frames(camera: RenderedCamera, count: int) -> list[Frame]:
    frames = [camera.read(soon()) for _ in range(count)]
    assert all(frame is not None for frame in frames)
    return [frame for frame in frames if frame is not None]


def camera_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "rendered camera"]


def test_frames_show_mid_exposure_and_are_stamped_at_arrival() -> None:
    scene, clock = Scene(), VirtualClock(start_ns=100 * MS)
    camera = virtual(scene, clock)
    for k in range(3):
        frame = camera.read(10_000 * MS)
        assert frame is not None
        assert (frame.index, frame.t_ns) == (k, (100 + 20 * k + 13) * MS)
        assert clock.now_ns() == frame.t_ns
        assert frame.image[0, 0, 0] == k
    assert scene.asked == [((100 + 20 * k + 4) * MS, k) for k in range(3)]
    assert camera.dropped == 0


def test_no_frame_before_until_leaves_the_clock_at_until() -> None:
    scene, clock = Scene(), VirtualClock()
    camera = virtual(scene, clock)
    assert camera.read(13 * MS - 1) is None
    assert clock.now_ns() == 13 * MS - 1
    assert scene.asked == []
    frame = camera.read(13 * MS)
    assert frame is not None and clock.now_ns() == 13 * MS
    assert camera.read(20 * MS) is None
    assert clock.now_ns() == 20 * MS


def test_a_busy_caller_gets_every_frame_with_its_own_stamp() -> None:
    scene, clock = Scene(), VirtualClock()
    camera = virtual(scene, clock)
    clock.sleep_until_ns(60 * MS)
    frames = [camera.read(60 * MS) for _ in range(4)]
    assert [frame and frame.t_ns for frame in frames] == [13 * MS, 33 * MS, 53 * MS, None]
    assert clock.now_ns() == 60 * MS
    assert camera.dropped == 0


@given(waits=st.lists(st.integers(0, 50 * MS), max_size=20))
def test_frames_do_not_depend_on_how_often_one_asks(waits: list[int]) -> None:
    clock = VirtualClock()
    camera = virtual(Scene(), clock, fps=30.0)
    stamps: list[int] = []
    for wait in waits:
        until_ns = clock.now_ns() + wait
        while frame := camera.read(until_ns):
            stamps.append(frame.t_ns)
        assert clock.now_ns() == until_ns
    assert stamps == [round(k * 1e9 / 30) + 13 * MS for k in range(len(stamps))]
    assert len(stamps) == sum(round(k * 1e9 / 30) + 13 * MS <= clock.now_ns() for k in range(100))


def test_an_image_of_another_size_is_refused() -> None:
    camera = RenderedCamera(
        Scene(), size_px=(9, 6), fps=50.0, exposure_s=0.0, latency_s=0.0, clock=VirtualClock(), realtime=False
    )
    camera.start()
    with pytest.raises(CameraError, match=r"frame 0 has \(8, 6\) px; want \(9, 6\)"):
        camera.read(MS)


def test_reading_before_start_says_so() -> None:
    with pytest.raises(CameraError, match=r"call start\(\)"):
        real(Scene()).read(soon())


@pytest.mark.parametrize(
    ("fps", "exposure_s", "readout_s", "latency_s"),
    [
        (0.0, 0.0, 0.0, 0.0),
        (30.0, 0.04, 0.0, 0.0),
        (30.0, 0.01, 0.04, 0.0),
        (30, 0.01, -0.01, 0),
        (30, 0.01, 0, -1),
    ],
)
def test_times_that_make_no_camera_are_refused(
    fps: float, exposure_s: float, readout_s: float, latency_s: float
) -> None:
    with pytest.raises(CameraError, match="exposure 0 to 1 / fps"):
        RenderedCamera(
            Scene(), size_px=SIZE, fps=fps, exposure_s=exposure_s, readout_s=readout_s, latency_s=latency_s,
            clock=VirtualClock(), realtime=False,
        )  # fmt: skip


def test_a_rolling_shutter_is_read_out_before_the_frame_comes() -> None:
    scene, clock = Scene(), VirtualClock()
    camera = RenderedCamera(
        scene, size_px=SIZE, fps=20.0, exposure_s=0.008, readout_s=0.02, latency_s=0.005, clock=clock, realtime=False
    )
    camera.start()
    frames = read_frames(camera, 2)
    assert [frame.t_ns for frame in frames] == [33 * MS, 83 * MS]
    assert scene.asked == [(14 * MS, 0), (64 * MS, 1)]  # the middle of the middle row's exposure


def test_in_real_time_frames_come_when_they_arrive() -> None:
    camera = real(Scene())
    camera.start()
    last_ns = None
    for frame in read_frames(camera, 5):
        assert time.monotonic_ns() >= frame.t_ns
        if last_ns is not None:
            assert (frame.t_ns - last_ns) % (10 * MS) == 0
        last_ns = frame.t_ns
    camera.close()
    assert not camera_threads()


def test_in_real_time_a_read_ends_at_until() -> None:
    camera = real(Scene(), fps=2.0, latency_s=0.2)
    camera.start()
    for wait_ms in (20, 60):  # before the frame is rendered, and between rendering and arrival
        until_ns = time.monotonic_ns() + wait_ms * MS
        assert camera.read(until_ns) is None
        assert time.monotonic_ns() >= until_ns
    frame = camera.read(soon())
    assert frame is not None and frame.index == 0
    assert time.monotonic_ns() >= frame.t_ns
    camera.close()


def test_rendering_that_falls_behind_drops_frames_and_counts_them() -> None:
    camera = real(Scene(takes_s=0.035))
    camera.start()
    frames = read_frames(camera, 4)
    camera.close()
    assert not camera_threads()
    lost = frames[-1].index + 1 - len(frames)
    assert lost >= 6  # 35 ms of rendering at 10 ms a frame: two or three of every four or so
    assert camera.dropped >= lost


def test_latency_longer_than_a_frame_drops_nothing() -> None:
    camera = real(Scene(), fps=10.0, latency_s=0.25)
    camera.start()
    frames = read_frames(camera, 3)
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert [frame.t_ns - frames[0].t_ns for frame in frames] == [0, 100 * MS, 200 * MS]
    assert camera.dropped == 0
    camera.close()


def test_an_error_while_rendering_reaches_the_reader() -> None:
    def broken(t_ns: int, index: int) -> np.ndarray:
        raise ValueError("no scene")

    camera = RenderedCamera(
        broken, size_px=SIZE, fps=100.0, exposure_s=0.0, latency_s=0.0, clock=MonotonicClock(), realtime=True
    )
    camera.start()
    with pytest.raises(ValueError, match="no scene"):
        camera.read(soon())
    camera.close()
    assert not camera_threads()
