"""What happened to the samples of a capture, counted."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass, fields


@dataclass(frozen=True)
class CaptureCounts:
    """What happened to the samples of a session.

    Attributes:
        frames: recorded.
        dropped_frames: lost while the motion was recorded, for whichever of the reasons below.
        stale_frames: that were the one before once more.
        commands: sent.
        readings: of the servos.
        bus_errors: that were mended.
        dropped_by_camera: before the station read them, or by its camera's own queue.
        dropped_by_detection, dropped_by_recorder: because the thread had no place left for them.
        images_left_out: frames of which the markers are recorded and the picture isn't, as the recorder was behind.
        readings_lost: commands, readings and servos' states that the recorder had no place for.
        live_view_shed: frames that the live view didn't get, as there was other work.
        states_left_out: frames by which no joint states were estimated, as there was no time.
        frames_outside: that came while the motion was held, or before it: not recorded on purpose.
        pauses: that people asked for.
        reconnects: of a bus or a camera that had gone away.
    """

    frames: int = 0
    dropped_frames: int = 0
    stale_frames: int = 0
    commands: int = 0
    readings: int = 0
    bus_errors: int = 0
    dropped_by_camera: int = 0
    dropped_by_detection: int = 0
    dropped_by_recorder: int = 0
    images_left_out: int = 0
    readings_lost: int = 0
    live_view_shed: int = 0
    states_left_out: int = 0
    frames_outside: int = 0
    pauses: int = 0
    reconnects: int = 0

    def as_dict(self) -> dict[str, int]:
        """The counts by name, as in session.json."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


class Tally:
    """Counts of a capture under way, from all of its threads."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._lock = threading.Lock()

    def add(self, what: str, more: int = 1) -> None:
        """Count something, by the name that it has in CaptureCounts."""
        with self._lock:
            self._counts[what] += more

    def counts(self, **also: int) -> CaptureCounts:
        """All counts so far, with some that others keep."""
        with self._lock:
            counted = Counter(self._counts) + Counter(also)
        dropped = sum(counted[f"dropped_by_{what}"] for what in ("camera", "detection", "recorder"))
        return CaptureCounts(**{**counted, "dropped_frames": dropped})
