"""Pause, go on, stop: what people ask of a running capture, and what those who watch are told."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
import pytest

from station.capture.by_hand import HandCapture, take_in_hand
from station.capture.control import Control, Wish
from station.capture.service import Capture
from station.capture.snapshot import Snapshot
from station.capture.states import State
from station.commands import planning
from tests.test_safe_states import ON_BOTH, Lab, lab

QUIET = "noise@100"


def captured(bench: Lab, control: Control, **more: Any) -> None:
    Capture(bench.rig, planning.plan(*bench.files), cast(Any, bench.writer), control=control, **more).run()


def states_of(bench: Lab) -> list[str]:
    return [event.removeprefix("INFO state: ") for event in bench.writer.events if event.startswith("INFO state: ")]


class Pauses:
    """Asks for a pause at a time of the motion, once; while it lasts looks at the arm, then asks for something else."""

    def __init__(self, bench: Lab, control: Control, at_s: float, then: Callable[[], None]) -> None:
        self.bench, self.control, self.at_s, self.then = bench, control, at_s, then
        self.asked = False
        self.asked_deg = self.held_deg = 0.0

    def progress(self, done_s: float, total_s: float) -> None:
        if done_s >= self.at_s and not self.asked:
            self.asked, self.asked_deg = True, self.bench.joint_deg()
            self.control.pause()

    def watch(self, shot: Snapshot) -> None:
        if shot.state == State.PAUSED and self.control.wish is Wish.PAUSE:
            self.bench.pass_s(0.8)  # the simulated world stands still in a pause, but for this; less than the watchdog
            self.held_deg = self.bench.joint_deg()
            self.then()


@ON_BOTH
def test_a_paused_arm_holds_at_once_and_the_cut_leg_is_done_again(tmp_path: Path, name: str) -> None:
    with lab(tmp_path, name, QUIET) as bench:
        control = Control()
        pauses = Pauses(bench, control, 4.0, control.resume)
        captured(bench, control, progress=pauses.progress, watch=pauses.watch)
        writer = bench.writer
        assert writer.state == "complete" and writer.counts["pauses"] == 1
        assert 10.0 < pauses.asked_deg < 30.0
        assert pauses.held_deg == pytest.approx(pauses.asked_deg, abs=1.0)  # 4 deg further, had it gone on
        assert states_of(bench) == ["checking", "moving", "paused", "moving", "parking", "idle"]
        assert any("leg 1 of 1 again" in event for event in writer.events)
        # Back at 5 deg/s from 20 deg, then the whole leg of 8 s.
        again_s = writer.at_s("motion done") - writer.at_s("again")
        assert again_s == pytest.approx(8.0, abs=0.1)
        assert not any(bench.each("torque_enable"))


@ON_BOTH
@pytest.mark.parametrize("at_exit", ["park-then-release", "hold", "release"])
@pytest.mark.parametrize("paused", [False, True], ids=["in mid-motion", "in a pause"])
def test_a_stop_leaves_the_arm_as_declared(tmp_path: Path, name: str, at_exit: str, paused: bool) -> None:
    with lab(tmp_path, name, QUIET, at_exit=at_exit) as bench:
        control = Control()
        pauses = Pauses(bench, control, 4.0, control.stop)

        def stop(done_s: float, total_s: float) -> None:
            if paused:
                pauses.progress(done_s, total_s)
            elif done_s >= 4.0:
                control.stop()

        captured(bench, control, progress=stop, watch=pauses.watch)
        assert bench.writer.state == "interrupted" and "INFO stopped" in bench.writer.events
        assert bench.writer.events[-1] == f"INFO arm left: {at_exit}"
        left_deg = bench.joint_deg()
        if at_exit == "hold":
            assert all(bench.each("torque_enable")) and 10.0 < left_deg < 30.0
        else:
            assert not any(bench.each("torque_enable"))
        assert (abs(left_deg) < 2.5) == (at_exit == "park-then-release")
        bench.pass_s(3.0)
        assert bench.joint_deg() == pytest.approx(left_deg, abs=1.0)
        if name != "demo":
            assert not any(bench.each("bus_watchdog"))


def test_a_stop_before_torque_is_on_leaves_the_arm_as_it_was_found(tmp_path: Path) -> None:
    with lab(tmp_path, "demo", QUIET) as bench:
        control = Control()
        control.stop()
        captured(bench, control)
        assert bench.writer.events[-1] == "INFO arm left: as it was found"
        assert not any(bench.each("torque_enable")) and bench.writer.state == "interrupted"


def test_a_pause_while_servos_are_checked_goes_on_after_it(tmp_path: Path) -> None:
    with lab(tmp_path, "demo", QUIET) as bench:
        control, asked = Control(), []

        def watch(shot: Snapshot) -> None:
            if shot.state == State.CHECKING and not asked:
                asked.append(shot)
                control.pause()
            elif shot.state == State.PAUSED and control.wish is Wish.PAUSE:
                assert not any(bench.each("torque_enable"))
                control.resume()

        captured(bench, control, watch=watch)
        assert states_of(bench)[:4] == ["checking", "paused", "checking", "moving"]
        assert bench.writer.state == "complete" and bench.writer.counts["pauses"] == 1


@ON_BOTH
def test_a_pause_while_parking_holds_the_arm_and_it_parks_after(tmp_path: Path, name: str) -> None:
    with lab(tmp_path, name, QUIET) as bench:
        control, held_deg = Control(), []

        def watch(shot: Snapshot) -> None:
            if shot.state == State.PARKING and not held_deg and abs(bench.joint_deg()) < 30.0:
                control.pause()
            if shot.state == State.PAUSED and control.wish is Wish.PAUSE:
                held_deg.append(bench.joint_deg())
                bench.pass_s(0.8)
                held_deg.append(bench.joint_deg())
                control.resume()

        captured(bench, control, watch=watch)
        assert held_deg[0] == pytest.approx(held_deg[1], abs=2.0) and held_deg[1] > 10.0
        assert states_of(bench)[-4:] == ["parking", "paused", "parking", "idle"]
        assert abs(bench.joint_deg()) < 2.5 and bench.writer.state == "complete"
        assert not any(bench.each("torque_enable"))


def test_who_watches_is_told_of_each_state_and_of_every_joint(tmp_path: Path) -> None:
    with lab(tmp_path, "openmanipulator_x", QUIET) as bench:
        shots: list[Snapshot] = []
        captured(bench, Control(), watch=shots.append)
    changes = [
        shot.state
        for shot, before in zip(shots, [None, *shots], strict=False)
        if before is None or shot.state != before.state
    ]
    assert changes == ["checking", "moving", "parking", "idle"]
    assert shots[-1].step == "arm left: park-then-release"
    moving = [shot for shot in shots if shot.state == State.MOVING and shot.done_s > 0]
    assert len(moving) > 30  # some five a second of 8 s
    assert np.all(np.diff([shot.done_s for shot in moving]) >= 0) and moving[-1].total_s == pytest.approx(8.0)
    joint = next(joint for joint in moving[-1].joints if joint.name == "joint2")
    assert np.degrees(joint.goal or 0.0) == pytest.approx(40.0) and np.degrees(joint.q) == pytest.approx(36.0, abs=5.0)
    assert 20 < joint.temperature_c < 60 and 9 < joint.voltage_v < 15
    assert moving[-1].seen_s and set(moving[-1].lost) >= {"camera", "detection", "recorder", "live view"}


def test_a_wish_reaches_a_waiting_thread_and_a_stop_stays() -> None:
    control = Control()
    control.pause()
    threading.Timer(0.05, control.resume).start()
    assert control.wait_while_paused(30.0) is Wish.RUN
    control.stop()
    control.pause()
    assert control.wish is Wish.PAUSE
    control.resume()
    assert control.wish is Wish.STOP


def test_by_hand_a_pause_is_left_out_and_a_stop_is_the_normal_end(tmp_path: Path) -> None:
    with lab(tmp_path, "demo", QUIET) as bench:
        control, done = Control(), list[float]()
        take_in_hand(bench.rig, lambda text: None)

        def progress(done_s: float, total_s: float) -> None:
            done.append(done_s)
            if len(done) == 50:
                control.pause()
            elif done_s > 3.0:
                control.stop()

        def watch(shot: Snapshot) -> None:
            if shot.state == State.PAUSED and control.wish is Wish.PAUSE:
                bench.pass_s(5.0)
                control.resume()

        HandCapture(bench.rig, cast(Any, bench.writer), control=control, progress=progress, watch=watch).run()
        writer = bench.writer
        assert writer.state == "complete" and states_of(bench) == ["checking", "moving", "paused", "moving", "idle"]
        assert writer.counts["pauses"] == 1 and 148 <= writer.counts["readings"] <= 153  # of 3 s, the pause left out
        assert writer.at_s("stopped") - writer.at_s("moved by hand") == pytest.approx(8.0, abs=0.2)
        assert not any(bench.each("torque_enable"))


def test_the_recording_says_what_the_live_view_left_out_and_why(tmp_path: Path) -> None:
    class Behind:
        shed = MappingProxyType({"view behind": 3, "over the view's rate": 40})

        def offer(self, item: object) -> None: ...

    with lab(tmp_path, "demo", QUIET) as bench:
        captured(bench, Control(), live=Behind())
        assert bench.writer.events[-1] == "INFO not shown in the live view: 3 (view behind), 40 (over the view's rate)"
        assert bench.writer.counts["live_view_shed"] == 43
