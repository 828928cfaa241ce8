"""What stops a recording is told soon, and what is lost by it is counted."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from station.errors import StationError
from station.perception.observations import MARKER_SHAPES, FrameMarkers
from station.recording import Recording, RecordingWriter, session_rows
from station.session import read_status
from tests.made_sessions import START_NS, describe, log_image, make_frames

# Within this something happens that a clock drives, s; on a busy machine too.
SOON_S = 20.0


def until(done: Callable[[], object]) -> None:
    """Wait until something is so; fails if it isn't soon."""
    deadline = time.monotonic() + SOON_S
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def failed(act: Callable[[], object]) -> bool:
    try:
        act()
    except StationError:
        return True
    return False


def test_what_was_logged_is_in_the_file_soon_though_nothing_more_is_logged(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "s", describe(), start_ns=0) as writer:
        writer.log_event(1, "INFO", "the last one for long")
        until(lambda: Recording.load(tmp_path / "s").events)


def test_a_folder_that_is_removed_is_an_error_of_the_next_call(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    writer = RecordingWriter(folder, describe(), start_ns=0)
    shutil.rmtree(folder)
    until(lambda: failed(lambda: writer.log_event(1, "INFO", "into nothing")))
    with pytest.raises(StationError, match=r"recording\.rrd"):
        writer.close("complete")
    assert not folder.exists()


def test_a_file_that_is_replaced_is_an_error(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    with (
        pytest.raises(StationError, match="removed, moved or replaced"),
        RecordingWriter(folder, describe(), start_ns=0) as writer,
    ):
        (folder / "recording.rrd").rename(tmp_path / "taken.rrd")
        (folder / "recording.rrd").write_bytes(b"")
        writer.flush()
    assert read_status(folder).state == "interrupted"


STUCK = """
import os, sys
from pathlib import Path
import numpy as np
import rerun as rr
from station.errors import StationError
from station.recording import RecordingWriter
from station.recording.rrd_stream import RrdStream
from tests.made_sessions import START_NS, describe
path = Path(sys.argv[1]) / "pipe"
os.mkfifo(path)
reading = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
stream = RrdStream(path, "stuck", 0)
stream.log(0, "noise", rr.Scalars(np.random.default_rng(0).normal(size=100_000)))
for act in (lambda: stream.flush(timeout_s=0.5), lambda: stream.log(1, "noise", rr.Scalars([1.0]))):
    try:
        act()
    except StationError as error:
        print(str(error).splitlines()[0], flush=True)
stream.end()
RecordingWriter(Path(sys.argv[1]) / "next", describe(), start_ns=START_NS).close("complete")
print("ended", flush=True)
"""


def test_a_disk_that_takes_nothing_any_more_is_an_error_and_holds_up_nobody(tmp_path: Path) -> None:
    """A pipe that nobody reads stands for the disk; in a process of its own, since rerun's threads never end then."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-c", STUCK, str(tmp_path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=True)
    *said, last = done.stdout.splitlines()
    assert len(said) == 2 and all("pipe can't be written" in line for line in said)
    assert last == "ended"


@pytest.mark.parametrize("later_ns", [0, -5])
def test_a_frame_that_is_not_later_than_the_last_one_is_left_out_and_counted(tmp_path: Path, later_ns: int) -> None:
    first, second, third = make_frames(3)
    with RecordingWriter(tmp_path / "s", describe(), start_ns=START_NS) as writer:
        log_image(writer, first)
        writer.log_frame(second.index, first.t_ns + later_ns, second.image, second.markers)
        log_image(writer, third)
        writer.close("complete")
    recording = Recording.load(tmp_path / "s")
    assert recording.frame_ns.tolist() == [first.t_ns, third.t_ns] and recording.notices == ()
    counts = read_status(tmp_path / "s").counts
    assert (counts["frames"], counts["repeated_frames"]) == (2, 1)


def test_a_recording_with_two_frames_of_one_stamp_is_read_without_the_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = make_frames(3)
    none = FrameMarkers(**{name: np.zeros((0, *shape)) for name, shape in MARKER_SHAPES.items()})
    with RecordingWriter(tmp_path / "s", describe(), start_ns=START_NS) as writer:
        log_image(writer, frames[0])
        session_rows.SessionRows.frame(writer._rows, 1, frames[0].t_ns, None, frames[1].markers)
        writer.log_frame(2, frames[2].t_ns, None, none)
        writer.close("complete")
    recording = Recording.load(tmp_path / "s")
    assert recording.frame_index.tolist() == [0, 2]
    assert "1 frames were left out" in recording.notices[0]
    assert recording.observations.corners_px.tobytes() == frames[0].markers.corners_px.tobytes()
    assert set(recording.observations.frame.tolist()) == {0}
