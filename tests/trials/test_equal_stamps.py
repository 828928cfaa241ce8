"""A camera that gives two frames at once, as one on a network does after a pause."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import Frame
from drivers.rendered_camera import RenderedCamera
from station.recording import Recording
from tests.sessions import capture_short

EVERY = 5


def test_of_frames_with_the_same_stamp_one_is_recorded_and_the_others_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, stamps = RenderedCamera.read, [0]

    def read_late(self: RenderedCamera, until_ns: int) -> Frame | None:
        frame = read(self, until_ns)
        if frame is None:
            return None
        late = replace(frame, t_ns=stamps[-1]) if frame.index % EVERY == 0 and frame.index else frame
        stamps.append(late.t_ns)
        return late

    monkeypatch.setattr(RenderedCamera, "read", read_late)
    folder, counts = capture_short(tmp_path)
    recording = Recording.load(folder)
    assert recording.frames == counts.frames > 50 and np.all(np.diff(recording.frame_ns) > 0)
    assert not np.any(recording.frame_index[1:] % EVERY == 0)
    assert counts.dropped_by_camera == np.diff(recording.frame_index).sum() + 1 - counts.frames
