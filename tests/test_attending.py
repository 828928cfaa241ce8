"""A capture on a real terminal: what is seen, what keys and signals do, and with which exit code it ends."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import sys
import termios
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from station.cli.keys import Keys
from tests.terminal import CTRL_C, CTRL_Z, PATIENCE_S, Terminal

ASKED = "Enter: on from the last checkpoint"


def on_terminal(folder: Path, kind: str = "motion", **options: tuple[int, int]) -> Terminal:
    return Terminal(["-m", "tests.made_capture", str(folder), kind], **options)


def states(folder: Path) -> list[str]:
    path = folder / "states.txt"
    return path.read_text(encoding="utf-8").split() if path.exists() else []


def test_ctrl_c_pauses_and_enter_goes_on(tmp_path: Path):
    with on_terminal(tmp_path) as terminal:
        terminal.wait_for("MOVING")
        terminal.press(CTRL_C)
        terminal.wait_for(ASKED)
        assert "PAUSED" in terminal.wait_for("PAUSED")
        terminal.press("\n")
        assert ASKED not in terminal.wait_for("MOVING")
        assert states(tmp_path) == ["checking", "moving", "paused", "moving"]


@pytest.mark.parametrize("answer", ["s\n", CTRL_C])
def test_at_the_question_the_capture_can_be_stopped(tmp_path: Path, answer: str):
    with on_terminal(tmp_path) as terminal:
        terminal.wait_for("MOVING")
        terminal.press(CTRL_C)
        terminal.wait_for(ASKED)
        terminal.press(answer)
        assert terminal.end() == 130
        assert states(tmp_path) == ["checking", "moving", "paused", "parking", "idle"]
        said = terminal.screen()
        assert f"what was recorded is in {tmp_path}" in said.replace("\n", "")
        assert "arm left: park-then-release" in said.replace("\n", "") and "station fit" in said
        assert "Traceback" not in terminal.shown


def test_what_was_pressed_before_the_question_answers_nothing(tmp_path: Path):
    with on_terminal(tmp_path) as terminal:
        terminal.wait_for("MOVING")
        terminal.press("\ns\n")
        terminal.press(CTRL_C)
        terminal.wait_for(ASKED)
        time.sleep(0.5)
        assert states(tmp_path) == ["checking", "moving", "paused"]


def test_a_key_that_ctrl_c_takes_back_holds_nothing_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal forgets at Ctrl-C what was pressed: also when that was there a moment ago, and is about to be read."""
    ours, theirs = pty.openpty()
    ready, answers = select.select, list[str]()
    with os.fdopen(ours, "wb", buffering=0) as keyboard, os.fdopen(theirs, "rb", buffering=0) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with Keys() as keys:

            def ready_and_taken_back(*arguments: Any) -> Any:
                found = ready(*arguments)
                keys.forget()
                return found

            monkeypatch.setattr(select, "select", ready_and_taken_back)
            keyboard.write(b"s")
            waiting = threading.Thread(target=lambda: answers.append(keys.wait(0.1)))
            waiting.start()
            waiting.join(5.0)
            held_up = waiting.is_alive()
            keyboard.write(b"x")  # it would be waited for
            waiting.join()
    assert not held_up and answers == [""]


@pytest.mark.parametrize("answer", ["\n", CTRL_C])
def test_on_its_way_to_be_left_the_arm_is_held_too_and_then_left_as_declared(tmp_path: Path, answer: str):
    with on_terminal(tmp_path) as terminal:
        terminal.wait_for("MOVING")
        terminal.press(CTRL_C)
        terminal.wait_for(ASKED)
        terminal.press(CTRL_C)
        terminal.wait_until(lambda: "parking" in states(tmp_path))
        terminal.press(CTRL_C)
        terminal.wait_for("held on its way")
        time.sleep(1.0)
        assert states(tmp_path)[-2:] == ["parking", "paused"]
        terminal.press(answer)
        assert terminal.end() == 130
        assert states(tmp_path)[-2:] == ["parking", "idle"]


def test_ctrl_z_pauses_for_a_suspended_program_watches_over_no_arm(tmp_path: Path):
    with on_terminal(tmp_path) as terminal:
        terminal.wait_for("MOVING")
        terminal.press(CTRL_Z)
        terminal.wait_for(ASKED)
        assert states(tmp_path)[-1] == "paused"


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_other_signals_stop_without_a_question(tmp_path: Path, sent: signal.Signals, code: int):
    with on_terminal(tmp_path) as terminal:
        terminal.wait_for("MOVING")
        os.kill(terminal.program.pid, sent)
        assert terminal.end() == code
        assert states(tmp_path) == ["checking", "moving", "parking", "idle"]


def test_a_terminal_that_is_closed_stops_the_capture(tmp_path: Path):
    with on_terminal(tmp_path) as terminal:
        terminal.wait_for("MOVING")
        terminal.hang_up()
        assert terminal.program.wait(PATIENCE_S) == 129
        assert states(tmp_path) == ["checking", "moving", "parking", "idle"]


def test_before_anything_moves_ctrl_c_ends_at_once(tmp_path: Path):
    with on_terminal(tmp_path, "slow-start") as terminal:
        terminal.wait_until((tmp_path / "begun").exists)
        terminal.press(CTRL_C)
        assert terminal.end() == 130
        assert states(tmp_path) == []


def test_by_hand_ctrl_c_is_the_normal_end(tmp_path: Path):
    with on_terminal(tmp_path, "hand") as terminal:
        terminal.wait_for("Ctrl-C ends the recording")
        terminal.press(CTRL_C)
        assert terminal.end() == 0
        assert states(tmp_path) == ["checking", "moving", "parking", "idle"]


def test_the_terminal_is_left_as_it_was(tmp_path: Path):
    with on_terminal(tmp_path) as terminal:
        before = terminal.modes
        terminal.wait_for("MOVING")
        assert before & termios.ECHO and not terminal.modes & termios.ECHO
        terminal.press(CTRL_C)
        terminal.wait_for(ASKED)
        terminal.press("s")
        terminal.end()
        assert terminal.modes == before
        assert terminal.shown.rfind("\x1b[?25h") > terminal.shown.rfind("\x1b[?25l")  # the cursor is shown again


@pytest.mark.parametrize("size", [(24, 80), (24, 40), (10, 60)])
def test_the_dashboard_stays_in_its_place(tmp_path: Path, size: tuple[int, int]):
    with on_terminal(tmp_path, size=size) as terminal:
        terminal.wait_for("MOVING")
        for _ in range(6):
            time.sleep(0.2)
            assert terminal.screen().count("MOVING") == 1, terminal.screen()


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_where_nobody_can_be_asked_the_first_signal_stops(tmp_path: Path, sent: signal.Signals, code: int):
    program = subprocess.Popen(
        [sys.executable, "-m", "tests.made_capture", str(tmp_path), "motion"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + PATIENCE_S
    while "moving" not in states(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(program.pid, sent)
    _, err = program.communicate(timeout=PATIENCE_S)
    assert program.returncode == code, err
    assert states(tmp_path) == ["checking", "moving", "parking", "idle"]
    told = [line.split() for line in err.splitlines()]
    assert [line[1].rstrip(":") for line in told[:4]] == ["checking", "moving", "parking", "idle"]
