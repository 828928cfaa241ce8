"""Frames without loss: to the last bit, with their stamps to the nanosecond, readable after a kill."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from station.errors import StationError
from station.formats.timestamps import parse_timestamps
from station.perception.observations import MARKER_SHAPES, FrameMarkers
from station.recording import Recording, RecordingWriter
from station.recording.lossless import lossless_images
from station.session import lossless_files
from tests.made_sessions import START_NS, MadeFrame, describe, log_image, make_frames

pytest.importorskip("av")
NONE = FrameMarkers(**{name: np.zeros((0, *shape)) for name, shape in MARKER_SHAPES.items()})


@pytest.fixture(scope="module")
def frames() -> list[MadeFrame]:
    return make_frames(12)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, frames: list[MadeFrame]) -> Path:
    folder = tmp_path_factory.mktemp("lossless") / "s"
    with RecordingWriter(folder, describe(), start_ns=START_NS, frames="ffv1") as writer:
        for frame in frames:
            log_image(writer, frame)
        writer.close("complete")
    return folder


def test_images_are_read_to_the_last_bit(session: Path, frames: list[MadeFrame]) -> None:
    recording = Recording.load(session)
    for row in (0, 5, 11):
        np.testing.assert_array_equal(recording.frame_image(row), frames[row].image)
    assert list(recording.frame_jpegs()) == []


def test_stamps_are_read_to_the_nanosecond(session: Path, frames: list[MadeFrame]) -> None:
    stamps = parse_timestamps((session / "frames.csv").read_text(), "frames.csv")
    assert list(stamps.values()) == [frame.t_ns - START_NS for frame in frames]


def test_grey_images_are_kept_too(tmp_path: Path, frames: list[MadeFrame]) -> None:
    grey = frames[0].image[..., 1].copy()
    with RecordingWriter(tmp_path / "s", describe(), start_ns=0, frames="ffv1") as writer:
        writer.log_frame(0, 1, grey, NONE)
    np.testing.assert_array_equal(Recording.load(tmp_path / "s").frame_image(0), np.stack([grey] * 3, axis=2))


def test_a_session_that_goes_on_has_another_file(session: Path, tmp_path: Path, frames: list[MadeFrame]) -> None:
    folder = tmp_path / "s"
    with RecordingWriter(folder, describe(), start_ns=START_NS, frames="ffv1") as writer:
        log_image(writer, frames[0])
    with RecordingWriter.resume(folder, now_ns=5) as writer:
        writer.log_frame(0, 5, frames[1].image, frames[1].markers)
    assert [path.name for path in lossless_files(folder)] == ["frames.mkv", "frames_1.mkv"]
    recording = Recording.load(folder)
    np.testing.assert_array_equal(recording.frame_image(1), frames[1].image)


def test_without_images_none_are_kept(tmp_path: Path, frames: list[MadeFrame]) -> None:
    with RecordingWriter(tmp_path / "s", describe(), start_ns=START_NS, frames="none") as writer:
        log_image(writer, frames[0])
    recording = Recording.load(tmp_path / "s")
    assert recording.frames == 1 and list(recording.frame_jpegs()) == []


def test_another_way_to_keep_frames_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(StationError, match="want one of jpeg, none, ffv1"):
        RecordingWriter(tmp_path / "s", describe(), start_ns=0, frames="png")
    assert not (tmp_path / "s").exists()


def test_without_pyav_there_is_a_clear_error_before_anything_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(StationError, match=r"capture-fit-station\[lossless\]"):
        RecordingWriter(tmp_path / "s", describe(), start_ns=0, frames="ffv1")
    assert not (tmp_path / "s").exists()


KILLED = """
import os, sys, time
from pathlib import Path
from tests.made_sessions import START_NS, describe, log_image, make_frames
from station.recording import RecordingWriter
writer = RecordingWriter(Path(sys.argv[1]), describe(), start_ns=START_NS, frames="ffv1")
for frame in make_frames(40):
    log_image(writer, frame)
print("logged", flush=True)
time.sleep(60)
"""


def test_after_a_kill_all_but_the_last_frames_are_there(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-c", KILLED, str(tmp_path / "s")]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as writing:
        assert writing.stdout is not None and writing.stdout.readline() == "logged\n"
        writing.send_signal(signal.SIGKILL)
    made = make_frames(40)
    images = list(lossless_images(lossless_files(tmp_path / "s")))
    assert len(images) >= 38  # one is in the encoder, one in the container
    for (elapsed_ns, image), frame in zip(images, made, strict=False):
        assert elapsed_ns == frame.t_ns - START_NS
        np.testing.assert_array_equal(image, frame.image)


def test_a_torn_video_is_read_up_to_its_last_whole_frame(session: Path, tmp_path: Path) -> None:
    torn = shutil.copytree(session, tmp_path / "torn")
    content = (torn / "frames.mkv").read_bytes()
    (torn / "frames.mkv").write_bytes(content[: len(content) // 2])
    assert 0 < len(list(lossless_images(lossless_files(torn)))) < 12
