"""Sessions are read as they were written, to the last bit; cut and foreign ones are read or refused in words."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
import rerun as rr

from station.errors import InvalidData, InvalidFile, OutputExists, StationError
from station.kinematics.tree import Joint, KinematicTree
from station.logs import JointLog, PoseLog
from station.perception.observations import MARKER_SHAPES, FrameMarkers
from station.recording import Recording, RecordingWriter, append_detected
from station.recording.rrd_files import scan_framing
from station.session import SessionStatus, check_output_folder, read_status, write_status
from tests.made_sessions import (
    CAMERA,
    JOINTS,
    START_NS,
    MadeFrame,
    describe,
    log_frame,
    log_image,
    make_frames,
    make_session,
)

FRAMES = 24


@pytest.fixture(scope="module")
def frames() -> list[MadeFrame]:
    return make_frames(FRAMES)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, frames: list[MadeFrame]) -> Path:
    return make_session(tmp_path_factory.mktemp("made") / "session", frames)


@pytest.fixture(scope="module")
def recording(session: Path) -> Recording:
    return Recording.load(session)


def rrd(session: Path) -> Path:
    return session / "recording.rrd"


# What is written is what is read.


def test_observations_are_read_bit_for_bit(recording: Recording, frames: list[MadeFrame]) -> None:
    seen = recording.observations
    np.testing.assert_array_equal(seen.marker_id, np.concatenate([f.markers.marker_id for f in frames]))
    assert seen.corners_px.tobytes() == np.concatenate([f.markers.corners_px for f in frames]).tobytes()
    covariances = np.concatenate([f.markers.corner_covariance_px2 for f in frames])
    assert seen.corner_covariance_px2.tobytes() == covariances.tobytes()
    assert seen.T_cam_marker.tobytes() == np.concatenate([f.markers.T_cam_marker for f in frames]).tobytes()
    assert seen.rms_px.tobytes() == np.concatenate([f.markers.rms_px for f in frames]).tobytes()


def test_frames_without_markers_are_read_too(recording: Recording, frames: list[MadeFrame]) -> None:
    counts = np.bincount(recording.observations.frame, minlength=FRAMES)
    assert counts.tolist() == [len(f.markers) for f in frames]
    assert 0 in counts


def test_stamps_are_read_to_the_nanosecond(recording: Recording, frames: list[MadeFrame]) -> None:
    assert recording.frame_ns.tolist() == [f.t_ns for f in frames]
    assert recording.frame_index.tolist() == [f.index for f in frames]
    assert recording.stamps_ns.tolist() == [[f.request_ns, f.reply_ns] for f in frames]


def test_states_are_read_bit_for_bit(recording: Recording, frames: list[MadeFrame]) -> None:
    assert recording.commanded.q.tobytes() == np.stack([f.command for f in frames]).tobytes()
    assert recording.measured.q.tobytes() == np.stack([f.reading for f in frames]).tobytes()
    assert recording.commanded.joints == JOINTS
    assert recording.measured.units == ("rad", "rad", "m")


def test_times_are_seconds_from_the_start_of_the_session(recording: Recording, frames: list[MadeFrame]) -> None:
    # 1e-12 s: float64 at some seconds rounds to 1e-16 s of each operation.
    middles_s = [((f.request_ns - START_NS) + (f.reply_ns - START_NS)) / 2e9 for f in frames]
    np.testing.assert_allclose(recording.measured.t_s, middles_s, rtol=0, atol=1e-12)
    np.testing.assert_allclose(recording.observations.t_s, [(f.t_ns - START_NS) / 1e9 for f in frames], atol=1e-12)
    np.testing.assert_allclose(
        recording.commanded.t_s, [(f.request_ns - 1 - START_NS) / 1e9 for f in frames], atol=1e-12
    )


def test_the_description_is_read_as_written(recording: Recording) -> None:
    assert recording.description == describe()
    assert recording.start_ns == START_NS
    assert recording.notices == ()


def test_events_are_read_in_order(recording: Recording, frames: list[MadeFrame]) -> None:
    assert [e.text for e in recording.events] == [f"frame {f.index}" for f in frames]
    assert {e.level for e in recording.events} == {"INFO"}


def test_a_frame_is_read_back_as_its_jpeg(recording: Recording, frames: list[MadeFrame]) -> None:
    row = 17
    _, jpeg = cv2.imencode(".jpg", frames[row].image, [cv2.IMWRITE_JPEG_QUALITY, 92])
    assert recording.frame_jpeg(row) == jpeg.tobytes()
    np.testing.assert_array_equal(recording.frame_image(row), cv2.imdecode(jpeg, cv2.IMREAD_COLOR))


def test_a_frame_that_is_not_there_is_refused(recording: Recording) -> None:
    with pytest.raises(InvalidData, match=f"no frame {FRAMES}"):
        recording.frame_jpeg(FRAMES)


def test_grey_images_and_ready_jpegs_are_taken(tmp_path: Path, frames: list[MadeFrame]) -> None:
    grey = frames[0].image[..., 0].copy()
    ready = cv2.imencode(".jpg", grey)[1].tobytes()
    none = FrameMarkers(**{name: np.zeros((0, *shape)) for name, shape in MARKER_SHAPES.items()})
    with RecordingWriter(tmp_path / "s", describe(), start_ns=0) as writer:
        for index, image in enumerate((grey, ready)):
            writer.log_frame(index, index, image, none)
    recording = Recording.load(tmp_path / "s")
    assert recording.frame_image(0).shape == (48, 64, 3)
    assert recording.frame_jpeg(1) == ready


def test_two_runs_record_the_same(tmp_path: Path, recording: Recording, frames: list[MadeFrame]) -> None:
    again = Recording.load(make_session(tmp_path / "again", frames))
    assert again.description == recording.description
    assert again.events == recording.events
    assert again.measured.t_s.tobytes() == recording.measured.t_s.tobytes()
    assert again.observations.corners_px.tobytes() == recording.observations.corners_px.tobytes()
    assert again.frame_jpeg(5) == recording.frame_jpeg(5)


def test_a_session_without_rig_and_commands_is_read(tmp_path: Path, frames: list[MadeFrame]) -> None:
    about = describe(rig=None, motion=None, joints=(), units=(), seed=None)
    with RecordingWriter(tmp_path / "s", about, start_ns=START_NS) as writer:
        log_image(writer, frames[0])
    recording = Recording.load(tmp_path / "s")
    assert recording.description == about
    assert recording.frames == 1
    assert recording.commanded.q.shape == (0, 0)
    assert not (tmp_path / "s" / "rig.toml").exists()


def test_a_session_of_nothing_but_its_start_is_read(tmp_path: Path) -> None:
    RecordingWriter(tmp_path / "s", describe(), start_ns=START_NS).close("interrupted")
    recording = Recording.load(tmp_path / "s")
    assert recording.frames == 0
    assert recording.measured.q.shape == (0, len(JOINTS))
    assert len(recording.observations) == 0


def test_stamps_before_the_start_are_kept(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "s", describe(), start_ns=START_NS) as writer:
        writer.log_command(START_NS - 5, np.zeros(3))
    assert Recording.load(tmp_path / "s").commanded.t_s.tolist() == [-5e-9]


def test_of_two_commands_at_one_time_the_last_counts(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "s", describe(), start_ns=START_NS) as writer:
        writer.log_command(START_NS + 1, np.full(3, 1.0))
        writer.log_command(START_NS + 1, np.full(3, 2.0))
    assert Recording.load(tmp_path / "s").commanded.q.tolist() == [[2.0, 2.0, 2.0]]


@pytest.mark.parametrize("size", [2, 4])
def test_states_of_other_joints_are_refused(tmp_path: Path, size: int) -> None:
    with RecordingWriter(tmp_path / "s", describe(), start_ns=0) as writer:
        with pytest.raises(InvalidData, match="a command has shape"):
            writer.log_command(0, np.zeros(size))
        with pytest.raises(InvalidData, match="event level 'LOUD'"):
            writer.log_event(0, "LOUD", "text")


# The folder and session.json.


def test_session_json_says_what_became_of_the_session(tmp_path: Path, frames: list[MadeFrame]) -> None:
    folder = tmp_path / "s"
    with RecordingWriter(folder, describe(), start_ns=START_NS) as writer:
        log_frame(writer, frames[0])
        during = read_status(folder)
        writer.close("complete", {"dropped_frames": 3})
        writer.close("interrupted")  # the second is too late
    after = read_status(folder)
    assert (during.state, during.ended) == ("recording", None)
    assert after.state == "complete"
    assert after.counts == {"frames": 1, "commands": 1, "readings": 1, "events": 1, "dropped_frames": 3}
    assert after.recording_id == Recording.load(folder).recording_id
    assert after.started == describe().started
    assert after.seed == 11


def test_an_exception_leaves_an_interrupted_session(tmp_path: Path, frames: list[MadeFrame]) -> None:
    folder = tmp_path / "s"
    with pytest.raises(ZeroDivisionError), RecordingWriter(folder, describe(), start_ns=START_NS) as writer:
        log_frame(writer, frames[0])
        raise ZeroDivisionError
    assert read_status(folder).state == "interrupted"
    assert Recording.load(folder).frames == 1


def test_rig_and_motion_are_copied(session: Path) -> None:
    assert (session / "rig.toml").read_text(encoding="utf-8") == describe().rig
    assert (session / "motion.toml").read_text(encoding="utf-8") == describe().motion


def test_a_recording_is_not_overwritten(session: Path) -> None:
    before = rrd(session).read_bytes()
    with pytest.raises(OutputExists, match=r"recording\.rrd exists"):
        RecordingWriter(session, describe(), start_ns=0)
    assert rrd(session).read_bytes() == before


def test_force_leaves_nothing_of_the_session_before(tmp_path: Path, frames: list[MadeFrame]) -> None:
    folder = make_session(tmp_path / "s", frames[:1])
    (folder / "report").mkdir()
    (folder / "report" / "report.html").write_text("old")
    (folder / "notes.txt").write_text("the person's own")
    with RecordingWriter(folder, describe(), start_ns=START_NS, force=True) as writer:
        assert not (folder / "report").exists()
        assert read_status(folder).state == "recording"
        writer.close("complete")
    assert Recording.load(folder).frames == 0
    assert (folder / "notes.txt").exists()


def test_an_output_folder_is_new_or_empty(tmp_path: Path) -> None:
    full, file = tmp_path / "full", tmp_path / "file"
    full.mkdir()
    (full / "x").write_text("")
    file.write_text("")
    check_output_folder(tmp_path / "new")
    check_output_folder(full, force=True)
    with pytest.raises(OutputExists, match="isn't empty"):
        check_output_folder(full)
    with pytest.raises(OutputExists, match="is a file"):
        check_output_folder(file, force=True)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no JSON"),
        ("[]", "schema None"),
        ('{"schema": "session/2"}', "session/2"),
        ('{"schema": "session/1"}', "started"),
    ],
)
def test_a_wrong_session_json_is_refused(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "session.json").write_text(text)
    with pytest.raises(InvalidFile, match=says):
        read_status(tmp_path)


def test_session_json_is_strict_json_and_reads_back(tmp_path: Path) -> None:
    status = SessionStatus("complete", "abc", datetime(2024, 1, 2, tzinfo=UTC), counts={"frames": 3})
    write_status(tmp_path, status)
    document = json.loads((tmp_path / "session.json").read_text(), parse_constant=pytest.fail)
    assert document["schema"] == "session/1"
    assert read_status(tmp_path) == status
    with pytest.raises(InvalidFile, match="'done'"):
        replace(status, state="done")


# What stops a recording.


def test_rerun_off_in_the_environment_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(StationError, match="RERUN=off"):
        RecordingWriter(tmp_path / "s", describe(), start_ns=0)
    assert not (tmp_path / "s").exists()


def test_nothing_is_logged_after_closing(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "s", describe(), start_ns=0)
    writer.close("complete")
    with pytest.raises(StationError, match="is closed"):
        writer.log_command(0, np.zeros(3))


def test_a_bad_camera_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match=r"camera\.toml"):
        RecordingWriter(tmp_path / "s", describe(camera=CAMERA.replace("size_px", "size")), start_ns=0)
    assert not (tmp_path / "s").exists()


FULL_DISK = """
import resource, sys
from pathlib import Path
from tests.made_sessions import START_NS, describe, log_frame, make_frames
from station.errors import StationError
from station.recording import RecordingWriter
frames = make_frames(60)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))  # a file may not grow beyond this, as on a full disk
try:
    with RecordingWriter(Path(sys.argv[1]), describe(), start_ns=START_NS) as writer:
        for frame in frames:
            log_frame(writer, frame)
            if frame.index % 10 == 0:
                writer.flush()
except StationError as error:
    print(error)
"""

KILLED = """
import os, sys
from pathlib import Path
from tests.made_sessions import START_NS, describe, log_frame, make_frames
from station.recording import RecordingWriter
frames = make_frames(60)
writer = RecordingWriter(Path(sys.argv[1]), describe(), start_ns=START_NS)
for frame in frames[:40]:
    log_frame(writer, frame)
writer.flush()
print("flushed", flush=True)
while True:
    for frame in frames[40:]:
        log_frame(writer, frame)
"""


@contextmanager
def running(script: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that records into the folder; killed at the end if it still does."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    command = [sys.executable, "-c", script, str(folder)]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def test_a_full_disk_is_an_error_and_what_was_written_is_read(tmp_path: Path) -> None:
    with running(FULL_DISK, tmp_path / "s") as writing:
        said, _ = writing.communicate(timeout=60)
    assert writing.returncode == 0
    assert "recording.rrd can't be written" in said
    assert read_status(tmp_path / "s").state == "interrupted"
    recording = Recording.load(tmp_path / "s")
    assert 0 < recording.frames < 60
    assert recording.notices


def test_a_killed_session_holds_what_was_flushed(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    with running(KILLED, folder) as writing:
        assert writing.stdout is not None
        assert writing.stdout.readline() == "flushed\n"
        writing.send_signal(signal.SIGKILL)
    assert read_status(folder).state == "recording"
    recording = Recording.load(folder)
    frames = make_frames(60)
    assert recording.frames >= 40
    assert recording.frame_ns[:40].tolist() == [f.t_ns for f in frames[:40]]
    assert recording.measured.q[:40].tobytes() == np.stack([f.reading for f in frames[:40]]).tobytes()
    assert recording.frame_jpeg(39)
    assert "recording.rrd" in recording.notices[0]


# Torn and foreign files.


@pytest.fixture(scope="module")
def flushed(tmp_path_factory: pytest.TempPathFactory, frames: list[MadeFrame]) -> tuple[bytes, list[int]]:
    """A recording with a flush after each frame, and its size after each."""
    folder = tmp_path_factory.mktemp("flushed") / "s"
    sizes = []
    with RecordingWriter(folder, describe(), start_ns=START_NS) as writer:
        sizes.append(rrd(folder).stat().st_size)
        for frame in frames:
            log_frame(writer, frame)
            writer.flush()
            sizes.append(rrd(folder).stat().st_size)
        writer.close("complete")
    return rrd(folder).read_bytes(), sizes


def cuts() -> list[float]:
    rng = np.random.default_rng(5)
    return [0.0, 1.0, *rng.random(40).tolist()]


@pytest.mark.parametrize("share", cuts())
def test_a_cut_recording_holds_all_that_was_flushed_before_the_cut(
    tmp_path: Path, flushed: tuple[bytes, list[int]], frames: list[MadeFrame], share: float
) -> None:
    content, sizes = flushed
    cut = sizes[0] + round(share * (len(content) - 1 - sizes[0]))
    path = tmp_path / "cut.rrd"
    path.write_bytes(content[:cut])
    recording = Recording.load(path)
    whole = sum(size <= cut for size in sizes) - 1
    assert whole <= recording.frames <= whole + 1
    assert recording.frame_ns[:whole].tolist() == [f.t_ns for f in frames[:whole]]
    assert "cut.rrd" in recording.notices[0]
    assert path.read_bytes() == content[:cut]


@pytest.mark.parametrize("share", np.random.default_rng(6).random(12).tolist())
def test_a_recording_cut_at_its_start_is_read_or_refused(
    tmp_path: Path, flushed: tuple[bytes, list[int]], share: float
) -> None:
    content, sizes = flushed
    path = tmp_path / "cut.rrd"
    path.write_bytes(content[: int(share * sizes[0])])
    try:
        assert Recording.load(path).frames == 0
    except InvalidFile as error:
        assert "cut.rrd" in str(error)


def test_a_tail_of_zeros_is_left_out(tmp_path: Path, flushed: tuple[bytes, list[int]]) -> None:
    content, sizes = flushed
    path = tmp_path / "zeros.rrd"
    path.write_bytes(content[: sizes[9]] + bytes(5000))
    recording = Recording.load(path)
    assert recording.frames == 9
    assert "5000 bytes left out" in recording.notices[0]


def test_a_recording_with_a_damaged_index_is_read_without_it(tmp_path: Path, session: Path) -> None:
    content = bytearray(rrd(session).read_bytes())
    body = scan_framing(rrd(session)).body
    content[body + 1000 : body + 1100] = bytes(100)
    path = tmp_path / "damaged.rrd"
    path.write_bytes(content)
    recording = Recording.load(path)
    assert recording.frames == FRAMES
    assert "without its index" in recording.notices[0]
    assert recording.frame_jpeg(3)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"RRF2", "is no recording"),
        (b"t_s,part,x_m\n0,lid,1\n", "is no recording"),
        (b"RRF2\0\x29\0\0\1\2\0\0", "cut before anything"),
        (b"RRF2\0\x29\0\0\1\2\0\0" + bytes(range(256)), "cut before anything"),
    ],
)
def test_garbage_is_refused_with_the_files_name(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "garbage.rrd"
    path.write_bytes(content)
    with pytest.raises(InvalidFile, match=says) as refused:
        Recording.load(path)
    assert "garbage.rrd" in str(refused.value)


def test_a_missing_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match=r"recording\.rrd is missing"):
        Recording.load(tmp_path)


def foreign(path: Path, schema: str | None = None) -> Path:
    """A rerun file of another program."""
    stream = rr.RecordingStream("other")
    stream.set_sinks(rr.FileSink(path))
    stream.log("text", rr.TextLog("hello"))
    if schema is not None:
        stream.send_property("station", rr.AnyValues(schema=schema))
    stream.flush()
    stream.disconnect()
    return path


def test_another_programs_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match="no session's description"):
        Recording.load(foreign(tmp_path / "other.rrd"))


def test_another_schema_is_refused_saying_which_are_read(tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match="'session/9'; this station reads session/1"):
        Recording.load(foreign(tmp_path / "other.rrd", schema="session/9"))


def test_a_recording_is_read_while_it_is_written(tmp_path: Path, frames: list[MadeFrame]) -> None:
    with RecordingWriter(tmp_path / "s", describe(), start_ns=START_NS) as writer:
        log_frame(writer, frames[0])
        writer.flush()
        recording = Recording.load(tmp_path / "s")
        assert recording.frames == 1
        assert "not closed" in recording.notices[0]


# The fit beside it.


def test_the_fit_beside_a_recording_has_its_identity(tmp_path: Path, frames: list[MadeFrame]) -> None:
    from rerun.chunk import RrdReader

    folder = make_session(tmp_path / "s", frames[:4])
    t_s = Recording.load(folder).observations.t_s
    q = np.array([[1.0, 2.0], [np.nan, 3.0], [1.5, 2.5], [0.0, -1.0]])
    path = append_detected(folder, JointLog(t_s, ("shoulder", "base__lid"), q, ("rad", "rad")))
    assert path == folder / "fit" / "fit.rrd"
    (fit,) = RrdReader(path).recordings()
    (session,) = RrdReader(rrd(folder)).recordings()
    assert (fit.application_id, fit.recording_id) == (session.application_id, session.recording_id)
    (chunk,) = RrdReader(path).stream().filter(content="/joints/detected", is_static=False)
    shown = np.array(chunk.to_record_batch().column("Scalars:scalars").to_pylist())
    # The session's joints come first, in its order; what wasn't detected is NaN.
    np.testing.assert_array_equal(shown, np.stack([q[:, 0] * np.nan, q[:, 0], q[:, 0] * np.nan, q[:, 1]], axis=1))


def test_a_fit_is_replaced_by_the_next(tmp_path: Path, frames: list[MadeFrame]) -> None:
    folder = make_session(tmp_path / "s", frames[:2])
    t_s = Recording.load(folder).observations.t_s
    for q in (1.0, 2.0):
        append_detected(folder, JointLog(t_s, ("shoulder",), np.full((2, 1), q), ("rad",)))
    assert [path.name for path in (folder / "fit").iterdir()] == ["fit.rrd"]


def test_the_fit_draws_an_axis_where_its_parent_was_seen(tmp_path: Path, frames: list[MadeFrame]) -> None:
    from rerun.chunk import RrdReader

    folder = make_session(tmp_path / "s", frames[:3])
    t_s = Recording.load(folder).observations.t_s
    T = np.tile(np.eye(4), (3, 2, 1, 1))
    T[:, 0, :3, 3] = (0.5, 0.25, 1.0)
    T[1, 0] = np.nan
    hinge = Joint("hinge", "revolute", "base", "lid", np.array([0.0, 0.0, 1.0]), np.array([0.25, 0.0, 0.0]), np.eye(4))
    tree = KinematicTree("base", ("base", "lid"), (), (("base", "lid"),), (hinge,))
    detected = JointLog(t_s, ("hinge",), np.zeros((3, 1)), ("rad",))
    path = append_detected(folder, detected, tree, PoseLog(t_s, "camera", ("base", "lid"), T))
    (chunk,) = RrdReader(path).stream().filter(content="/fit/axes/hinge", is_static=False)
    rows = chunk.to_record_batch()
    middle = (
        np.array(rows.column("Arrows3D:origins").to_pylist())
        + np.array(rows.column("Arrows3D:vectors").to_pylist()) / 2
    )
    np.testing.assert_allclose(middle.reshape(-1, 3), [(0.75, 0.25, 1.0)] * 2, atol=1e-6)  # m; the viewer has float32


def test_the_fit_draws_the_centre_of_a_ball_and_a_series_for_each_of_its_states(
    tmp_path: Path, frames: list[MadeFrame]
) -> None:
    from rerun.chunk import RrdReader

    folder = make_session(tmp_path / "s", frames[:2])
    t_s = Recording.load(folder).observations.t_s
    T = np.tile(np.eye(4), (2, 2, 1, 1))
    T[:, 0, :3, 3] = (0.5, 0.25, 1.0)
    ball = Joint("ball", "spherical", "base", "lid", None, np.array([0.25, 0.0, 0.0]), np.eye(4))
    tree = KinematicTree("base", ("base", "lid"), (), (("base", "lid"),), (ball,))
    detected = JointLog(t_s, tree.columns, np.zeros((2, 3)), ("rad",) * 3)
    path = append_detected(folder, detected, tree, PoseLog(t_s, "camera", ("base", "lid"), T))
    (chunk,) = RrdReader(path).stream().filter(content="/fit/axes/ball", is_static=False)
    places = np.array(chunk.to_record_batch().column("Points3D:positions").to_pylist())
    np.testing.assert_allclose(places.reshape(-1, 3), [(0.75, 0.25, 1.0)] * 2, atol=1e-6)  # m; the viewer has float32
    (names,) = RrdReader(path).stream().filter(content="/joints/detected", is_static=True)
    series = names.to_record_batch().column("SeriesLines:names").to_pylist()[0]
    assert [name for name in series if name.startswith("ball")] == [f"ball_{i} detected (rad)" for i in "xyz"]


def test_recordings_leave_no_more_threads_than_one_does(tmp_path: Path, frames: list[MadeFrame]) -> None:
    # rerun keeps a few native threads for the whole process; Python doesn't list them.
    def native_threads() -> int:
        return len(list(Path("/proc/self/task").iterdir()))

    counts = []
    for k in range(4):
        Recording.load(make_session(tmp_path / str(k), frames[:2]))
        counts.append(native_threads())
    assert counts[-1] <= counts[1]


def test_joints_read_one_after_the_other_are_brought_to_one_time(tmp_path: Path):
    """Two joints that turn alike at 1 rad/s, read 4 ms apart, agree once both are at the row's time."""
    about = describe(joints=("pan", "tilt"), units=("rad", "rad"))
    with RecordingWriter(tmp_path / "s", about, start_ns=0) as writer:
        for row in range(20):
            request_ns = row * 20_000_000
            own_ns = request_ns + np.array([1_000_000, 5_000_000])
            writer.log_reading(request_ns, request_ns + 6_000_000, own_ns * 1e-9, own_ns)
        writer.close("complete")
    measured = Recording.load(tmp_path / "s").measured
    np.testing.assert_allclose(measured.q[1:-1, 0], measured.t_s[1:-1], atol=1e-12)
    np.testing.assert_allclose(measured.q[1:-1, 1], measured.t_s[1:-1], atol=1e-12)


def test_a_recording_without_corner_covariances_is_read(tmp_path: Path, frames: list[MadeFrame], monkeypatch) -> None:
    older = {name: shape for name, shape in MARKER_SHAPES.items() if name != "corner_covariance_px2"}
    monkeypatch.setattr("station.recording.session_rows.MARKER_SHAPES", older)
    seen = Recording.load(make_session(tmp_path / "older", frames)).observations
    assert np.all(np.isnan(seen.corner_covariance_px2))
    assert seen.corners_px.tobytes() == np.concatenate([f.markers.corners_px for f in frames]).tobytes()
