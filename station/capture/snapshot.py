"""What a capture shows of itself while it runs: plain values, made by the service, drawn by whoever watches."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from station.capture.states import State
from station.motion import Unit


@dataclass(frozen=True, slots=True)
class JointSnapshot:
    """A joint of the arm.

    Attributes:
        q: where it is, rad or m.
        goal: where it is told to be; None where torque is off.
        temperature_c, voltage_v, load: the greatest, the least and the greatest of its servos; load as a share of the
            most that the model has.
        detected: where the camera saw it, told from the same zero; None where nobody looks or it wasn't seen.
        motion_share: how much of the motion that the fit needs has been seen so far, 1 is enough; None if unknown.
    """

    name: str
    unit: Unit
    q: float
    goal: float | None
    temperature_c: float
    voltage_v: float
    load: float
    motion_share: float | None = None
    detected: float | None = None


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A capture at one moment.

    Attributes:
        t_s: since the capture's start.
        done_s, total_s: of the motion; total_s is None where it lasts until somebody ends it.
        step: what is under way, in words.
        frames: recorded so far; frame_rate_hz over the last seconds.
        lost: by reason, what was counted and not recorded: "camera", "detection", "recorder", "live view".
        seen_s: by part, seconds since its markers were last seen; None if never.
        said: the last warning or error.
        detected: states [rad or m] that the camera saw of joints that the arm doesn't have, by name, with their units;
            None unseen.
        bytes_per_s: how fast the recording grows, as foretold; None if unknown.
    """

    state: State
    t_s: float
    done_s: float
    total_s: float | None
    step: str
    joints: tuple[JointSnapshot, ...]
    frames: int
    frame_rate_hz: float
    lost: Mapping[str, int]
    seen_s: Mapping[str, float | None]
    bus_errors: int
    said: str
    bytes_per_s: float | None = None
    detected: Mapping[str, tuple[float | None, Unit]] = field(default_factory=dict[str, tuple[float | None, Unit]])


Watcher = Callable[[Snapshot], None]
"""Is given a snapshot some times a second, in the servo loop's thread: it must return at once."""
