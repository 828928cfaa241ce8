"""Captures on the emulated arm and the rendered camera, through the same code as on real ones."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from drivers.camera import Frame
from drivers.errors import ArmFault, BusLost, CameraStalled
from station.capture.counts import CaptureCounts
from station.capture.service import Capture
from station.commands import capturing, planning
from station.errors import LimitExceeded, OutputExists
from station.recording import Recording
from station.rig import Rig, load_rig, open_rig
from station.session import read_status
from tests.sessions import SHORT, capture_short, write_motion


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CaptureCounts]:
    return capture_short(tmp_path_factory.mktemp("short"), seed=1)


def test_a_session_is_complete_and_its_counts_are_those_of_the_recording(short: tuple[Path, CaptureCounts]):
    folder, counts = short
    recording = Recording.load(folder)
    assert read_status(folder).state == "complete"
    assert counts.frames == recording.frames and counts.dropped_frames == 0 and counts.bus_errors == 0
    assert counts.readings == len(recording.measured.t_s) and counts.commands == 3
    assert (folder / "motion.toml").read_text(encoding="utf-8") == SHORT
    assert json.loads((folder / "session.json").read_text(encoding="utf-8"))["counts"]["frames"] == counts.frames


def test_each_step_of_the_packaged_motion_sets_its_own_speed(tmp_path: Path):
    """Starts of steps fall between nanoseconds; none may be taken for the step before it."""
    planned_demo = planning.plan("demo", "demo")
    rounded = np.round(planned_demo.command_times_s() * 1e9) * 1e-9
    assert np.any(rounded < planned_demo.command_times_s())  # or this shows nothing
    writer = Writer()
    with demo_rig() as rig:
        capture = Capture(with_camera(rig, NoFrames(rig)), planned_demo, writer)
        capture.run()
    steps = [event for event in writer.events if event.startswith("INFO step")]
    assert steps == [f"INFO step {number}" for number in range(1, 16)]


def test_the_servos_speed_limit_shapes_the_steps(short: tuple[Path, CaptureCounts]):
    recording = Recording.load(short[0])
    pan = np.degrees(recording.measured.state("base_pan"))
    speed = np.abs(np.diff(pan) / np.diff(recording.measured.t_s))
    assert set(np.degrees(np.unique(recording.commanded.state("base_pan"))).round(6)) == {-10.0, 0.0, 30.0}
    # A count of 0.29 deg in a turn of 20 ms is 15 deg/s.
    assert 40 < np.median(speed[speed > 20]) < 60
    assert abs(pan.max() - 30) < 0.5 and abs(pan[-1]) < 1.0


def test_the_same_seed_gives_the_same_session_to_the_bit(short: tuple[Path, CaptureCounts], tmp_path: Path):
    first = Recording.load(short[0])
    again = Recording.load(capture_short(tmp_path, seed=1)[0])
    np.testing.assert_array_equal(first.measured.q, again.measured.q)
    np.testing.assert_array_equal(first.stamps_ns, again.stamps_ns)
    np.testing.assert_array_equal(first.frame_ns, again.frame_ns)
    np.testing.assert_array_equal(first.observations.corners_px, again.observations.corners_px)


def test_another_seed_moves_the_plates(short: tuple[Path, CaptureCounts], tmp_path: Path):
    first = Recording.load(short[0]).observations
    other = Recording.load(capture_short(tmp_path, seed=2)[0]).observations
    a, b = (log.corners_px[log.marker_id == 0][0] for log in (first, other))
    assert np.abs(a - b).max() > 0.5


def test_frames_are_timed_evenly_and_stamped_at_arrival(short: tuple[Path, CaptureCounts]):
    steps = np.diff(Recording.load(short[0]).frame_ns)
    assert np.all(np.abs(steps - 1e9 / 30) <= 1)


def test_nothing_is_made_when_the_motion_leaves_the_limits_or_the_folder_is_taken(tmp_path: Path):
    far = write_motion(tmp_path, SHORT.replace("base_pan = 30", "base_pan = 130"))
    with pytest.raises(LimitExceeded, match=r"base_pan would go to 130\.0 deg"):
        capturing.capture("demo", far, tmp_path / "far")
    assert not (tmp_path / "far").exists()
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(OutputExists, match=r"taken exists and isn't empty"):
        capturing.capture("demo", write_motion(tmp_path), taken)
    assert [path.name for path in taken.iterdir()] == ["notes.txt"]


class Writer:
    """Takes what a capture records, in place of a file."""

    def __init__(self) -> None:
        self.events: list[str] = []
        self.state = ""
        self.frame_threads: set[str] = set()

    def log_command(self, t_ns: int, q_rad: np.ndarray) -> None: ...

    def log_reading(self, *stamps_and_states: object) -> None: ...

    def log_servos(self, t_ns: int, states: object) -> None: ...

    def checkpoint(self, leg: int, legs: int, counts: object, motion: object = None) -> None: ...

    def log_frame(self, *args: object, **kwargs: object) -> None:
        self.frame_threads.add(threading.current_thread().name)

    def log_event(self, t_ns: int, level: str, text: str) -> None:
        self.events.append(f"{level} {text}")

    def close(self, state: str, counts: dict[str, int]) -> None:
        self.state = state


@contextmanager
def demo_rig() -> Iterator[Rig]:
    with open_rig(load_rig("demo"), seed=0) as rig:
        yield rig


def planned(tmp_path: Path):
    return planning.plan("demo", write_motion(tmp_path))


class NoFrames:
    """A camera that never has a frame."""

    size_px, fps, dropped, stale = (640, 480), 30.0, 0, 0
    settings = MappingProxyType({})

    def __init__(self, rig: Rig) -> None:
        self._clock = rig.clock

    def read(self, until_ns: int) -> Frame | None:
        self._clock.sleep_until_ns(until_ns)
        return None


class FailingCamera:
    """A camera that stalls after some frames."""

    size_px, fps, dropped, stale = (640, 480), 30.0, 0, 0
    settings = MappingProxyType({})

    def __init__(self, camera, after: int) -> None:
        self._camera, self._left = camera, after

    def read(self, until_ns: int) -> Frame | None:
        frame = self._camera.read(until_ns)
        self._left -= frame is not None
        if self._left < 0:
            raise CameraStalled("camera 0: no frame for 2 s")
        return frame


def with_camera(rig: Rig, camera) -> Rig:
    return replace(rig, camera=camera)


def test_a_failure_in_mid_motion_parks_and_releases_the_arm(tmp_path: Path):
    writer = Writer()
    with demo_rig() as rig:
        failing = with_camera(rig, FailingCamera(rig.camera, after=20))
        with pytest.raises(CameraStalled):
            Capture(failing, planned(tmp_path), writer).run()
        assert np.abs(np.degrees(rig.arm.read().q)).max() < 2.5  # parked
    assert writer.state == "interrupted"
    assert writer.events[-1] == "INFO arm left: park-then-release"
    assert "ERROR camera 0: no frame for 2 s" in writer.events


def test_an_interrupt_parks_and_closes_the_recording_as_interrupted(tmp_path: Path):
    writer = Writer()

    def stop(done_s: float, total_s: float) -> None:
        if done_s > 0.5:
            raise KeyboardInterrupt

    with demo_rig() as rig, pytest.raises(KeyboardInterrupt):
        Capture(rig, planned(tmp_path), writer, stop).run()
    assert writer.state == "interrupted" and "INFO arm left: park-then-release" in writer.events


def test_an_arm_that_cannot_be_parked_is_said_and_the_first_error_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    writer = Writer()
    with demo_rig() as rig:
        camera = FailingCamera(rig.camera, after=5)

        def lost(*args: object) -> None:
            raise BusLost("the port is gone")

        original = camera.read

        def read(until_ns: int) -> Frame | None:
            try:
                return original(until_ns)
            except CameraStalled:
                monkeypatch.setattr(rig.arm, "command", lost)
                monkeypatch.setattr(rig.arm, "torque_off", lost)
                raise

        monkeypatch.setattr(camera, "read", read)
        with pytest.raises(CameraStalled):
            Capture(with_camera(rig, camera), planned(tmp_path), writer).run()
    assert any("the port is gone" in event for event in writer.events)


def test_a_blocked_approach_is_a_fault_with_the_joints_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    writer = Writer()
    with demo_rig() as rig:
        plan = planned(tmp_path)
        rig.arm.connect()
        still = rig.arm.read()
        monkeypatch.setattr(rig.arm, "command", lambda goal: rig.clock.now_ns())
        stuck = replace(still, q=np.array([0.0, 0.3, 0.0, 0.0]))
        monkeypatch.setattr(rig.arm, "read", lambda: stuck)
        with pytest.raises(ArmFault, match=r"shoulder is 17\.2 deg from its goal"):
            Capture(rig, plan, writer).run()
    assert writer.state == "interrupted"


def test_a_failure_of_the_frame_thread_reaches_the_caller(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    writer = Writer()

    def full(*args: object, **kwargs: object) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr(writer, "log_frame", full)
    with demo_rig() as rig, pytest.raises(OSError, match="No space left"):
        Capture(rig, planned(tmp_path), writer).run()
    assert writer.state == "interrupted"
