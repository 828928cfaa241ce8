"""On a machine that can't keep up, frames that waited too long make room for newer ones."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.camera import Frame
from station.capture.counts import Tally
from station.capture.detection import OLDEST_NS, Detection
from station.rig import load_rig

NOW_NS = 10_000_000_000


@pytest.mark.parametrize("waits", [False, True], ids=["real clock", "virtual clock"])
def test_a_frame_that_waited_too_long_is_dropped_and_counted_on_a_real_clock_only(waits: bool) -> None:
    source = load_rig("demo")
    clock = SimpleNamespace(now_ns=lambda: NOW_NS)
    rig = SimpleNamespace(markers=source.table.marker_table(), camera_model=source.camera_model, clock=clock)
    tally, found = Tally(), list[int]()
    detection = Detection(cast(Any, rig), lambda frame, _: found.append(frame.index), tally, None, waits=waits)
    detection.start()
    image = np.zeros((480, 640, 3), np.uint8)
    stamps = [NOW_NS - OLDEST_NS - 1, NOW_NS - OLDEST_NS, NOW_NS - 1]
    for index, t_ns in enumerate(stamps):
        detection.offer(Frame(index, t_ns, image))
    detection.end()
    detection.check()
    assert found == ([0, 1, 2] if waits else [1, 2])
    assert tally.counts().dropped_by_detection == (0 if waits else 1)
