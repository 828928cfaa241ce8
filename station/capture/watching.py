"""Snapshots of a capture for who watches it, some times a second and at each change of its state."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from drivers.arm import ArmReading
from station.capture.counts import CaptureCounts
from station.capture.snapshot import JointSnapshot, Snapshot, Watcher
from station.capture.states import State
from station.formats.rig import RigTable
from station.logs import FloatArray
from station.motion import Unit

NS_PER_S = 1_000_000_000
# Of the capture's clock or of the person's, whichever has passed first: simulated seconds may take long.
EVERY_S = 0.2
# The frame rate is told over so long.
RATE_OVER_S = 2.0


@dataclass
class Situation:
    """What the servo loop knows at the moment.

    Attributes:
        done_s, total_s: of the motion; total_s is None where it lasts until somebody ends it.
        step: what is under way, in words.
        reading: the last one; None before the first.
        goal: (J,) where the arm is told to be; None where torque is off.
        motion_shares: by joint, as `MotionTally` tells them.
        detected: the states that the camera saw last, by joint, in the arm's zeros; NaN unseen.
        detected_units: of those.
    """

    done_s: float = 0.0
    total_s: float | None = None
    step: str = ""
    reading: ArmReading | None = None
    goal: FloatArray | None = None
    motion_shares: Mapping[str, float | None] = field(default_factory=dict[str, float | None])
    detected: Mapping[str, float] = field(default_factory=dict[str, float])
    detected_units: Mapping[str, str] = field(default_factory=dict[str, str])


class Watching:
    """Hands snapshots to a watcher. One that raises is not called again: what it raises ends the capture once."""

    def __init__(self, table: RigTable, start_ns: int, watch: Watcher | None) -> None:
        self._table, self._start_ns, self._watch = table, start_ns, watch
        self._parts = tuple(dict.fromkeys(marker.part for marker in table.marker_table().markers))
        self._told_at: tuple[int, float] | None = None
        self._frames: deque[tuple[int, int]] = deque()

    def is_due(self, now_ns: int) -> bool:
        """Whether it is time for a snapshot."""
        if self._watch is None or self._told_at is None:
            return self._watch is not None
        told_ns, told_s = self._told_at
        return now_ns - told_ns >= EVERY_S * NS_PER_S or time.monotonic() - told_s >= EVERY_S

    def tell(
        self,
        now_ns: int,
        state: State,
        situation: Situation,
        counts: CaptureCounts,
        seen_ns: dict[str, int],
        said: str,
    ) -> None:
        """Hand over a snapshot of this moment."""
        watch = self._watch
        if watch is None:
            return
        self._told_at = now_ns, time.monotonic()
        shot = Snapshot(
            state=state,
            t_s=(now_ns - self._start_ns) / NS_PER_S,
            done_s=situation.done_s,
            total_s=situation.total_s,
            step=situation.step,
            joints=self._joints(situation),
            frames=counts.frames,
            frame_rate_hz=self._frame_rate_hz(now_ns, counts.frames),
            lost=_lost(counts),
            seen_s={part: _since_s(now_ns, seen_ns.get(part)) for part in self._parts},
            bus_errors=counts.bus_errors,
            said=said,
            detected=self._detected(situation),
        )
        self._watch = None
        watch(shot)
        self._watch = watch

    def _joints(self, situation: Situation) -> tuple[JointSnapshot, ...]:
        reading, goal = situation.reading, situation.goal
        if reading is None:
            return ()
        return tuple(
            replace(
                _joint(joint.name, joint.unit, [servo.id for servo in joint.servo], reading, j, goal),
                motion_share=situation.motion_shares.get(joint.name),
                detected=_known(situation.detected.get(joint.name, math.nan)),
            )
            for j, joint in enumerate(self._table.joint)
        )

    def _detected(self, situation: Situation) -> dict[str, tuple[float | None, Unit]]:
        """What was detected of joints that the arm doesn't have."""
        arm = {joint.name for joint in self._table.joint}
        return {
            name: (_known(q), "m" if situation.detected_units.get(name) == "m" else "rad")
            for name, q in situation.detected.items()
            if name not in arm
        }

    def _frame_rate_hz(self, now_ns: int, frames: int) -> float:
        self._frames.append((now_ns, frames))
        while now_ns - self._frames[0][0] > RATE_OVER_S * NS_PER_S:
            self._frames.popleft()
        (since_ns, before), passed_ns = self._frames[0], now_ns - self._frames[0][0]
        return (frames - before) * NS_PER_S / passed_ns if since_ns < now_ns else 0.0


def _joint(
    name: str, unit: str, ids: Sequence[int], reading: ArmReading, j: int, goal: FloatArray | None
) -> JointSnapshot:
    servos = [reading.servos[servo_id] for servo_id in ids]
    return JointSnapshot(
        name=name,
        unit="m" if unit == "m" else "rad",
        q=float(reading.q[j]),
        goal=None if goal is None else float(goal[j]),
        temperature_c=max(servo.temperature_c for servo in servos),
        voltage_v=min(servo.voltage_v for servo in servos),
        load=max(abs(servo.load) for servo in servos),
    )


def _known(q: float) -> float | None:
    return None if math.isnan(q) else q


def _lost(counts: CaptureCounts) -> dict[str, int]:
    return {
        "camera": counts.dropped_by_camera,
        "detection": counts.dropped_by_detection,
        "recorder": counts.dropped_by_recorder,
        "images": counts.images_left_out,
        "live view": counts.live_view_shed,
    }


def _since_s(now_ns: int, seen_ns: int | None) -> float | None:
    return None if seen_ns is None else max(0.0, (now_ns - seen_ns) / NS_PER_S)
