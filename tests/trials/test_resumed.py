"""A session that was killed, gone on with, killed again and gone on with is as good as one that nobody disturbed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from station.commands import capturing, fitting, reporting
from station.recording import Recording
from station.session import read_status
from tests.trials.programs import Program, capture_arguments, program

JOINTS = {"base_pan", "shoulder", "elbow", "wrist"}
# On a busy machine servos' answers, and with them their stamps, come up to tens of ms late: a degree at 40 deg/s.
BUSY_DEG = 1.0


def killed_in_leg(running: Program, leg: int) -> None:
    """Kill it when it is under way in a leg, numbered from 1."""
    running.wait_for(
        lambda: any(line.word == "event" and line.text == f"step {leg}" for line in running.lines()), f"leg {leg}"
    )
    frames = sum(line.word == "frame" for line in running.lines())
    running.wait_for_frames(frames + 2)
    running.kill()


def errors_deg(session: Path) -> dict[str, float]:
    """Of each joint the RMS of its detected angle against its read-back."""
    joints = reporting.compare(session).joints
    return {joint.joint: np.degrees(joint.against_measured.rmse) for joint in joints if joint.against_measured}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session that nobody disturbed, on the virtual clock."""
    folder = tmp_path_factory.mktemp("whole")
    capture_arguments(folder)
    capturing.capture("demo", str(folder / "motion.toml"), folder / "session", seed=0)
    fitting.fit(folder / "session")
    return folder / "session"


def test_a_session_that_was_killed_twice_and_gone_on_with_is_whole(tmp_path: Path, whole: Path) -> None:
    first, second, third = (tmp_path / name for name in ("first", "second", "third"))
    for folder in (first, second, third):
        folder.mkdir()
    session = tmp_path / "session"
    with program(first, *capture_arguments(first, session=session), session=session) as running:
        killed_in_leg(running, 2)
    kept = Recording.load(session).frame_ns
    resume = ("capture", "--resume", str(session), "--realtime")
    with program(second, *resume, session=session) as running:
        killed_in_leg(running, 3)
    with program(third, *resume, session=session) as running:
        code, said = running.end()
    assert code == 0, said
    recording, status = Recording.load(session), read_status(session)
    assert (status.state, recording.notices) == ("complete", ())
    np.testing.assert_array_equal(recording.frame_ns[: len(kept)], kept)
    assert np.all(np.diff(recording.frame_ns) > 0) and np.all(np.diff(recording.measured.t_s) > 0)
    assert np.all(np.diff(recording.frame_index) > 0)
    assert sum(1 for _ in recording.frame_jpegs()) >= 0.9 * recording.frames
    targets = {tuple(row) for row in np.degrees(Recording.load(whole).commanded.q).round(3).tolist()}
    assert targets <= {tuple(row) for row in np.degrees(recording.commanded.q).round(3).tolist()}
    tree = fitting.fit(session).fit.tree
    assert {(joint.name, joint.type) for joint in tree.joints} == {(name, "revolute") for name in JOINTS}
    have, want = errors_deg(session), errors_deg(whole)
    assert have.keys() == want.keys() == JOINTS
    assert all(have[joint] < want[joint] + BUSY_DEG for joint in JOINTS), (have, want)
