"""Replays are what was recorded, without tremor, and slow enough; and they come from sessions, files and tables."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from station.capture.service import Capture
from station.commands import planning
from station.commands.motion_sources import read_motion
from station.errors import InvalidData, InvalidFile, StationError
from station.formats.motion import parse_motion
from station.logs import FloatArray, JointLog
from station.motion import SLOW, JointLimits, Motion, MotionStep, Plan, Replay, plan_motion, replay_of
from station.recording import RecordingWriter
from tests.made_sessions import CAMERA, MARKERS, START_NS, describe
from tests.test_capture import NoFrames, Writer, demo_rig, with_camera

PAN = JointLimits("pan", -1.5, 1.5, 2.0, park=0.5)
LIFT = JointLimits("lift", 0.0, 0.3, 0.2, park=0.1, unit="m")
LASTS_S = 12.5
TREMOR_HZ = 8.0
# Greatest speeds of the slow states, rad/s and m/s.
PAN_SPEED, LIFT_SPEED = 0.4 * 2 * np.pi * 0.08, 0.08 * 2 * np.pi * 0.16


def slow_states(t_s: FloatArray) -> FloatArray:
    """(N, 2) what the hand means to do: pan and lift, from rest to rest, slower than anything that is filtered off."""
    pan = 0.2 + 0.4 * np.cos(2 * np.pi * 0.08 * t_s)
    return np.column_stack([pan, 0.15 + 0.08 * np.cos(2 * np.pi * 0.16 * t_s)])


def record(*, tremor: float = 0.0, quicker: float = 1.0) -> JointLog:
    """The slow states, so many times as quick, with tremor of so many rad (a tenth of it in m), read unevenly."""
    count = int(50 * LASTS_S / quicker)
    t_s = (np.arange(count + 1) + np.random.default_rng(0).uniform(-0.1, 0.1, count + 1)) / 50
    shake = np.sin(2 * np.pi * TREMOR_HZ * t_s)[:, None] * (tremor, 0.1 * tremor)
    t_s -= t_s[0]
    return JointLog(3.0 + t_s, ("pan", "lift"), slow_states(quicker * t_s) + shake, ("rad", "m"))


def replayed(plan: Plan, t_s: FloatArray) -> FloatArray:
    """What is commanded at times since the record's start."""
    leg = next(leg for leg in plan.segments if leg.curve is not None)
    return plan.commanded(leg.t_start_s + 0.1 + t_s)  # it rests for 0.1 s before


def test_a_replay_commands_what_was_recorded_without_its_tremor():
    replay, notes = replay_of(record(tremor=0.01), (PAN, LIFT))
    assert notes == ()
    plan = plan_motion(Motion("m", (replay,), "stream"), (PAN, LIFT))
    t_s = np.linspace(0.5, LASTS_S - 0.5, 400)
    # A Butterworth low-pass of second order there and back leaves 1 / (1 + (8 / 2)^4) of a tremor of 8 Hz, 0.4 % of it;
    # knots 0.1 s apart miss less than a mrad of so slow a motion.
    apart = np.abs(replayed(plan, t_s) - slow_states(t_s))
    assert apart[:, 0].max() < 1e-3 and apart[:, 1].max() < 2e-4
    assert len(record().t_s) > 2 * len(replay.t_s)


def test_a_hand_that_was_too_quick_is_replayed_slower_as_a_whole_and_that_is_said():
    replay, notes = replay_of(record(quicker=3.0), (PAN, LIFT))
    stretch = float(replay.t_s[-1]) / (LASTS_S / 3)
    # Pan is 1.7 times too fast, lift 2.4 times: both are slowed by that.
    assert stretch == pytest.approx(3 * max(PAN_SPEED / SLOW["rad"], LIFT_SPEED / SLOW["m"]), rel=0.03)
    (note,) = notes
    assert note == f"slowed {stretch:.2f} times, to {replay.t_s[-1]:.0f} s, to keep to the joints' speeds"
    plan = plan_motion(Motion("m", (replay,), "stream"), (PAN, LIFT))
    t_s = np.linspace(0.2, LASTS_S / 3 - 0.2, 200)
    assert np.abs(replayed(plan, stretch * t_s) - slow_states(3 * t_s)).max() < 0.005
    speed = np.abs(np.diff(plan.commanded(np.arange(0.0, plan.duration_s, 0.001)), axis=0)).max(axis=0) / 0.001
    assert np.all(speed <= np.array([SLOW["rad"], SLOW["m"]]) * (1 + 1e-6))


def test_speeds_that_are_asked_for_slow_a_replay_or_let_it_go_quicker():
    log = record(quicker=2.0)
    slow, quick = (replay_of(log, (PAN, LIFT), {"rad": rad, "m": m})[0] for rad, m in ((0.1, 0.02), (2.0, 0.2)))
    assert slow.t_s[-1] == pytest.approx(LASTS_S * LIFT_SPEED / 0.02, rel=0.03)
    assert quick.t_s[-1] == pytest.approx(LASTS_S / 2, rel=0.01)


def test_states_beyond_a_limit_are_kept_within_it_and_gaps_are_bridged():
    log = record()
    q = log.q.copy()
    q[200:230, 0] = np.nan
    narrow = JointLimits("pan", -0.1, 1.5, 2.0, park=0.5)
    replay, (note,) = replay_of(JointLog(log.t_s, log.joints, q, log.units), (narrow, LIFT))
    assert note == "pan was 5.7 deg beyond its limits: it is kept within them"
    assert replay.q[:, 0].min() == pytest.approx(-0.1, abs=1e-4) and np.all(np.isfinite(replay.q))
    plan_motion(Motion("m", (replay,), "stream"), (narrow, LIFT))


def test_a_joint_that_isnt_recorded_stays_where_it_was_left():
    log = record()
    replay, _ = replay_of(JointLog(log.t_s, ("lift",), log.q[:, 1:], ("m",)), (PAN, LIFT))
    plan = plan_motion(Motion("m", (MotionStep({"pan": -0.3}), replay), "stream"), (PAN, LIFT))
    t_s = np.linspace(0.5, LASTS_S - 0.5, 50)
    np.testing.assert_allclose(replayed(plan, t_s)[:, 0], -0.3, atol=1e-12)


def test_records_that_cant_be_replayed_are_refused_with_what_is_missing():
    log = record()
    with pytest.raises(InvalidData, match="no joint 'lift'; the rig has pan"):
        replay_of(log, (PAN,))
    with pytest.raises(InvalidData, match=r"1 joint states are too little to replay; want 0\.5 s or more"):
        replay_of(JointLog(log.t_s[:1], log.joints, log.q[:1], log.units), (PAN, LIFT))
    never = np.column_stack([log.q[:, 0], np.full(len(log.t_s), np.nan)])
    with pytest.raises(InvalidData, match="joint 'lift' has no state in the recording; leave its column out"):
        replay_of(JointLog(log.t_s, log.joints, never, log.units), (PAN, LIFT))
    with pytest.raises(InvalidData, match="no numbers; leave those times out"):
        Replay(("pan",), np.array([0.0, 1.0]), np.array([[0.0], [np.nan]]))
    with pytest.raises(InvalidData, match="want two times or more"):
        Replay(("pan",), np.array([0.0]), np.array([[0.0]]))


def write_session(folder: Path, log: JointLog | None) -> Path:
    """A session of these joints whose servos reported the log."""
    about = describe(camera=CAMERA, markers=MARKERS, joints=("pan", "lift"), units=("rad", "m"))
    with RecordingWriter(folder, about, start_ns=START_NS) as writer:
        for t_s, q in [] if log is None else zip(log.t_s, log.q, strict=True):
            t_ns = START_NS + round(1e9 * t_s)
            writer.log_reading(t_ns - 100_000, t_ns + 100_000, q)
        writer.close("complete", {})
    return folder


def write_csv(path: Path, log: JointLog) -> Path:
    """The log as a commands.csv with a column a joint."""
    rows = [",".join(map(repr, row)) for row in np.column_stack([log.t_s, log.q]).tolist()]
    path.write_text("\n".join([",".join(["t_s", *log.joints]), *rows]) + "\n")
    return path


def write_naming(path: Path, file: str, more: str = "") -> Path:
    """A motion.toml that names a recording."""
    text = f'schema = "motion/1"\nname = "again"\nmode = "stream"\n[[step]]\nreplay = {{ file = "{file}" }}\n'
    path.write_text(text + more)
    return path


@pytest.mark.parametrize("kind", ["session", "csv", "toml with session", "toml with csv"])
def test_a_session_and_a_table_are_motions_and_so_are_files_that_name_them(kind: str, tmp_path: Path) -> None:
    log = record(tremor=0.01)
    source = write_session(tmp_path / "by_hand", log)
    if kind.endswith("csv"):
        source = write_csv(tmp_path / "commands.csv", log)
    if kind.startswith("toml"):
        text = (
            f'schema = "motion/1"\nname = "again"\nmode = "stream"\n[[step]]\nreplay = {{ file = "{source.name}" }}\n'
        )
        source = tmp_path / "motion.toml"
        source.write_text(text)
    motion, text = read_motion(str(source), (PAN, LIFT))
    plan = plan_motion(motion, (PAN, LIFT))
    t_s = np.linspace(0.5, LASTS_S - 0.5, 100)
    assert np.abs(replayed(plan, t_s) - slow_states(t_s)).max() < 2e-3  # times of readings are to a microsecond
    # What the session keeps is all of it: the same to the bit without the recording.
    again = plan_motion(parse_motion(text, "kept", (PAN, LIFT)), (PAN, LIFT))
    np.testing.assert_array_equal(again.commanded(t_s), plan.commanded(t_s))


def test_what_was_changed_in_a_recording_is_noted_with_its_name(tmp_path: Path):
    source = write_csv(tmp_path / "quick.csv", record(quicker=3.0))
    motion, _ = read_motion(str(source), (PAN, LIFT))
    assert motion.name == "replay of quick.csv" and motion.notes[0].startswith("slowed 2.")
    named = write_naming(tmp_path / "named.toml", "quick.csv", "hold_s = 0.5\n")
    motion, text = read_motion(str(named), (PAN, LIFT))
    assert motion.notes[0].startswith("quick.csv: slowed 2.") and "hold_s = 0.5" in text


def refused(source: Path | str, joints: tuple[JointLimits, ...] = (PAN, LIFT)) -> str:
    """What is said of a source that can't be read."""
    with pytest.raises(StationError) as error:
        read_motion(str(source), joints)
    assert isinstance(error.value, InvalidFile)
    return str(error.value)


def test_sources_that_arent_there_or_are_wrong_are_refused_with_their_name(tmp_path: Path):
    assert "packaged ones are combined, " in refused("each_jiont")
    assert "gone.csv" in refused(tmp_path / "gone.csv")
    (tmp_path / "empty").mkdir()
    assert "empty" in refused(tmp_path / "empty")
    silent = write_session(tmp_path / "silent", None)
    assert "silent has no read-back of servos" in refused(silent) and "--hand --out DIR" in refused(silent)
    good = write_csv(tmp_path / "good.csv", record())
    assert f"{good}: no joint 'lift'; the rig has pan" == refused(good, (PAN,))
    bad = tmp_path / "bad.csv"
    bad.write_text("t_s,pan\n0.0,0.1\n1.0,much\n")
    assert "bad.csv" in refused(bad) and "much" in refused(bad)
    short = write_csv(tmp_path / "short.csv", JointLog(np.array([0.0, 0.1]), ("pan",), np.zeros((2, 1)), ("rad",)))
    assert refused(short) == f"{short}: 2 joint states are too little to replay; want 0.5 s or more"
    assert "gone" in refused(write_naming(tmp_path / "named.toml", "gone"))


def test_what_was_changed_is_told_by_the_plan_and_while_it_is_captured(station, tmp_path: Path):
    t_s = np.linspace(0.0, 1.0, 51)
    quick = JointLog(t_s, ("base_pan",), 0.2 * (1 - np.cos(2 * np.pi * t_s))[:, None], ("rad",))
    source = write_csv(tmp_path / "quick.csv", quick)
    told = "slowed 3."
    code, _, said = station("plan", "demo", source)
    assert code == 0 and f"note: {told}" in said
    _, text, _ = station("plan", "demo", source, "--json")
    assert json.loads(text)["notes"][0].startswith(told)
    writer = Writer()
    with demo_rig() as rig:
        Capture(with_camera(rig, NoFrames(rig)), planning.plan("demo", str(source)), writer).run()
    assert any(event.startswith(f"WARN {told}") for event in writer.events)
