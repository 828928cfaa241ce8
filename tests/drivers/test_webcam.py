"""Webcams through a fake cv2.VideoCapture that behaves as OpenCV's V4L2 back end does; no real one was at hand."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.camera import Controls, Frame
from drivers.clock import MonotonicClock, VirtualClock
from drivers.errors import CameraError, CameraLost, CameraStalled, NoCamera, SettingRefused, WrongSize
from drivers.live_camera import LiveCamera
from drivers.webcam import webcam

MS = 1_000_000
SIZE = (64, 48)
PERIOD_MS = 10
DECODING_MS = 4
MANUAL, AUTOMATIC = 1, 3


class FakeCapture:
    """A V4L2 camera on a virtual clock: a frame every 10 ms that its driver stamps 2 ms before it arrives.

    Silent after `frames`. `skip` are frames that the driver lost, `again` those that show the one before.
    """

    def __init__(self, clock: VirtualClock, frames: int, *, backend: str = "V4L2") -> None:
        self.clock, self.left, self.backend = clock, frames, backend
        self.released = False
        self.skip: set[int] = set()
        self.again: set[int] = set()
        self.driver_ms: Callable[[float], float] = lambda arrived_ms: arrived_ms - 2
        self.silence: Callable[[], None] = lambda: time.sleep(0.02)
        self.opened_with: tuple[int | str, int, Sequence[int]] | None = None
        self.kept = {
            cv2.CAP_PROP_FRAME_WIDTH: 64.0, cv2.CAP_PROP_FRAME_HEIGHT: 48.0, cv2.CAP_PROP_FPS: 30.0,
            cv2.CAP_PROP_FOURCC: float(cv2.VideoWriter.fourcc(*"YUYV")), cv2.CAP_PROP_AUTO_EXPOSURE: AUTOMATIC,
            cv2.CAP_PROP_EXPOSURE: 156.0, cv2.CAP_PROP_AUTOFOCUS: 1.0, cv2.CAP_PROP_FOCUS: 0.0,
            cv2.CAP_PROP_GAIN: 4.0, cv2.CAP_PROP_AUTO_WB: 1.0, cv2.CAP_PROP_WB_TEMPERATURE: 4600.0,
        }  # fmt: skip
        self.refuses: set[int] = set()
        self._number = -1

    def open(self, source: int | str, backend: int, parameters: Sequence[int]) -> FakeCapture:
        self.opened_with = (source, backend, parameters)
        return self

    def isOpened(self) -> bool:
        return True

    def getBackendName(self) -> str:
        return self.backend

    def set(self, prop: int, value: float) -> bool:
        if prop in self.kept and prop not in self.refuses:
            self.kept[prop] = value
        return prop in self.kept

    def get(self, prop: int) -> float:
        if prop == cv2.CAP_PROP_POS_MSEC:
            return self._stamp_ms
        return self.kept.get(prop, -1.0)

    def grab(self) -> bool:
        if not self.left:
            self.silence()
            return False
        self.left -= 1
        self._number += 1
        periods = 2 if self._number in self.skip else 1
        self.clock.sleep_until_ns((self.clock.now_ns() // (PERIOD_MS * MS) + periods) * PERIOD_MS * MS)
        self._stamp_ms = self.driver_ms(self.clock.now_ns() / MS)
        return True

    def retrieve(self) -> tuple[bool, np.ndarray]:
        self.clock.sleep_until_ns(self.clock.now_ns() + DECODING_MS * MS)
        shows = self._number - (self._number in self.again)
        return True, np.full((SIZE[1], SIZE[0], 3), shows % 256, np.uint8)

    def release(self) -> None:
        self.released = True


class Live:
    """A webcam on a fake capture."""

    def __init__(
        self, frames: int = 8, *, source: int | str = "rtsp://camera", backend: str = "V4L2", **wanted
    ) -> None:
        self.clock = VirtualClock()
        self.capture = FakeCapture(self.clock, frames, backend=backend)
        given = {"size_px": SIZE, "fps": 100.0, "stall_s": 1.0, **wanted}
        self.camera: LiveCamera = webcam(source, clock=self.clock, opener=self.capture.open, **given)

    def frames(self) -> list[Frame]:
        """All that are in the queue once the camera has fallen silent."""
        deadline = time.monotonic() + 5
        while self.capture.left and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(0.02)
        frames: list[Frame] = []
        while frame := self.camera.read(self.clock.now_ns()):
            frames.append(frame)
        return frames


@pytest.fixture
def device(tmp_path: Path) -> Path:
    """A path that stands for a device."""
    path = tmp_path / "video0"
    path.touch()
    return path


@pytest.fixture
def live(device: Path) -> Iterator[Live]:
    live = Live(source=str(device))
    yield live
    live.camera.close()


def camera_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "camera"]


def test_the_drivers_stamp_is_used_where_it_agrees_with_the_arrival(live: Live) -> None:
    live.camera.start()
    frames = live.frames()
    assert len(frames) == 8 and {frame.stamp for frame in frames} == {"driver"}
    for frame in frames:
        assert frame.arrived_ns is not None and frame.arrived_ns % (PERIOD_MS * MS) == 0  # decoding would add 4 ms
        assert frame.t_ns == frame.arrived_ns - 2 * MS


@pytest.mark.parametrize(
    "driver_ms",
    [
        lambda arrived: 0.0,  # none
        lambda arrived: -1.0,
        lambda arrived: 1.7e12 + arrived,  # the wall clock
        lambda arrived: arrived + 1,  # in the future
        lambda arrived: arrived - 1001,  # more than a second old
    ],
)
def test_a_drivers_stamp_of_another_clock_is_not(live: Live, driver_ms: Callable[[float], float]) -> None:
    live.clock.sleep_until_ns(3_600_000 * MS)
    live.capture.driver_ms = driver_ms
    live.camera.start()
    frames = live.frames()
    assert len(frames) == 8 and {frame.stamp for frame in frames} == {"arrival"}
    assert all(frame.t_ns % (PERIOD_MS * MS) == 0 for frame in frames)


def test_other_back_ends_positions_are_no_stamps() -> None:
    live = Live(backend="FFMPEG")
    live.camera.start()
    frame = live.camera.read(3_600_000 * MS)
    assert frame is not None and (frame.stamp, frame.t_ns % (PERIOD_MS * MS)) == ("arrival", 0)
    live.camera.close()


def test_frames_nobody_reads_are_counted(device: Path) -> None:
    live = Live(frames=30, source=str(device))
    live.camera.start()
    frames = live.frames()
    indices = [frame.index for frame in frames]
    assert indices == list(range(30 - len(frames), 30))
    assert live.camera.dropped == 30 - len(frames) > 0
    live.camera.close()


def test_frames_that_the_driver_lost_are_counted_by_its_stamps(live: Live) -> None:
    live.capture.skip = {7}
    live.camera.start()
    frames = live.frames()
    assert [frame.index for frame in frames] == [0, 1, 2, 3, 4, 5, 6, 8]
    assert live.camera.dropped == 1


def test_a_picture_that_comes_again_is_stale_and_not_given(live: Live) -> None:
    live.capture.again = {3, 5}
    live.camera.start()
    assert [int(frame.image[0, 0, 0]) for frame in live.frames()] == [0, 1, 2, 4, 6, 7]
    assert (live.camera.stale, live.camera.dropped) == (2, 0)


def test_a_stamp_that_comes_again_is_stale_whatever_it_shows(live: Live) -> None:
    live.capture.driver_ms = lambda arrived: arrived - arrived % 20
    live.camera.start()
    assert len(live.frames()) == 5 and live.camera.stale == 3  # at 10, 20, 40, 60, 80 ms


def test_a_frozen_camera_has_stalled_and_the_error_says_frozen(device: Path) -> None:
    live = Live(frames=400, source=str(device))
    live.capture.retrieve = lambda: (True, np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
    live.camera.start()
    with pytest.raises(CameraStalled, match=r"no new frame for 1 s, after 1 frames; the same picture came \d+ times"):
        while live.camera.read(3_600_000 * MS):
            pass
    live.camera.close()


def test_a_camera_that_falls_silent_has_stalled(device: Path) -> None:
    live = Live(frames=30, source=str(device))
    live.camera.start()
    count = 0
    with pytest.raises(CameraStalled, match="no new frame for 1 s, after 30 frames"):
        while live.camera.read(3_600_000 * MS):
            count += 1
    assert count + live.camera.dropped == 30
    assert live.clock.now_ns() >= 1300 * MS
    live.camera.close()
    assert live.capture.released


def test_a_camera_may_take_seconds_for_its_first_frame(device: Path) -> None:
    live = Live(frames=0, source=str(device))
    live.capture.silence = lambda: time.sleep(0.001)
    live.camera.start()
    with pytest.raises(CameraStalled, match="no new frame for 5 s, after 0 frames"):
        live.camera.read(3_600_000 * MS)
    assert live.clock.now_ns() >= 5_000 * MS
    live.camera.close()


def test_a_camera_whose_device_vanishes_is_lost(live: Live, device: Path) -> None:
    live.capture.silence = device.unlink
    live.camera.start()
    given = 0
    with pytest.raises(CameraLost, match=r"video0 is gone\nplug it in again"):
        while live.camera.read(3_600_000 * MS):
            given += 1
    assert given == 8
    live.camera.close()
    assert live.capture.released and not camera_threads()


def test_close_does_not_wait_for_a_driver_that_hangs(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.live_camera.CLOSE_S", 0.05)
    hang = threading.Event()
    live.capture.silence = lambda: hang.wait(10) and None
    live.camera.start()
    assert len(live.frames()) == 8
    live.camera.close()
    assert not live.capture.released and len(camera_threads()) == 1
    hang.set()
    camera_threads()[0].join(5)
    assert live.capture.released


def test_a_stream_that_ends_is_lost() -> None:
    live = Live(backend="FFMPEG", source="rtsp://user:secret@camera/stream")
    live.camera.start()
    with pytest.raises(CameraLost, match=r"camera 'rtsp://camera/stream': the stream ended") as error:
        while live.camera.read(3_600_000 * MS):
            pass
    assert "secret" not in str(error.value)
    live.camera.close()
    assert live.capture.opened_with is not None
    _, backend, parameters = live.capture.opened_with
    assert backend == cv2.CAP_FFMPEG and parameters[1] == parameters[3] == 1000  # not OpenCV's 30 s


def test_what_it_is_asked_for_is_read_back(device: Path) -> None:
    wanted = Controls("MJPG", exposure_ms=8.0, focus=30, gain=10, white_balance_k=5000)
    live = Live(source=str(device), controls=wanted)
    live.camera.start()
    settings = live.camera.settings
    assert settings == {
        "source": str(device), "backend": "V4L2", "size_px": "64x48", "fps": 100.0, "pixel_format": "MJPG",
        "exposure_ms": 8.0, "exposure_locked": True, "focus": 30, "focus_locked": True, "gain": 10,
        "white_balance_k": 5000, "white_balance_locked": True,
    }  # fmt: skip
    assert live.capture.opened_with == (str(device), cv2.CAP_V4L2, [])
    live.camera.close()


def test_what_it_is_not_asked_for_is_left_and_told(live: Live) -> None:
    live.camera.start()
    settings = live.camera.settings
    assert (settings["exposure_locked"], settings["focus_locked"]) == (False, False)
    assert (settings["exposure_ms"], settings["pixel_format"]) == (15.6, "YUYV")


def test_a_camera_comes_as_it_is_where_nothing_is_asked(device: Path) -> None:
    live = Live(source=str(device), size_px=None, fps=None)
    with pytest.raises(CameraError, match=r"isn't known before start"):
        _ = live.camera.size_px
    live.camera.start()
    assert (live.camera.size_px, live.camera.fps) == (SIZE, 30.0)
    live.camera.close()


@pytest.mark.parametrize(
    ("controls", "refuses", "says"),
    [
        (Controls("MJPG"), cv2.CAP_PROP_FOURCC, r"sends its pixels as YUYV; want pixel_format MJPG"),
        (Controls(exposure_ms=8), cv2.CAP_PROP_EXPOSURE, r"keeps exposure_ms = 15\.6; want 8"),
        (Controls(exposure_ms=15.6), cv2.CAP_PROP_AUTO_EXPOSURE, r"its exposure stays automatic"),
        (Controls(focus=30), cv2.CAP_PROP_AUTOFOCUS, r"its focus by itself can't be switched off"),
        (Controls(focus=30), cv2.CAP_PROP_FOCUS, r"keeps focus = 0; want 30"),
        (Controls(gain=9), cv2.CAP_PROP_GAIN, r"keeps gain = 4; want 9"),
        (Controls(white_balance_k=5000), cv2.CAP_PROP_WB_TEMPERATURE, r"keeps white_balance_k = 4600; want 5000"),
    ],
)
def test_a_setting_that_it_does_not_keep_is_an_error(device: Path, controls: Controls, refuses: int, says: str) -> None:
    live = Live(source=str(device), controls=controls)
    live.capture.refuses = {refuses}
    with pytest.raises(SettingRefused, match=says):
        live.camera.start()
    assert live.capture.released and not camera_threads()


def test_a_control_that_it_has_not_is_an_error(device: Path) -> None:
    live = Live(source=str(device), controls=Controls(gain=9))
    del live.capture.kept[cv2.CAP_PROP_GAIN]
    with pytest.raises(SettingRefused, match=r"has no control for gain; leave it out of the rig"):
        live.camera.start()


def test_an_exposure_in_the_sensors_own_steps_is_near_enough(device: Path) -> None:
    live = Live(source=str(device), controls=Controls(exposure_ms=8))
    live.capture.refuses = {cv2.CAP_PROP_EXPOSURE}
    live.capture.kept[cv2.CAP_PROP_EXPOSURE] = 78.0
    live.camera.start()
    assert live.camera.settings["exposure_ms"] == 7.8
    live.camera.close()


def test_controls_are_for_v4l2(device: Path) -> None:
    live = Live(source=str(device), controls=Controls(gain=9), backend="MSMF")
    with pytest.raises(SettingRefused, match=r"through V4L2 only; OpenCV opened it by MSMF"):
        live.camera.start()


def test_another_size_is_refused(device: Path) -> None:
    live = Live(source=str(device), size_px=(640, 480))
    live.capture.refuses = {cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT}
    with pytest.raises(WrongSize, match="gives 64x48 px; want 640x480"):
        live.camera.start()
    assert live.capture.released and not camera_threads()


def test_a_frame_of_another_size_on_the_way_is_an_error(live: Live) -> None:
    good = live.capture.retrieve
    live.capture.retrieve = lambda: good() if live.capture.left >= 4 else (True, np.zeros((24, 32, 3), np.uint8))
    live.camera.start()
    with pytest.raises(WrongSize, match=r"frame 4: it gives 32x24 px; want 64x48"):
        while live.camera.read(3_600_000 * MS):
            pass


def test_a_frame_that_cannot_be_decoded_is_counted(device: Path) -> None:
    live = Live(source=str(device))
    good = live.capture.retrieve
    live.capture.retrieve = lambda: (False, np.zeros(0)) if live.capture.left % 2 else good()
    live.camera.start()
    assert [frame.index for frame in live.frames()] == [1, 3, 5, 7]
    assert live.camera.dropped == 4
    live.camera.close()


def test_close_ends_the_thread_and_a_camera_starts_again(device: Path) -> None:
    live = Live(source=str(device))
    live.camera.close()
    for _ in range(2):
        live.capture.left = 3
        live.camera.start()
        first = live.camera.read(3_600_000 * MS)
        assert first is not None and first.index == 0
        live.camera.close()
        assert not camera_threads()
    with pytest.raises(CameraError, match=r"call start\(\)"):
        live.camera.read(0)


@pytest.mark.parametrize("source", [97, "/dev/video97"])
def test_a_missing_camera_is_one_error_and_no_chatter(source: int | str, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(NoCamera, match=r"there is no .*video97.*this machine has"):
        webcam(source, size_px=SIZE, fps=30.0, clock=MonotonicClock()).start()
    assert capfd.readouterr() == ("", "")
    assert not camera_threads()


def test_a_device_that_cannot_be_opened_is_no_camera(device: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(NoCamera, match=r"video0' can't be opened; another program may hold it"):
        webcam(str(device), size_px=SIZE, fps=30.0, clock=MonotonicClock()).start()
    assert capfd.readouterr() == ("", "")
