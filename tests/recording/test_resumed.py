"""A session that was interrupted or killed goes on, as one recording on one clock."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from drivers.safety import ServoState
from station.errors import InvalidFile, StationError
from station.recording import Recording, RecordingWriter, SessionBusy
from station.session import Checkpoint, read_status, recording_pieces, write_status
from tests.made_sessions import START_NS, MadeFrame, describe, log_frame, make_frames

FIRST, SECOND = 12, 8
# The second program's clock starts anew, as after a reboot.
NOW_NS = 5_000_000


@pytest.fixture(scope="module")
def frames() -> list[MadeFrame]:
    return make_frames(FIRST + SECOND)


def begin(folder: Path, frames: list[MadeFrame], started: datetime | None = None) -> Path:
    """An interrupted session of these frames."""
    about = describe(started=started or datetime.now(UTC))
    with RecordingWriter(folder, about, start_ns=START_NS) as writer:
        for frame in frames:
            log_frame(writer, frame)
        writer.close("interrupted", {"dropped_frames": 3})
    return folder


def test_stamps_go_on_on_the_sessions_clock(tmp_path: Path, frames: list[MadeFrame]) -> None:
    folder = begin(tmp_path / "s", frames[:FIRST])
    before = Recording.load(folder)
    with RecordingWriter.resume(folder, now_ns=NOW_NS, since_last_s=2.5) as writer:
        writer.log_command(NOW_NS, np.zeros(3))
        writer.log_reading(NOW_NS + 10, NOW_NS + 30, np.ones(3), [NOW_NS + 15, NOW_NS + 20, NOW_NS + 25])
        writer.log_servos(NOW_NS + 40, {1: ServoState(0, 1.0, 2.0, 3.0, 4.0)})
    after = Recording.load(folder)
    resumed_s = before.duration_s + 2.5
    # 2 ns: the last time is a float64 of some seconds, and is rounded to a nanosecond once more.
    assert after.commanded.t_s[-1] == pytest.approx(resumed_s, abs=2e-9)
    assert after.measured.t_s[-1] == pytest.approx(resumed_s + 20e-9, abs=2e-9)
    assert after.servos.t_s[-1] == pytest.approx(resumed_s + 40e-9, abs=2e-9)
    resumed_ns = after.start_ns + round(after.commanded.t_s[-1] * 1e9)
    assert after.stamps_ns[-1].tolist() == [resumed_ns + 10, resumed_ns + 30]
    assert after.recording_id == before.recording_id and after.start_ns == START_NS
    assert after.measured.q[:FIRST].tobytes() == before.measured.q.tobytes()


def test_frame_numbers_and_images_go_on(tmp_path: Path, frames: list[MadeFrame]) -> None:
    folder = begin(tmp_path / "s", frames[:FIRST])
    last = frames[FIRST - 1].index
    with RecordingWriter.resume(folder, now_ns=NOW_NS) as writer:
        for k, frame in enumerate(frames[FIRST:]):
            writer.log_frame(k, NOW_NS + k * 1000, frame.image, frame.markers)
    recording = Recording.load(folder)
    assert recording.frame_index.tolist()[FIRST:] == [last + 1 + k for k in range(SECOND)]
    assert len(list(recording.frame_jpegs())) == FIRST + SECOND
    first_s, second_s = recording.observations.t_s[[FIRST - 1, FIRST]]
    assert first_s < second_s
    assert recording.frame_jpeg(FIRST + 2) != recording.frame_jpeg(2)


@pytest.mark.parametrize("started", [datetime.now(UTC) + timedelta(days=3), datetime.now(UTC) - timedelta(days=400)])
def test_a_wall_clock_that_jumped_does_no_harm(tmp_path: Path, frames: list[MadeFrame], started: datetime) -> None:
    folder = begin(tmp_path / "s", frames[:FIRST], started)
    last_s = Recording.load(folder).duration_s
    with RecordingWriter.resume(folder, now_ns=NOW_NS) as writer:
        writer.log_event(NOW_NS, "INFO", "on again")
    assert Recording.load(folder).events[-1].text == "on again"
    assert Recording.load(folder).events[-1].t_s > last_s


def test_counts_add_up_and_each_start_is_noted(tmp_path: Path, frames: list[MadeFrame]) -> None:
    folder = begin(tmp_path / "s", frames[:FIRST])
    with RecordingWriter.resume(folder, now_ns=NOW_NS, since_last_s=1.0) as writer:
        assert read_status(folder).state == "recording"
        writer.log_command(NOW_NS, np.zeros(3))
        writer.close("complete", {"dropped_frames": 2, "bus_errors": 1})
    status = read_status(folder)
    counts = {"frames": FIRST, "commands": FIRST + 1, "readings": FIRST, "events": FIRST}
    assert status.counts == {**counts, "dropped_frames": 5, "bus_errors": 1}
    assert status.state == "complete"
    assert [start.elapsed_s > 0 for start in status.starts] == [False, True]


def test_a_session_goes_on_more_than_once(tmp_path: Path, frames: list[MadeFrame]) -> None:
    folder = begin(tmp_path / "s", frames[:FIRST])
    for k in range(3):
        with RecordingWriter.resume(folder, now_ns=NOW_NS) as writer:
            writer.log_event(NOW_NS, "INFO", f"again {k}")
    texts = [event.text for event in Recording.load(folder).events]
    assert texts[FIRST:] == ["again 0", "again 1", "again 2"]


def test_a_complete_session_does_not_go_on(tmp_path: Path) -> None:
    RecordingWriter(tmp_path / "s", describe(), start_ns=0).close("complete")
    with pytest.raises(StationError, match="is complete"):
        RecordingWriter.resume(tmp_path / "s", now_ns=0)


def test_what_is_no_session_does_not_go_on(tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match=r"session\.json is missing"):
        RecordingWriter.resume(tmp_path, now_ns=0)


def test_a_session_that_is_being_recorded_is_kept_from_others(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    with RecordingWriter(folder, describe(), start_ns=0):
        with pytest.raises(SessionBusy, match="is being recorded"):
            RecordingWriter.resume(folder, now_ns=0)
        with pytest.raises(SessionBusy, match="is being recorded"):
            RecordingWriter(folder, describe(), start_ns=0, force=True)
        assert len(recording_pieces(folder)) == 1
    RecordingWriter.resume(folder, now_ns=0).close("complete")


# Checkpoints.


def test_a_checkpoint_is_in_session_json_with_the_counts_so_far(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    with RecordingWriter(folder, describe(), start_ns=0) as writer:
        assert read_status(folder).progress is None
        writer.log_command(0, np.zeros(3))
        writer.checkpoint(2, 9, {"bus_errors": 4})
        assert json.loads((folder / "session.json").read_text())["progress"] == {"leg": 2, "legs": 9}
        assert read_status(folder).counts["bus_errors"] == 4
        assert len(Recording.load(folder).commanded.t_s) == 1  # is in the file already
    with RecordingWriter.resume(folder, now_ns=0) as writer:
        assert writer.progress == Checkpoint(2, 9)


def test_a_session_json_from_before_checkpoints_is_read(tmp_path: Path, frames: list[MadeFrame]) -> None:
    folder = begin(tmp_path / "s", frames[:1])
    document = json.loads((folder / "session.json").read_text())
    del document["progress"], document["starts"]
    (folder / "session.json").write_text(json.dumps(document))
    assert read_status(folder).progress is None
    write_status(folder, read_status(folder))
