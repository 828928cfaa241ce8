"""Ways in which a capture ends, as programs: the arm is left as declared, the session opens and tells the truth."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from station.recording import Recording
from station.session import read_status
from tests.trials.bench import GOAL_DEG, JOINTS, NEAR_DEG, Bench, bench
from tests.trials.programs import Program

ON_BOTH = pytest.mark.parametrize("rig", JOINTS)
EXITS = pytest.mark.parametrize("at_exit", ["park-then-release", "hold", "release"])
HARDWARE = 3


def check_left(lab: Bench, at_exit: str, *, limp: int = 0) -> None:
    """The arm is as the rig declares, by its servos' own registers; `limp` servos had shut themselves down."""
    torque = lab.each("torque_enable")
    assert lab.rests()
    if at_exit == "hold":
        assert sum(torque) == len(torque) - limp
        assert 3.0 < lab.joint_deg() < GOAL_DEG - 5.0  # neither back nor on
    else:
        assert not any(torque)
        assert (abs(lab.joint_deg()) < NEAR_DEG) == (at_exit == "park-then-release")
    if lab.table.bus.protocol == 2.0:
        assert not any(lab.each("bus_watchdog"))  # nobody needs to go on talking


def check_session(running: Program, state: str = "interrupted") -> Recording:
    """The session opens, and session.json says what is so."""
    recording = Recording.load(running.session)
    status = read_status(running.session)
    assert status.state == state
    assert status.counts["frames"] == recording.frames > 0
    assert status.counts["readings"] == len(recording.measured.t_s) > 0
    return recording


def last_words(recording: Recording) -> str:
    return recording.events[-1].text


@ON_BOTH
@EXITS
def test_sigterm_leaves_the_arm_as_declared_and_closes_the_session(tmp_path: Path, rig: str, at_exit: str) -> None:
    with bench(tmp_path, rig, at_exit=at_exit) as lab, lab.capture() as running:
        code, said = running.stop(signal.SIGTERM)
        assert code == 128 + signal.SIGTERM, said
        check_left(lab, at_exit)
        assert last_words(check_session(running)) == f"arm left: {at_exit}"


@ON_BOTH
def test_an_interrupt_without_a_terminal_ends_the_capture(tmp_path: Path, rig: str) -> None:
    with bench(tmp_path, rig) as lab, lab.capture() as running:
        code, said = running.stop(signal.SIGINT)
        assert code == 128 + signal.SIGINT, said
        check_left(lab, "park-then-release")
        check_session(running)


@ON_BOTH
def test_a_camera_that_is_gone_ends_the_capture(tmp_path: Path, rig: str) -> None:
    with bench(tmp_path, rig) as lab, lab.capture() as running:
        lab.gone.set()
        code, said = running.end()
        assert code == HARDWARE and "camera" in said
        check_left(lab, "park-then-release")
        check_session(running)


@ON_BOTH
def test_a_servo_that_fails_ends_the_capture(tmp_path: Path, rig: str) -> None:
    with bench(tmp_path, rig) as lab, lab.capture() as running:
        failed = next(joint.servo[0].id for joint in lab.table.joint if joint.name == lab.joint)
        lab.emulated.raise_alarm(failed, "overload")
        code, said = running.end()
        assert code == HARDWARE and "overload" in said
        check_left(lab, "release")
        check_session(running)


@ON_BOTH
@pytest.mark.parametrize("part", ["detection", "recorder", "servo loop"])
def test_a_part_of_the_program_that_breaks_ends_the_capture(tmp_path: Path, rig: str, part: str) -> None:
    with bench(tmp_path, rig) as lab, lab.capture(breaks=part) as running:
        code, said = running.end()
        assert code == 1 and "broke" in said
        check_left(lab, "park-then-release")
        recording = check_session(running)
        # What breaks in the recorder's thread, to which the servo loop hands its rows, is told on the terminal alone.
        assert any("broke" in event.text for event in recording.events) == (part == "detection")


@ON_BOTH
@pytest.mark.parametrize("what", ["bus", "program"])
def test_without_a_bus_or_a_program_the_servos_do_what_they_do_alone(tmp_path: Path, rig: str, what: str) -> None:
    """X servos have a bus watchdog and stop, holding; AX servos have none, go on to their goal and hold there."""
    with bench(tmp_path, rig) as lab, lab.capture() as running:
        if what == "bus":
            lab.emulated.unplug()
            code, said = running.end()
            assert code == HARDWARE and "is gone" in said
            check_session(running)
        else:
            running.kill()
        wait_for(lab.rests)
        assert all(lab.each("torque_enable"))
        if rig == "demo":
            assert lab.joint_deg() == pytest.approx(GOAL_DEG, abs=NEAR_DEG)
        else:
            assert 3.0 < lab.joint_deg() < GOAL_DEG - 5.0


def wait_for(condition: Callable[[], bool], patience_s: float = 20.0) -> None:
    deadline_s = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline_s
