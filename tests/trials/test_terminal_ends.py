"""Ctrl-C on a real terminal, with the arm outside of the program: what its servos do, by their own registers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from station.session import read_status
from tests.terminal import CTRL_C, Terminal
from tests.trials.bench import GOAL_DEG, NEAR_DEG, Bench, bench, motion_of
from tests.trials.programs import capture_arguments
from tests.trials.test_ends import ON_BOTH, check_left


@contextmanager
def on_terminal(lab: Bench) -> Iterator[Terminal]:
    """The capture of the bench's motion on a terminal, once the joint is well under way."""
    told = ["-m", "tests.trials.told", str(lab.folder / "ledger"), ""]
    arguments = capture_arguments(lab.folder, rig=str(lab.rig), motion=motion_of(lab.joint))
    with Terminal([*told, *arguments], size=(40, 100)) as terminal:
        terminal.wait_until(lambda: lab.joint_deg() > 4.0)
        yield terminal


@ON_BOTH
def test_the_first_interrupt_holds_the_arm_and_the_second_parks_it(tmp_path: Path, rig: str) -> None:
    with bench(tmp_path, rig) as lab, on_terminal(lab) as terminal:
        terminal.press(CTRL_C)
        terminal.wait_for("paused")
        terminal.wait_until(lab.rests)
        assert all(lab.each("torque_enable"))
        assert 4.0 < (held_deg := lab.joint_deg()) < GOAL_DEG - 5.0
        terminal.press(CTRL_C)
        assert terminal.end() == 130
        check_left(lab, "park-then-release")
        assert read_status(tmp_path / "session").state == "interrupted"
        assert abs(lab.joint_deg()) < NEAR_DEG < held_deg


def test_after_a_pause_the_arm_goes_back_and_makes_its_motion(tmp_path: Path) -> None:
    with bench(tmp_path, "openmanipulator_x") as lab, on_terminal(lab) as terminal:
        terminal.press(CTRL_C)
        terminal.wait_for("paused")
        terminal.wait_until(lab.rests)
        held_deg = lab.joint_deg()
        terminal.press("\n")
        terminal.wait_until(lambda: lab.joint_deg() < held_deg - 2.0)  # the leg begins at 0
        terminal.wait_until(lambda: lab.joint_deg() == pytest.approx(GOAL_DEG, abs=NEAR_DEG))
        terminal.press(CTRL_C)
        terminal.wait_for("paused")
        terminal.press("s")
        assert terminal.end() == 130
        check_left(lab, "park-then-release")
