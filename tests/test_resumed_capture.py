"""Sessions that go on after an interruption: from their last checkpoint, into the same recording."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from station.capture.control import Control
from station.commands import capturing
from station.errors import InvalidData, StationError
from station.recording import Recording
from station.session import read_status
from tests.sessions import SHORT, capture_short, write_motion

KILLED = """
import sys
from pathlib import Path
from station.commands import capturing
capturing.capture("demo", sys.argv[1], Path(sys.argv[2]), seed=1)
"""


def stopped_in_leg(folder: Path, leg: int) -> Path:
    """A short session that was stopped in the middle of a leg (0, 1 or 2)."""
    control, out = Control(), folder / "session"

    def stop(done_s: float, total_s: float) -> None:
        if done_s > (0.3, 1.1, 2.0)[leg]:
            control.stop()

    capturing.capture("demo", write_motion(folder), out, seed=1, control=control, progress=stop)
    return out


def test_a_stopped_session_goes_on_from_its_last_checkpoint_into_the_same_recording(tmp_path: Path):
    out = stopped_in_leg(tmp_path, 1)
    before, status = Recording.load(out), read_status(out)
    assert status.state == "interrupted" and status.progress is not None and status.progress.leg == 1
    counts = capturing.resume(out)
    after, now = Recording.load(out), read_status(out)
    assert now.state == "complete" and now.recording_id == status.recording_id
    assert now.counts["frames"] == status.counts["frames"] + counts.frames == after.frames
    np.testing.assert_array_equal(after.frame_ns[: before.frames], before.frame_ns)
    assert np.all(np.diff(after.frame_ns) > 0) and np.all(np.diff(after.measured.t_s) > 0)
    later = after.commanded.t_s > before.commanded.t_s[-1]
    pan = np.degrees(after.commanded.state("base_pan")[later])
    assert pan[0] == pytest.approx(-10.0) and pan[-1] == pytest.approx(0.0)  # legs 2 and 3; the first isn't repeated
    assert any("starts" in text and "from leg 2 of 3" in text for text in (event.text for event in after.events))


def test_a_killed_session_goes_on_and_holds_the_whole_motion(tmp_path: Path):
    out, motion = tmp_path / "session", write_motion(tmp_path, SHORT.replace("hold_s = 0.2", "hold_s = 3.0"))
    program = subprocess.Popen([sys.executable, "-c", KILLED, motion, str(out)], env={**os.environ})
    try:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and not reached(out, 1):
            time.sleep(0.05)
    finally:
        program.send_signal(signal.SIGKILL)
        program.wait()
    assert read_status(out).state == "recording" and reached(out, 1)
    capturing.resume(out)
    recording = Recording.load(out)
    assert read_status(out).state == "complete"
    pan = np.degrees(recording.commanded.state("base_pan"))
    assert set(np.unique(pan).round(6)) == {-10.0, 0.0, 30.0}
    assert np.all(np.diff(recording.frame_ns) > 0)


def reached(out: Path, leg: int) -> bool:
    try:
        progress = read_status(out).progress
    except StationError:
        return False
    return progress is not None and progress.leg >= leg


def test_what_can_not_go_on_says_why(tmp_path: Path):
    complete, _ = capture_short(tmp_path, seed=1)
    with pytest.raises(InvalidData, match="is complete"):
        capturing.resume(complete)
    (tmp_path / "hand").mkdir()
    by_hand = tmp_path / "hand" / "session"
    with pytest.raises(KeyError):
        capturing.capture_by_hand("demo", by_hand, ask=lambda text: None, duration_s=2.0, progress=break_off)
    with pytest.raises(InvalidData, match="by hand"):
        capturing.resume(by_hand)
    with pytest.raises(StationError, match="missing"):
        capturing.resume(tmp_path / "nowhere")


def break_off(done_s: float, total_s: float) -> None:
    raise KeyError("broken")


def test_a_session_whose_motion_was_changed_does_not_go_on(tmp_path: Path):
    out = stopped_in_leg(tmp_path, 0)
    text = (out / "motion.toml").read_text(encoding="utf-8")
    for changed in (text + "[[step]]\nmove = { wrist = 5 }\n", text.replace("= 30", "= 31")):  # other legs; the same
        assert changed != text
        (out / "motion.toml").write_text(changed, encoding="utf-8")
        with pytest.raises(InvalidData, match=r"motion\.toml isn't the motion that the session was captured with"):
            capturing.resume(out)
    assert read_status(out).state == "interrupted"
