"""`kill -9` in the middle of a capture; tests/benchmarks/kills.py does it a hundred times, at random."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.commands import fitting
from station.recording import Recording
from tests.trials.losses import losses, untrue
from tests.trials.programs import Program, capture_arguments, program

MOST_LOST_S = 1.0
# A fit wants 10 frames of the parts together, and those of the last second may be lost.
ENOUGH_FRAMES = 25


def said(running: Program, text: str) -> bool:
    """Whether the program has recorded an event with this text."""
    return any(line.word == "event" and text in line.text for line in running.lines())


@pytest.mark.parametrize("seconds", [1.9, 3.1])
def test_a_killed_session_holds_all_but_its_last_second_tells_the_truth_and_fits(
    tmp_path: Path, seconds: float
) -> None:
    with program(tmp_path, *capture_arguments(tmp_path)) as running:
        running.wait_for_motion(seconds)
        running.wait_for_frames(ENOUGH_FRAMES)  # a busy machine draws fewer in that time
        killed_ns = running.kill()
    recording = Recording.load(running.session)
    loss = losses(recording, running.lines(), killed_ns)
    assert loss.wrong == ()
    assert loss.worst_s < MOST_LOST_S
    assert recording.notices
    assert untrue(running.session, recording) == ""
    assert {joint.name for joint in fitting.fit(running.session).fit.tree.joints} >= {"base_pan", "shoulder"}


def test_a_session_that_is_killed_while_the_arm_parks_is_not_complete(tmp_path: Path) -> None:
    with program(tmp_path, *capture_arguments(tmp_path)) as running:
        running.wait_for(lambda: said(running, "motion done"), "end of the motion")
        killed_ns = running.kill()
    recording = Recording.load(running.session)
    assert losses(recording, running.lines(), killed_ns).worst_s < MOST_LOST_S
    assert untrue(running.session, recording) == ""


def test_a_program_that_is_killed_before_its_arm_moves_leaves_a_folder_that_can_be_told_from_a_session(
    tmp_path: Path,
) -> None:
    with program(tmp_path, *capture_arguments(tmp_path)) as running:
        running.wait_for(running.session.is_dir, "session's folder")
        running.kill()
    with program(tmp_path, "fit", str(running.session)) as fitted:
        code, told = fitted.end()
    assert code == 1 and str(running.session) in told and "Traceback" not in told
