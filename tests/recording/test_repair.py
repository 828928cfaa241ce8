"""What a kill left is repaired when it is opened; whatever goes wrong then, nothing is lost."""

from __future__ import annotations

import errno
import fcntl
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from station.errors import InvalidFile, StationError
from station.recording import Recording, RecordingWriter, opening, repair
from station.recording.lock import SessionLock
from station.recording.rrd_files import HEADER_BYTES, Framing, scan_framing
from station.recording.rrd_stream import RrdStream
from station.session import Checkpoint, read_status, recording_pieces
from tests.made_sessions import START_NS, MadeFrame, describe, log_frame, make_frames

FRAMES = 24


@pytest.fixture(scope="module")
def frames() -> list[MadeFrame]:
    return make_frames(FRAMES)


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory, frames: list[MadeFrame]) -> tuple[Path, list[int]]:
    """A folder as a kill leaves it, with a flush after each frame; and the size of its recording after each."""
    folder, left = tmp_path_factory.mktemp("left") / "recorded", tmp_path_factory.mktemp("left") / "s"
    sizes = []
    with RecordingWriter(folder, describe(), start_ns=START_NS) as writer:
        sizes.append((folder / "recording.rrd").stat().st_size)
        for frame in frames:
            log_frame(writer, frame)
            writer.flush()
            sizes.append((folder / "recording.rrd").stat().st_size)
        writer.checkpoint(3, 8, {"bus_errors": 2})
        shutil.copytree(folder, left)
    return left, sizes


@pytest.fixture
def killed(tmp_path: Path, left: tuple[Path, list[int]]) -> Path:
    return shutil.copytree(left[0], tmp_path / "s")


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_killed_session_is_repaired_on_opening_with_a_notice(killed: Path, frames: list[MadeFrame]) -> None:
    before = Recording.read(killed)
    recording = Recording.load(killed)
    assert [notice.split(";")[-1] for notice in recording.notices] == [" it was repaired"]
    assert scan_framing(killed / "recording.rrd").complete
    assert names(killed) == {"recording.rrd", "session.json", "rig.toml", "motion.toml"}
    assert recording.observations.corners_px.tobytes() == before.observations.corners_px.tobytes()
    assert recording.measured.q.tobytes() == np.stack([f.reading for f in frames]).tobytes()
    assert recording.recording_id == before.recording_id and recording.description == describe()
    assert Recording.load(killed).notices == ()
    assert recording.frame_jpeg(5) == before.frame_jpeg(5)


def test_session_json_is_corrected_on_opening(killed: Path) -> None:
    assert read_status(killed).state == "recording"
    recording = Recording.load(killed)
    status = read_status(killed)
    assert status.state == "interrupted" and status.progress == Checkpoint(3, 8)
    assert status.counts == {"frames": 24, "commands": 24, "readings": 24, "events": 24, "bus_errors": 2}
    assert status.ended is not None
    # 1 ms: session.json has no more digits.
    assert (status.ended - status.started).total_seconds() == pytest.approx(recording.duration_s, abs=1e-3)


def test_a_repaired_recording_has_the_viewers_layout(killed: Path) -> None:
    Recording.load(killed)
    assert len(RrdReader(killed / "recording.rrd").blueprints()) == 1


def ends(sizes: list[int]) -> Iterator[tuple[str, int, bytes]]:
    """Where a file may end: anywhere in a message's header and payload, at its end; with zeros or garbage after it."""
    rng = np.random.default_rng(3)
    for size in (sizes[0], sizes[7], sizes[-1]):
        for less in (0, 1, 15, 16, 17, 40, 400):
            yield f"{size} less {less}", size - less, b""
    for size in rng.integers(sizes[0], sizes[-1], 12).tolist():
        yield f"anywhere {size}", size, b""
        yield f"zeros {size}", size, bytes(3000)
        yield f"garbage {size}", size, rng.bytes(3000)
    yield "zeros at a message's end", sizes[9], bytes(5000)
    yield "garbage at a message's end", sizes[9], rng.bytes(5000)


def test_whatever_the_end_repair_keeps_all_that_could_be_read(
    tmp_path: Path, left: tuple[Path, list[int]], frames: list[MadeFrame]
) -> None:
    folder, sizes = left
    content = (folder / "recording.rrd").read_bytes()
    for name, size, tail in ends(sizes):
        torn = shutil.copytree(folder, tmp_path / name)
        (torn / "recording.rrd").write_bytes(content[:size] + tail)
        whole = max(0, sum(at <= size for at in sizes) - 1)
        recording = Recording.load(torn)
        assert whole <= recording.frames <= whole + 1, name
        assert recording.frame_ns[:whole].tolist() == [f.t_ns for f in frames[:whole]], name
        if "garbage" in name and "damaged" in recording.notices[0]:  # no kill leaves that: it stays as it is
            assert (torn / "recording.rrd").read_bytes() == content[:size] + tail, name
            continue
        assert "repaired" in recording.notices[0], name
        assert scan_framing(torn / "recording.rrd").complete, name
        assert Recording.load(torn).frames == recording.frames, name


@pytest.mark.parametrize("size", [0, 5, HEADER_BYTES, HEADER_BYTES + 7])
def test_a_file_that_was_hardly_begun_is_refused_and_left_as_it_is(killed: Path, size: int) -> None:
    path = killed / "recording.rrd"
    content = path.read_bytes()[:size]
    path.write_bytes(content)
    with pytest.raises(InvalidFile, match=r"recording\.rrd"):
        Recording.load(killed)
    assert path.read_bytes() == content


def test_a_repair_that_fails_changes_nothing(killed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = killed / "recording.rrd"
    content = path.read_bytes()[:-100]
    path.write_bytes(content)

    def full(*_: object) -> None:
        raise StationError("no room\nat all")

    with monkeypatch.context() as patch:
        patch.setattr(RrdStream, "flush", full)
        recording = Recording.load(killed)
    assert "couldn't be repaired, and is read as it is: no room" in recording.notices[0]
    assert path.read_bytes() == content
    assert names(killed) == {"recording.rrd", "session.json", "rig.toml", "motion.toml"}
    assert Recording.load(killed).frames == recording.frames


def test_without_room_nothing_is_begun(killed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(repair, "ROOM", 1e12)
    assert "MB are needed" in Recording.load(killed).notices[0]
    assert not scan_framing(killed / "recording.rrd").complete


def test_more_than_a_kill_leaves_is_not_cut_off(killed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(repair, "BATCH_BYTES", 100)
    path = killed / "recording.rrd"
    content = path.read_bytes() + bytes(200)
    path.write_bytes(content)
    assert "more than a kill leaves" in Recording.load(killed).notices[0]
    assert path.read_bytes() == content


@pytest.mark.parametrize("at", ["kind", "length"])
def test_damage_amid_a_file_is_not_taken_for_its_torn_end(killed: Path, left: tuple[Path, list[int]], at: str) -> None:
    path = killed / "recording.rrd"
    content = bytearray(path.read_bytes())
    start = left[1][5]  # where a message begins; whole ones follow
    content[start + {"kind": 0, "length": 8}[at] + 7] ^= 0x40  # one bit: an unknown kind, or longer than any message
    path.write_bytes(content)
    recording = Recording.load(killed)
    assert 0 < recording.frames < FRAMES and "damaged" in recording.notices[0]
    assert path.read_bytes() == content
    go_on(killed, "on again")
    assert path.read_bytes() == content
    assert Recording.load(killed).events[-1].text == "on again"


def test_a_file_without_a_lock_is_read_as_it_is(killed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def without(*_: object) -> None:
        raise OSError(errno.EINVAL, "Invalid argument")

    content = (killed / "recording.rrd").read_bytes()
    monkeypatch.setattr(fcntl, "flock", without)
    recording = Recording.load(killed)
    assert recording.frames == FRAMES and "no locks" in recording.notices[0]
    assert (killed / "recording.rrd").read_bytes() == content and read_status(killed).state == "recording"
    go_on(killed, "on again")  # who records is not kept from it


def test_who_reads_while_another_repairs_gets_all_of_it(killed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = killed / "recording.rrd"
    path.write_bytes(path.read_bytes()[:-100])
    expected = Recording.read(killed).frames
    scans: list[Path] = []

    def repaired_amid(path: Path) -> Framing:
        framing = scan_framing(path)
        scans.append(path)
        if len(scans) == 1:  # another program, just after this one looked
            repair.repair(killed)
        return framing

    monkeypatch.setattr(opening, "scan_framing", repaired_amid)
    recording = Recording.read(killed)
    assert recording.frames == expected and recording.notices == ()


def test_what_a_repair_that_was_killed_left_does_not_stand_in_the_next_ones_way(
    killed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = killed / "recording.joined.rrd.part"
    part.write_bytes(bytes(1 << 20))
    real = shutil.disk_usage

    def with_part(folder: Path) -> object:
        usage = real(folder)
        return usage._replace(free=0 if part.exists() else usage.free)

    monkeypatch.setattr(shutil, "disk_usage", with_part)
    assert "was repaired" in Recording.load(killed).notices[0]
    assert not part.exists()


def test_a_folder_that_is_being_written_is_read_as_it_is(killed: Path) -> None:
    content = (killed / "recording.rrd").read_bytes()
    with SessionLock(killed):
        assert Recording.load(killed).frames == FRAMES
    assert (killed / "recording.rrd").read_bytes() == content
    assert read_status(killed).state == "recording"


def test_a_read_only_folder_is_read_as_it_is(killed: Path, tmp_path: Path) -> None:
    mounted = tmp_path / "mounted"
    mounted.mkdir()
    try:
        subprocess.run(["mount", "--bind", killed, mounted], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"nothing can be mounted here: {error}")
    try:
        subprocess.run(["mount", "-o", "remount,bind,ro", mounted], check=True, capture_output=True)
        recording = Recording.load(mounted)
        assert recording.frames == FRAMES
        assert "couldn't be repaired, and is read as it is: Read-only file system" in recording.notices[0]
    finally:
        subprocess.run(["umount", mounted], check=True)
    assert read_status(killed).state == "recording"


# Pieces.


def go_on(folder: Path, text: str) -> None:
    with RecordingWriter.resume(folder, now_ns=5, since_last_s=1.0) as writer:
        writer.log_event(5, "INFO", text)


def test_pieces_are_joined_when_the_session_is_closed(killed: Path) -> None:
    with RecordingWriter.resume(killed, now_ns=5) as writer:
        writer.log_event(5, "INFO", "on again")
        assert [path.name for path in recording_pieces(killed)] == ["recording.rrd", "recording_1.rrd"]
        writer.close("complete")
    assert names(killed) == {"recording.rrd", "session.json", "rig.toml", "motion.toml"}
    recording = Recording.load(killed)
    assert recording.notices == () and recording.events[-1].text == "on again" and recording.frames == FRAMES


def test_pieces_that_could_not_be_joined_are_joined_on_opening(killed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(repair, "ROOM", 1e12)
        go_on(killed, "first")
        go_on(killed, "second")
        assert [path.name for path in Recording.load(killed).pieces] == [
            "recording.rrd",
            "recording_1.rrd",
            "recording_2.rrd",
        ]
    recording = Recording.load(killed)
    assert [path.name for path in recording.pieces] == ["recording.rrd"]
    assert [event.text for event in recording.events[FRAMES:]] == ["first", "second"]


@pytest.mark.parametrize("removed", [0, 1, 2])
def test_a_crash_while_joining_loses_nothing(
    killed: Path, monkeypatch: pytest.MonkeyPatch, removed: int, tmp_path: Path
) -> None:
    whole = shutil.copytree(killed, tmp_path / "whole")
    for text in ("first", "second"):
        go_on(whole, text)
    with monkeypatch.context() as patch:
        patch.setattr(repair, "ROOM", 1e12)
        go_on(killed, "first")
        go_on(killed, "second")
    # As it is right after the joined file took its name, and some of the pieces are gone.
    shutil.copy(whole / "recording.rrd", killed / "recording.joined.rrd")
    for piece in ("recording_1.rrd", "recording_2.rrd")[:removed]:
        (killed / piece).unlink()
    (killed / "recording.joined.rrd.part").write_bytes(b"half")
    assert [event.text for event in Recording.read(killed).events[FRAMES:]] == ["first", "second"]
    recording = Recording.load(killed)
    assert [event.text for event in recording.events[FRAMES:]] == ["first", "second"]
    assert [path.name for path in killed.glob("recording*.rrd")] == ["recording.rrd"]


def test_going_on_after_a_crash_while_joining_loses_nothing(killed: Path) -> None:
    joined = killed / "recording.joined.rrd"
    shutil.copy(killed / "recording.rrd", joined)
    go_on(killed, "on again")
    recording = Recording.load(killed)
    assert recording.events[-1].text == "on again" and recording.frames == FRAMES
    assert not joined.exists()


def test_a_piece_that_was_hardly_begun_does_no_harm(killed: Path) -> None:
    (killed / "recording_1.rrd").write_bytes(b"")
    assert Recording.load(killed).frames == FRAMES
    go_on(killed, "on again")
    assert Recording.load(killed).events[-1].text == "on again"
    assert [path.name for path in killed.glob("recording*.rrd")] == ["recording.rrd"]
