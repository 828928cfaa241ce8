"""What a recording will take is foretold well enough to know whether the disk lasts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.safety import ServoState
from station.perception.observations import FrameMarkers
from station.recording import RecordingWriter
from station.recording.sizes import ExpectedRates, disk_lasts_s, image_bytes, room_warning
from tests.made_sessions import describe

SECONDS, TURNS_PER_S, FRAMES_PER_S = 10, 50, 25


@pytest.mark.parametrize("count", [0, 3])
def test_a_recording_takes_what_was_foretold(tmp_path: Path, count: int) -> None:
    rng = np.random.default_rng(0)
    with RecordingWriter(tmp_path / "s", describe(), start_ns=0) as writer:
        empty = (tmp_path / "s" / "recording.rrd").stat().st_size
        for turn in range(SECONDS * TURNS_PER_S):
            t_ns = turn * 20_000_000
            writer.log_command(t_ns, rng.normal(size=3))
            writer.log_reading(t_ns, t_ns + 900, rng.normal(size=3))
            writer.log_servos(t_ns, {n: ServoState(0, *rng.normal(size=4)) for n in range(3)})
            if turn % 2 == 0:
                shapes = {"corners_px": (4, 2), "corner_covariance_px2": (4, 2, 2), "T_cam_marker": (2, 4, 4)}
                columns = {name: rng.normal(size=(count, *shape)) for name, shape in shapes.items()}
                markers = FrameMarkers(np.arange(count), rms_px=rng.random((count, 2)), **columns)
                writer.log_frame(turn, t_ns, rng.bytes(5000), markers)
            if turn % 25 == 24:
                writer.flush()
        writer.close("complete")
    taken = (tmp_path / "s" / "recording.rrd").stat().st_size - empty
    foretold = SECONDS * ExpectedRates(FRAMES_PER_S, 5000, count, 3, 3, states_hz=TURNS_PER_S).bytes_per_s
    # A fifth: fps, joints and markers come in other proportions than where the figures were measured.
    assert taken == pytest.approx(foretold, rel=0.2)


def test_a_disk_that_is_too_small_for_a_motion_is_told_beforehand(tmp_path: Path) -> None:
    rates = ExpectedRates(30, image_bytes((1280, 720)), 10, 6, 6)
    lasts_s = disk_lasts_s(tmp_path / "not" / "yet", rates)
    assert lasts_s > 0
    assert room_warning(tmp_path, rates, 0.5 * lasts_s) is None
    warning = room_warning(tmp_path, rates, 2 * lasts_s)
    assert warning is not None and "make room" in warning
