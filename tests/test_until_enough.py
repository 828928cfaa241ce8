"""Captures that go on by themselves until enough was seen of each joint, and what is said before they start."""

from __future__ import annotations

import shutil
from collections import namedtuple
from pathlib import Path

import numpy as np
import pytest

from station.capture.control import Control
from station.capture.lengthening import ROUND, Lengthening
from station.capture.snapshot import Snapshot
from station.cli.attending import Disk
from station.commands import capturing, fitting, planning
from station.fit_files import read_fit
from station.formats.motion import parse_motion
from station.motion import JointLimits, Motion, MotionStep, plan_motion
from station.recording import Recording
from station.recording.sizes import expected_rates
from station.rig import load_rig
from station.session import MOTION_FILE, NEXT_MOTION_FILE, read_status
from tests.sessions import slower_rig

# The elbow moves by 2 deg: too little for a fit to tell it from a fixed joint.
SHY_ELBOW = """schema = "motion/1"
name = "shy elbow"
mode = "stream"
[[step]]
each_joint = { at_most_deg = 12, skip = ["elbow"] }
speed_deg_s = 40
[[step]]
move = { elbow = -2 }
hold_s = 0.2
[[step]]
move = { elbow = 0 }
hold_s = 0.2
"""
# The same, and no other joint moves.
ONLY_ELBOW = """schema = "motion/1"
name = "only the elbow"
mode = "stream"
[[step]]
move = { elbow = -2 }
hold_s = 0.2
[[step]]
move = { elbow = 0 }
hold_s = 0.2
"""
Usage = namedtuple("Usage", "total used free")


def motion_file(folder: Path, text: str) -> str:
    path = folder / "m.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def said(session: Path, level: str, word: str) -> list[str]:
    return [event.text for event in Recording.load(session).events if event.level == level and word in event.text]


def found(session: Path) -> set[str]:
    fitting.fit(session)
    return {joint.name for joint in read_fit(session / "fit").tree.joints if joint.type == "revolute"}


def test_a_joint_that_moved_too_little_is_moved_on_and_then_found(tmp_path: Path):
    totals: list[float] = []
    motion, out = motion_file(tmp_path, SHY_ELBOW), tmp_path / "s"
    rig, planned = slower_rig("demo", tmp_path), planning.plan("demo", motion)
    capturing.capture(rig, motion, tmp_path / "short")
    assert "elbow" not in found(tmp_path / "short")
    capturing.capture(rig, motion, out, until_enough=3, progress=lambda done_s, total_s: totals.append(total_s))
    assert "elbow" in found(out)
    (told,) = said(out, "INFO", "further motion, round")
    assert "elbow" in told and "%" in told and "wrist" not in told
    assert totals[0] == pytest.approx(planned.duration_s) and totals[-1] > totals[0] + 1
    text = (out / MOTION_FILE).read_text(encoding="utf-8")
    assert text.startswith(SHY_ELBOW.rstrip()) and text.count(ROUND) == 1
    assert not (out / NEXT_MOTION_FILE).exists()
    legs = len(planning.plan("demo", str(out / MOTION_FILE)).segments)
    progress = read_status(out).progress
    assert legs == len(planned.segments) + 3
    assert progress is not None and (progress.leg, progress.legs) == (legs - 1, legs)
    assert not said(out, "WARN", "not enough motion")


def stopped_in_further_motion(folder: Path) -> Path:
    """A session that was stopped within its first round of further motion."""
    control, out, motion = Control(), folder / "s", motion_file(folder, ONLY_ELBOW)
    planned_s = planning.plan("demo", motion).duration_s

    def stop(done_s: float, total_s: float) -> None:
        if done_s > planned_s + 3.0:
            control.stop()

    capturing.capture(slower_rig("demo", folder), motion, out, until_enough=1, seed=1, control=control, progress=stop)
    return out


def test_a_session_that_was_lengthened_goes_on_in_its_further_motion(tmp_path: Path):
    out = stopped_in_further_motion(tmp_path)
    status, planned = read_status(out), planning.plan("demo", str(out / MOTION_FILE))
    assert status.state == "interrupted" and status.progress is not None
    assert status.progress.legs == len(planned.segments) == 2 + 4 * 3
    before_s = Recording.load(out).duration_s
    # A kill between session.json and the new motion.toml leaves it beside the old one.
    shutil.move(out / MOTION_FILE, out / NEXT_MOTION_FILE)
    motion_file(tmp_path, ONLY_ELBOW)
    shutil.copy(tmp_path / "m.toml", out / MOTION_FILE)
    capturing.resume(out, until_enough=1)
    assert read_status(out).state == "complete" and not (out / NEXT_MOTION_FILE).exists()
    assert (out / MOTION_FILE).read_text(encoding="utf-8").count(ROUND) == 1  # what moved before counts, and the round
    recording = Recording.load(out)
    later = recording.commanded.t_s > before_s
    wrist = recording.commanded.state("wrist")
    assert np.ptp(np.degrees(wrist[later])) > 60
    assert not said(out, "WARN", "not enough motion")


def test_what_still_lacks_at_the_end_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("station.capture.crew.MotionTally.shares", lambda self: {"elbow": 0.25, "wrist": 1.0})
    out = tmp_path / "s"
    capturing.capture(slower_rig("demo", tmp_path), motion_file(tmp_path, ONLY_ELBOW), out, until_enough=1)
    (warning,) = said(out, "WARN", "not enough motion")
    assert "elbow 25 %" in warning and "wrist" not in warning and "1 further round" in warning
    assert read_status(out).state == "complete"


def test_a_motion_in_one_array_is_lengthened_too():
    joints = (JointLimits("pan", -1.5, 1.5, 1.0),)
    text = 'schema = "motion/1"\nname = "m"\nmode = "stream"\nstep = [{ move = { pan = 2 } }]\n'
    plan = plan_motion(parse_motion(text, "m", joints), joints)
    lengthening = Lengthening(text, 2)
    longer = lengthening.longer(plan, {"pan": 0.1})
    assert longer is not None
    again = plan_motion(parse_motion(lengthening.text, "m", joints), joints)
    np.testing.assert_array_equal([leg.q_to for leg in again.segments], [leg.q_to for leg in longer.segments])
    assert again.checkpoints_s.tolist() == longer.checkpoints_s.tolist()
    assert Lengthening(lengthening.text, 1).longer(longer, {"pan": 0.1}) is None  # the round counts for its session
    assert Lengthening(text, 0).longer(plan, {"pan": 0.1}) is None


def test_rounds_that_can_not_move_anything_are_passed_over():
    stuck = (JointLimits("pan", 0.0, 0.0, 1.0), JointLimits("tilt", -1.0, 1.0, 1.0))
    plan = plan_motion(Motion("m", (MotionStep({"tilt": 0.1}),), "stream"), stuck)
    longer = Lengthening("", 2).longer(plan, {"pan": 0.1, "tilt": 1.0})
    assert longer is None or len(longer.segments) > len(plan.segments)


def test_remarks_are_recorded_and_shown_before_anything_moves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    first = tmp_path / "first"
    capturing.capture("demo", motion_file(tmp_path, ONLY_ELBOW), first)
    monkeypatch.setattr("station.recording.sizes.shutil.disk_usage", lambda folder: Usage(1e9, 1e9, 5e5))
    shots: list[Snapshot] = []
    head, step = 'schema = "motion/1"\nname = "again"\nmode = "stream"\n', "[[step]]\nspeed_deg_s = 4\n"
    fast = f'{head}{step}replay = {{ file = "first" }}\n'
    capturing.capture("demo", motion_file(tmp_path, fast), tmp_path / "s", watch=shots.append)
    events = [event.text for event in Recording.load(tmp_path / "s").events]
    note = next(k for k, text in enumerate(events) if text.startswith("first: ") and "slow" in text)
    room = next(k for k, text in enumerate(events) if "make room" in text)
    assert max(note, room) < events.index("state: moving")
    assert any("make room" in shot.said for shot in shots)
    assert shots[0].bytes_per_s == pytest.approx(expected_rates(load_rig("demo").table).bytes_per_s)


def test_plan_and_dry_run_print_the_remarks(station, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("station.recording.sizes.shutil.disk_usage", lambda folder: Usage(1e9, 1e9, 5e5))
    motion = motion_file(tmp_path, SHY_ELBOW)
    for arguments in (("plan", "demo", motion), ("capture", "demo", motion, "--dry-run", "--out", tmp_path / "s")):
        code, _, err = station(*arguments)
        assert code == 0 and "make room" in err


def test_the_disk_left_is_told_as_time_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("station.cli.attending.shutil.disk_usage", lambda folder: Usage(1e12, 1e12, 70.7e9))
    assert Disk(tmp_path).text(70.7e9 / (38 * 3600)) == "70.7 GB left, 38 h"
    assert Disk(tmp_path).text(70.7e9 / (45 * 60)) == "70.7 GB left, 45 min"
    assert Disk(tmp_path).text(None) == "70.7 GB left"


def test_images_are_kept_as_asked_for_also_when_the_session_goes_on(station, tmp_path: Path):
    control, out = Control(), tmp_path / "s"

    def stop(done_s: float, total_s: float) -> None:
        if done_s > 0.5:
            control.stop()

    motion = motion_file(tmp_path, ONLY_ELBOW)
    capturing.capture("demo", motion, out, seed=1, frames="none", control=control, progress=stop)
    assert read_status(out).images == "none"
    code, _, err = station("capture", "--resume", out)
    assert code == 0, err
    assert read_status(out).images == "none"
    assert list(Recording.load(out).frame_jpegs()) == []


def test_images_that_can_not_be_kept_so_are_an_error_before_anything_is_made(
    station, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("station.recording.lossless.importlib.util.find_spec", lambda name: None)
    out = tmp_path / "s"
    for command in ("run", "capture"):
        code, _, err = station(command, "demo", "demo", "--frames", "ffv1", "--out", out)
        assert code == 1 and "capture-fit-station[lossless]" in err
        assert not out.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("capture", "demo", "demo", "--frames", "png"),
        ("capture", "demo", "demo", "--until-enough", "-1"),
        ("capture", "demo", "demo", "--until-enough", "some"),
        ("capture", "demo", "--hand", "--until-enough", "2"),
        ("run", "demo", "demo", "--frames", "png"),
        ("run", "demo", "demo", "--until-enough", "-1"),
    ],
)
def test_what_can_not_be_asked_for_is_wrong_usage(station, tmp_path: Path, arguments: tuple[str, ...]):
    out = tmp_path / "s"
    code, _, err = station(*arguments, "--out", out)
    assert code == 2 and "Usage" in err
    assert not out.exists()


def test_a_session_that_goes_on_keeps_its_frames_as_they_were(station, tmp_path: Path):
    assert station("capture", "--resume", tmp_path, "--frames", "jpeg")[0] == 2


def test_run_takes_both_and_says_so(station):
    for command in ("run", "capture"):
        code, text, _ = station(command, "--help")
        assert code == 0 and "--until-enough" in text and "--frames" in text


def test_a_motion_that_was_paused_in_a_curve_is_lengthened_from_its_true_end(tmp_path: Path):
    """A curve that is begun again in its middle takes longer; the further legs begin after that, and are made whole."""
    control, out = Control(), tmp_path / "s"
    waves = "sinusoids = { duration_s = 8, joint = { wrist = { amplitude_deg = 10, period_s = 4 } } }\n"
    text = f'schema = "motion/1"\nname = "m"\nmode = "stream"\n[[step]]\n{waves}'
    paused: list[float] = []

    def pause(done_s: float, total_s: float) -> None:
        if done_s > 5.0 and not paused:
            paused.append(done_s)
            control.pause()

    def go_on(shot: Snapshot) -> None:
        if shot.state == "paused":
            control.resume()

    rig, motion = slower_rig("demo", tmp_path), motion_file(tmp_path, text)
    capturing.capture(rig, motion, out, until_enough=1, control=control, progress=pause, watch=go_on)
    events = Recording.load(out).events
    begins = next(event for event in events if "further motion, round" in event.text)
    done = next(event for event in events if event.text == "motion done")
    more_s = float(begins.text.split(": ")[1].split(" s more")[0])
    assert done.t_s - begins.t_s == pytest.approx(more_s, abs=0.1)  # a few turns, and what is printed
    assert read_status(out).counts["pauses"] == 1
