"""What a capture sheds when there is no time for all: the live view's frames, then pictures, then frames; counted."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from drivers.camera import Frame
from station.capture.counts import Tally
from station.capture.detection import NO_MARKERS, Detection
from station.capture.live_view import LiveFrame
from station.capture.recorder import FRAMES_WAITING, Recorder
from station.capture.service import Capture
from station.capture.worker import Worker
from station.commands import planning
from station.perception.marker_tracker import MarkerTracker
from station.recording.rrd_stream import FLUSH_PERIOD_S
from tests.test_capture import demo_rig
from tests.test_ends_of_captures import QUIET, FramesToo, GreyCamera, with_frames
from tests.test_safe_states import lab


def frame(index: int) -> Frame:
    return Frame(index, index * 33_000_000, np.zeros((48, 64, 3), np.uint8))


class Gate:
    """Holds a thread until it is opened."""

    def __init__(self) -> None:
        self.entered, self.open = threading.Event(), threading.Event()

    def wait(self) -> None:
        self.entered.set()
        assert self.open.wait(60)


class Slow(FramesToo):
    """Its disk takes nothing until the gate is opened."""

    def __init__(self, gate: Gate) -> None:
        super().__init__()
        self.gate, self.pictures = gate, list[bool]()

    def log_frame(self, index: int, t_ns: int, image: object, markers: object) -> None:
        self.gate.wait()
        super().log_frame(index, t_ns, image, markers)
        self.pictures.append(image is not None)


@contextmanager
def ended(*workers: Any) -> Iterator[None]:
    for worker in workers:
        worker.start()
    try:
        yield
    finally:
        for worker in workers:
            worker.end()


def test_a_recorder_that_is_behind_leaves_out_pictures_first_and_then_frames() -> None:
    gate, tally = Gate(), Tally()
    writer = Slow(gate)
    recorder = Recorder(cast(Any, writer), tally, waits=False)
    with ended(recorder):
        for index in range(FRAMES_WAITING + 3):
            recorder.frame(frame(index), NO_MARKERS)
            recorder.command(index, np.zeros(4))  # a disk that is busy holds nobody up
        gate.open.set()
    counts = tally.counts()
    assert (counts.frames, counts.dropped_by_recorder, counts.dropped_frames) == (FRAMES_WAITING, 3, 3)
    assert 0 < counts.images_left_out == writer.pictures.count(False) < FRAMES_WAITING
    assert writer.pictures == sorted(writer.pictures, reverse=True)  # the first ones have theirs
    assert [index for index, _ in writer.frames] == list(range(FRAMES_WAITING)) and counts.readings_lost == 0


def test_detection_that_is_behind_sheds_the_live_view_first_and_then_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    gate, tally, shown = Gate(), Tally(), list[int]()
    detect = MarkerTracker.detect

    def slowly(self: MarkerTracker, image: Any) -> Any:
        gate.wait()
        return detect(self, image)

    class View:
        shed: dict[str, int] = {}  # noqa: RUF012

        def offer(self, item: LiveFrame) -> None:
            shown.append(item.index)

    monkeypatch.setattr(MarkerTracker, "detect", slowly)
    found: list[int] = []
    with demo_rig() as rig:
        detection = Detection(
            rig, lambda each, markers: found.append(each.index), tally, cast(Any, View()), waits=False
        )
        with ended(detection):
            for index in range(12):
                detection.offer(frame(index))
            gate.open.set()
    counts = tally.counts()
    assert found == list(range(8)) and counts.dropped_by_detection == 4
    assert shown == found[-len(shown) :] and 0 < len(shown) < 8  # once there was time again
    assert counts.live_view_shed == 8 - len(shown)


def test_on_a_virtual_clock_nothing_is_shed() -> None:
    gate, tally = Gate(), Tally()
    gate.open.set()
    writer = Slow(gate)
    recorder = Recorder(cast(Any, writer), tally, waits=True)
    with ended(recorder):
        for index in range(50):
            recorder.frame(frame(index), NO_MARKERS)
    assert writer.pictures == [True] * 50 and tally.counts().dropped_frames == 0


def test_a_thread_that_failed_holds_nobody_up_and_tells_its_first_failure() -> None:
    def work(item: int) -> None:
        raise ValueError(f"piece {item}")

    worker = Worker("failing", work, {"piece": 1}, waits=True)
    with ended(worker):
        for item in range(5):
            assert worker.offer("piece", item)
    with pytest.raises(ValueError, match="piece 0"):
        worker.check()


def test_a_checkpoint_is_kept_only_when_the_frames_before_it_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with lab(tmp_path, "demo", QUIET) as bench:
        path = Path(bench.files[1])
        path.write_text(path.read_text(encoding="utf-8") + "[[step]]\nmove = { shoulder = 30 }\n", encoding="utf-8")
        writer = with_frames(bench, GreyCamera(bench.rig.clock))
        order: list[tuple[str, int]] = []
        log_frame = writer.log_frame

        def slowly(index: int, t_ns: int, image: object, markers: object) -> None:
            threading.Event().wait(0.005)
            log_frame(index, t_ns, image, markers)
            order.append(("frame", t_ns))

        monkeypatch.setattr(writer, "log_frame", slowly)
        monkeypatch.setattr(writer, "checkpoint", lambda leg, *more: order.append(("checkpoint", leg)))
        Capture(bench.rig, planning.plan(*bench.files), cast(Any, writer)).run()
    begins_ns = round(writer.at_s("step 2") * 1e9)
    at = order.index(("checkpoint", 1))
    assert order.index(("checkpoint", 0)) < at
    frames = [(n, t_ns) for n, (what, t_ns) in enumerate(order) if what == "frame"]
    assert all((n < at) == (t_ns < begins_ns) for n, t_ns in frames if abs(t_ns - begins_ns) > 1e6)
    assert sum(n < at for n, _ in frames) > 200


def test_what_waits_before_the_disk_is_less_than_the_second_that_a_kill_may_cost() -> None:
    """At 30 frames/s, with the recorder's queue full just before the next flush."""
    assert FRAMES_WAITING / 30.0 + FLUSH_PERIOD_S < 1.0


def test_a_reading_that_the_recorder_has_no_place_for_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("station.capture.recorder.ROWS_WAITING", 2)
    tally = Tally()
    full = Recorder(cast(Any, None), tally, waits=False)  # never started: nothing is taken off its queue
    for t_ns in range(5):
        full.command(t_ns, np.zeros(1))
    assert tally.counts().readings_lost == 3
