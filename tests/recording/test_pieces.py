"""Long captures: the file's index doesn't grow in memory, as the recording goes on in a further file every so often."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from station.recording import Recording, RecordingWriter
from station.recording import writer as writing
from station.recording.rrd_files import scan_framing
from station.session import recording_pieces
from tests.made_sessions import START_NS, MadeFrame, describe, log_frame, make_frames


@pytest.fixture(autouse=True)
def short_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """A piece for each row that is logged."""
    monkeypatch.setattr(writing, "PIECE_S", -1.0)


def test_a_capture_of_many_pieces_ends_as_one_recording(tmp_path: Path) -> None:
    frames = make_frames(6)
    with RecordingWriter(tmp_path / "one", describe(), start_ns=START_NS) as writer:
        for frame in frames:
            log_frame(writer, frame)
        pieces = recording_pieces(tmp_path / "one")
        assert len(pieces) > 6
        assert all(scan_framing(piece).complete for piece in pieces[:-1])  # their index is no longer in memory
        writer.close("complete")
    assert [piece.name for piece in recording_pieces(tmp_path / "one")] == ["recording.rrd"]
    check(tmp_path / "one", frames)


def test_pieces_are_read_while_they_are_recorded_and_after_a_kill(tmp_path: Path) -> None:
    frames = make_frames(6)
    with RecordingWriter(tmp_path / "one", describe(), start_ns=START_NS) as writer:
        for frame in frames:
            log_frame(writer, frame)
        writer.flush()
        check(tmp_path / "one", frames)


def check(folder: Path, frames: list[MadeFrame]) -> None:
    recording = Recording.read(folder)
    np.testing.assert_array_equal(recording.frame_ns, [frame.t_ns for frame in frames])
    np.testing.assert_array_equal(recording.measured.q, [frame.reading for frame in frames])
    for row, frame in enumerate(frames):
        assert recording.frame_image(row).shape == frame.image.shape
