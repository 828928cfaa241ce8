"""Whatever ends a capture, the emulated servos' own registers say that the arm was left as the rig declares."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
import pytest

from drivers.camera import Camera, Frame
from drivers.clock import Clock
from drivers.errors import CameraLost, CameraStalled, NoCamera
from station.capture.by_hand import HandCapture, take_in_hand
from station.capture.control import Control, Wish
from station.capture.service import Capture
from station.capture.snapshot import Snapshot
from station.capture.states import State
from station.commands import planning
from station.perception.marker_tracker import MarkerTracker
from tests.test_safe_states import ON_BOTH, Events, Lab, lab

QUIET = "noise@100"
AT_S = 3.0
PERIOD_NS = 33_333_333


class GreyCamera:
    """Frames without a marker; goes away for some seconds of the clock, and comes back if it is started then."""

    size_px, fps, dropped, stale = (64, 48), 30.0, 0, 0
    settings = MappingProxyType({})

    def __init__(self, clock: Clock, away_s: tuple[float, float] = (np.inf, np.inf)) -> None:
        self._clock, self._away_s = clock, away_s
        self._index, self._first_ns = 0, clock.now_ns()
        self._started = True

    def _is_away(self) -> bool:
        return self._away_s[0] <= self._clock.now_ns() * 1e-9 < self._away_s[1]

    def start(self) -> None:
        if self._is_away():
            raise NoCamera("camera 0 isn't there")
        self._started, self._index, self._first_ns = True, 0, self._clock.now_ns()

    def read(self, until_ns: int) -> Frame | None:
        due_ns = self._first_ns + (self._index + 1) * PERIOD_NS
        self._clock.sleep_until_ns(min(due_ns, until_ns))
        self._started = self._started and not self._is_away()
        if not self._started:
            raise CameraLost("camera 0 vanished")
        if due_ns > until_ns:
            return None
        self._index += 1
        return Frame(self._index - 1, due_ns, np.zeros((48, 64, 3), np.uint8))

    def close(self) -> None: ...


class FramesToo(Events):
    """Keeps the frames' numbers and stamps, too."""

    def __init__(self) -> None:
        super().__init__()
        self.frames: list[tuple[int, int]] = []

    def log_frame(self, index: int, t_ns: int, image: object, markers: object) -> None:
        self.frames.append((index, t_ns))


def with_frames(bench: Lab, camera: Any, reconnect_s: float = 0.0) -> FramesToo:
    table = bench.rig.table
    of_camera = table.camera.model_copy(update={"reconnect_s": reconnect_s})
    bench.rig = replace(bench.rig, camera=cast(Camera, camera), table=table.model_copy(update={"camera": of_camera}))
    bench.writer = FramesToo()
    return bench.writer


def capture(bench: Lab, **more: Any) -> None:
    Capture(bench.rig, planning.plan(*bench.files), cast(Any, bench.writer), **more).run()


def raising(error: BaseException) -> Callable[[float, float], None]:
    def progress(done_s: float, total_s: float) -> None:
        if done_s >= AT_S:
            raise error

    return progress


def interrupted(bench: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    capture(bench, progress=raising(KeyboardInterrupt()))


def terminated(bench: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    capture(bench, progress=raising(SystemExit(143)))


def progress_broken(bench: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    capture(bench, progress=raising(KeyError("progress")))


def watcher_broken(bench: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    def watch(shot: Snapshot) -> None:
        if shot.done_s >= AT_S:
            raise KeyError("watch")

    capture(bench, watch=watch)


def detection_broken(bench: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    def detect(self: MarkerTracker, image: object) -> object:
        raise ZeroDivisionError("detection")

    with_frames(bench, GreyCamera(bench.rig.clock))
    monkeypatch.setattr(MarkerTracker, "detect", detect)
    capture(bench)


def recorder_broken(bench: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = with_frames(bench, GreyCamera(bench.rig.clock))

    def full(*frame: object) -> None:
        if len(writer.frames) > 60:
            raise OSError("No space left on device")
        writer.frames.append((0, 0))

    monkeypatch.setattr(writer, "log_frame", full)
    capture(bench)


def camera_gone(bench: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    with_frames(bench, GreyCamera(bench.rig.clock, (AT_S, np.inf)))
    capture(bench)


def camera_gone_for_good(bench: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    with_frames(bench, GreyCamera(bench.rig.clock, (AT_S, np.inf)), reconnect_s=3.0)
    capture(bench)


ENDS: dict[Callable[[Lab, pytest.MonkeyPatch], None], type[BaseException]] = {
    interrupted: KeyboardInterrupt,
    terminated: SystemExit,
    progress_broken: KeyError,
    watcher_broken: KeyError,
    detection_broken: ZeroDivisionError,
    recorder_broken: OSError,
    camera_gone: CameraStalled,
    camera_gone_for_good: CameraStalled,
}


@ON_BOTH
@pytest.mark.parametrize("end", ENDS, ids=lambda end: end.__name__)
@pytest.mark.parametrize("at_exit", ["park-then-release", "hold", "release"])
def test_every_end_leaves_the_arm_as_declared(
    tmp_path: Path, name: str, end: Any, at_exit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with lab(tmp_path, name, QUIET, at_exit=at_exit) as bench:
        with pytest.raises(ENDS[end]):
            end(bench, monkeypatch)
        assert bench.writer.state == "interrupted"
        if end is not recorder_broken:  # which takes nothing more
            assert f"INFO arm left: {at_exit}" in bench.writer.events
        left_deg = bench.joint_deg()
        if at_exit == "hold":
            assert all(bench.each("torque_enable")) and (end is detection_broken or left_deg > 5.0)
        else:
            assert not any(bench.each("torque_enable"))
        assert at_exit != "park-then-release" or abs(left_deg) < 2.5
        bench.pass_s(3.0)
        assert bench.joint_deg() == pytest.approx(left_deg, abs=1.0)
        if name != "demo":
            assert not any(bench.each("bus_watchdog"))


@ON_BOTH
def test_signals_while_the_arm_is_being_left_do_not_break_that_off(tmp_path: Path, name: str) -> None:
    with lab(tmp_path, name, QUIET) as bench:
        sent: list[float] = []

        def watch(shot: Snapshot) -> None:
            if shot.state == State.PARKING and len(sent) < 3:
                sent.append(bench.joint_deg())
                os.kill(os.getpid(), signal.SIGINT)

        with pytest.raises(KeyboardInterrupt):
            capture(bench, progress=raising(KeyboardInterrupt()), watch=watch)
        assert len(sent) == 3 and sent[0] > 5.0
        assert abs(bench.joint_deg()) < 2.5 and not any(bench.each("torque_enable"))
        assert bench.writer.state == "interrupted" and bench.writer.events[-1] == "INFO arm left: park-then-release"


@ON_BOTH
def test_a_bus_that_is_away_for_a_moment_while_the_arm_is_parked_is_waited_for(tmp_path: Path, name: str) -> None:
    """Parking from 40 deg takes some 2 s; it begins 8 s after the motion."""
    with lab(tmp_path, name, "unplug@9+2", more="reconnect_s = 20") as bench:
        with pytest.raises(Exception, match=r"is gone|isn't open"):
            capture(bench)
        assert not any(bench.each("torque_enable"))
        assert bench.writer.state == "interrupted"


@ON_BOTH
def test_a_camera_that_comes_back_is_waited_for_and_the_leg_is_done_again(tmp_path: Path, name: str) -> None:
    with lab(tmp_path, name, QUIET) as bench:
        writer = with_frames(bench, GreyCamera(bench.rig.clock, (AT_S, AT_S + 2.0)), reconnect_s=20.0)
        held: list[float] = []

        def watch(shot: Snapshot) -> None:
            if shot.state == State.HOLDING:
                held.append(bench.joint_deg())

        capture(bench, watch=watch)
        assert writer.state == "complete" and writer.counts["reconnects"] == 1
        assert len(held) > 5 and np.ptp(held[1:]) < 1.0 and held[-1] > 5.0
        index, t_ns = np.array(writer.frames).T
        assert np.all(np.diff(index) > 0) and np.all(np.diff(t_ns) > 0)
        gone_from_s, back_s = writer.at_s("waiting 20 s for it"), writer.at_s("leg 1 of 1 again")
        between = (t_ns * 1e-9 > gone_from_s + 0.1) & (t_ns * 1e-9 < back_s)
        assert not between.any()  # nothing is recorded while the arm is held and goes back
        assert writer.at_s("motion done") - back_s == pytest.approx(8.0, abs=0.1)
        assert writer.counts["frames_outside"] > 0


@pytest.fixture
def by_hand(tmp_path: Path) -> Iterator[Callable[[str], Any]]:
    stack: list[Any] = []

    def opened(fault: str) -> Lab:
        held = lab(tmp_path, "demo", fault, more="reconnect_s = 20")
        stack.append(held)
        bench = held.__enter__()
        take_in_hand(bench.rig, lambda text: None)
        return bench

    yield opened
    for held in stack:
        held.__exit__(None, None, None)


def test_by_hand_frames_go_on_while_the_bus_is_away(by_hand: Callable[[str], Lab]) -> None:
    bench = by_hand("unplug@2+2")
    writer = with_frames(bench, GreyCamera(bench.rig.clock))
    HandCapture(bench.rig, cast(Any, writer), duration_s=8.0).run()
    assert writer.state == "complete" and writer.counts["reconnects"] == 1
    assert 230 <= writer.counts["frames"] <= 241 and 200 < writer.counts["readings"] < 340
    assert not any(bench.each("torque_enable"))


def test_by_hand_readings_go_on_while_the_camera_is_away(by_hand: Callable[[str], Lab]) -> None:
    bench = by_hand(QUIET)
    writer = with_frames(bench, GreyCamera(bench.rig.clock, (2.0, 4.0)), reconnect_s=20.0)
    HandCapture(bench.rig, cast(Any, writer), duration_s=8.0).run()
    assert writer.state == "complete" and 395 < writer.counts["readings"] < 405
    assert 150 < writer.counts["frames"] < 200 and any("the camera is back" in event for event in writer.events)


def test_by_hand_a_bus_that_goes_away_in_a_pause_is_waited_for(by_hand: Callable[[str], Lab]) -> None:
    bench = by_hand("unplug@2+2")
    # As on a real clock: the servos are read during a pause, too.
    bench.rig = replace(bench.rig, virtual=False)
    writer, control = with_frames(bench, GreyCamera(bench.rig.clock)), Control()

    def progress(done_s: float, total_s: float) -> None:
        if done_s >= 1.0 and not any("paused" in event for event in writer.events):
            control.pause()

    def watch(shot: Snapshot) -> None:
        if shot.state == State.PAUSED and shot.t_s > 6.0:
            control.resume()

    HandCapture(bench.rig, cast(Any, writer), duration_s=3.0, progress=progress, control=control, watch=watch).run()
    assert writer.state == "complete" and writer.counts["reconnects"] == 1 and writer.counts["pauses"] == 1
    t_s = np.array(writer.frames)[:, 1] * 1e-9
    assert not np.any((t_s > writer.at_s("state: paused") + 0.1) & (t_s < writer.at_s("paused for")))
    assert not any(bench.each("torque_enable"))


class Fleeting(Control):
    """A pause that is taken back before the servo loop gets to it: seen once."""

    def __init__(self) -> None:
        super().__init__()
        self.due = False

    @property
    def wish(self) -> Wish:
        asked, self.due = self.due, False
        return Wish.PAUSE if asked else super().wish


def test_nothing_is_recorded_on_the_way_back_after_a_pause_that_was_taken_back_at_once(tmp_path: Path) -> None:
    with lab(tmp_path, "demo", QUIET) as bench:
        writer, control = with_frames(bench, GreyCamera(bench.rig.clock)), Fleeting()
        asked_s: list[float] = []

        def progress(done_s: float, total_s: float) -> None:
            if done_s >= 4.0 and not asked_s:
                asked_s.append(bench.rig.clock.now_ns() * 1e-9)
                control.due = True

        capture(bench, control=control, progress=progress)
        t_s = np.array(writer.frames)[:, 1] * 1e-9
        again_s = writer.at_s("leg 1 of 1 again")
        assert again_s > asked_s[0] + 1.0 and writer.state == "complete"
        assert not np.any((t_s > asked_s[0] + 0.1) & (t_s < again_s))


class TwiceCamera(GreyCamera):
    """Gives each tenth picture twice, with one stamp, as a network camera on a busy machine does."""

    def __init__(self, clock: Clock) -> None:
        super().__init__(clock)
        self._given = 0
        self._again: Frame | None = None

    def read(self, until_ns: int) -> Frame | None:
        if (again := self._again) is not None:
            self._again = None
        elif (again := super().read(until_ns)) is not None and again.index % 10 == 9:
            self._again = again
        if again is None:
            return None
        self._given += 1
        return replace(again, index=self._given - 1)


def test_of_two_frames_with_one_stamp_the_second_counts_as_dropped(tmp_path: Path) -> None:
    with lab(tmp_path, "demo", QUIET) as bench:
        writer = with_frames(bench, TwiceCamera(bench.rig.clock))
        capture(bench)
        assert np.all(np.diff(np.array(writer.frames)[:, 1]) > 0)
        assert writer.counts["dropped_by_camera"] == pytest.approx(writer.counts["frames"] / 10, abs=1)


class LateCamera(GreyCamera):
    """Hands a picture over 0.2 s after it was taken."""

    def read(self, until_ns: int) -> Frame | None:
        frame = super().read(until_ns)
        return None if frame is None else replace(frame, t_ns=frame.t_ns - 200_000_000)


def test_a_frame_that_was_taken_before_the_motion_is_not_recorded_however_late_it_comes(tmp_path: Path) -> None:
    with lab(tmp_path, "demo", QUIET) as bench:
        writer = with_frames(bench, LateCamera(bench.rig.clock))
        capture(bench)
        assert writer.frames[0][1] * 1e-9 >= writer.at_s("starts: ")


@pytest.mark.parametrize("hand", [False, True], ids=["planned", "by hand"])
def test_a_capture_that_fails_as_it_begins_says_so_and_how_the_arm_was_left(tmp_path: Path, hand: bool) -> None:
    class Untellable(GreyCamera):
        settings: Any = MappingProxyType({"exposure": object()})

    with lab(tmp_path, "demo", QUIET) as bench:
        writer = with_frames(bench, Untellable(bench.rig.clock))
        with pytest.raises(TypeError, match="JSON"):
            if hand:
                HandCapture(bench.rig, cast(Any, writer), duration_s=1.0).run()
            else:
                capture(bench)
        assert "INFO state: fault" in writer.events and writer.events[-1].startswith("INFO arm left: ")
        assert writer.state == "interrupted"
