"""`station capture` as a person runs it: on a terminal, with a live view, ended by keys and signals."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from station.recording import Recording
from station.session import read_status
from tests.listening import listening
from tests.sessions import write_motion
from tests.terminal import CTRL_C, PATIENCE_S, Terminal

STATION = ["-c", "import sys; sys.argv[0] = 'station'; from station.cli import main; main()"]


def events(session: Path) -> str:
    return "\n".join(event.text for event in Recording.load(session).events)


def test_a_capture_is_paused_goes_on_and_is_stopped_from_the_terminal(tmp_path: Path):
    out = tmp_path / "session"
    with Terminal([*STATION, "capture", "demo", "demo", "--out", str(out)]) as terminal:
        assert "base_pan" in terminal.wait_for("step 2")
        terminal.press(CTRL_C)
        terminal.wait_for("Enter: on from the last checkpoint")
        terminal.wait_for("PAUSED")
        terminal.press("\n")
        terminal.wait_for("MOVING")
        terminal.press(CTRL_C)
        terminal.wait_for("PAUSED")
        terminal.press(CTRL_C)
        assert terminal.end() == 130
        said = terminal.screen().replace("\n", "")
    assert f"what was recorded is in {out}" in said and "arm left: park-then-release" in said
    assert "Traceback" not in terminal.shown
    assert read_status(out).state == "interrupted"
    assert read_status(out).counts["pauses"] == 2
    assert "arm left: park-then-release" in events(out)


def test_a_capture_that_was_stopped_is_gone_on_with(station, tmp_path: Path):
    out = tmp_path / "session"
    with Terminal([*STATION, "capture", "demo", write_motion(tmp_path), "--out", str(out)]) as terminal:
        terminal.wait_for("step 2")
        os.kill(terminal.program.pid, signal.SIGTERM)
        assert terminal.end() == 143
        assert f"station capture --resume {out}" in terminal.screen().replace("\n", "")
    code, said, err = station("capture", "--resume", out)
    assert code == 0 and "frames" in said, err
    assert f"{out} is complete" in err and f"station fit {out}" in err
    assert read_status(out).state == "complete"
    code, _, err = station("capture", "--resume", out)
    assert code == 1 and "is complete" in err


def test_a_live_view_is_served_on_this_machine_only(tmp_path: Path):
    out = tmp_path / "session"
    program = subprocess.Popen(
        [sys.executable, *STATION, "capture", "demo", "demo", "--headless", "--out", str(out)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert program.stderr is not None
    found = re.search(r"rerun\+http://127\.0\.0\.1:(\d+)/proxy", program.stderr.readline())
    assert found is not None
    while "moving" not in (line := program.stderr.readline()):
        assert line, "the capture ended before it moved"
    assert listening(program.pid) == {f"0100007F:{int(found[1]):04X}"}
    os.kill(program.pid, signal.SIGINT)
    _, err = program.communicate(timeout=PATIENCE_S)
    assert program.returncode == 130, err
    assert read_status(out).state == "interrupted"


def test_a_live_view_that_is_not_asked_for_is_not_served(tmp_path: Path):
    out = tmp_path / "session"
    with Terminal([*STATION, "capture", "demo", "demo", "--out", str(out)]) as terminal:
        terminal.wait_for("MOVING")
        assert listening(terminal.program.pid) == set()
        os.kill(terminal.program.pid, signal.SIGTERM)
        assert terminal.end() == 143


def test_a_taken_port_is_an_error_before_anything_is_made(station, tmp_path: Path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        out = tmp_path / "session"
        code, _, err = station("capture", "demo", "demo", "--headless", "--port", port, "--out", out)
    assert code == 1 and err.startswith("error: ") and f"port {port}" in err and "--port" in err
    assert not out.exists()


def test_without_a_screen_no_viewer_is_an_error_before_anything_is_made(
    station, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    out = tmp_path / "session"
    code, _, err = station("demo", "--view", "--out", out)
    assert code == 1 and "no screen" in err and "--headless" in err
    assert not out.exists()


def test_what_is_gone_on_with_is_not_said_twice(station, tmp_path: Path):
    for arguments in (("demo",), ("--out", tmp_path), ("--seed", "0"), ("--simulate",), ("--hand",), ("--force",)):
        assert station("capture", "--resume", tmp_path, *arguments)[0] == 2, arguments
    assert station("capture", "demo", "demo")[0] == 2
    assert station("capture", "--out", tmp_path)[0] == 2


@pytest.mark.parametrize(
    "arguments", [("--view", "--headless"), ("--port", "9999"), ("--headless", "--port", "0"), ("--duration-s", "3")]
)
def test_options_that_do_not_go_together_are_wrong_usage(station, tmp_path: Path, arguments: tuple[str, ...]):
    code, _, err = station("capture", "demo", "demo", "--out", tmp_path / "session", *arguments)
    assert code == 2 and "Usage" in err
