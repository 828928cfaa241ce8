"""How late the servo loop's turns come while frames are detected, encoded and recorded, and what was lost.

The demo's arm is emulated by another process (`station emulate`), its camera's pictures are rendered before: what is
measured is what a capture costs on a real machine.

    python -m tests.benchmarks.servo_jitter --seconds 30
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np

from drivers.arm import Arm
from drivers.camera import Camera, Frame
from drivers.clock import Clock, MonotonicClock
from drivers.dynamixel import DynamixelBus
from station.capture.crew import SERVO_RATE_HZ
from station.capture.service import Capture
from station.formats.camera import format_camera
from station.formats.markers import format_markers
from station.motion import Motion, MotionStep, plan_motion
from station.recording import Recording, RecordingWriter
from station.rig import Rig, load_rig, open_rig
from station.rig_reading import joint_configs
from station.session import SessionDescription

PICTURES, FPS = 60, 30.0
NS = 1_000_000_000
SHARES = (0.05, 0.5, 0.95, 0.99, 1.0)


class Pictures:
    """Rendered pictures, over and over, at a camera's rate; none if there are none."""

    size_px, fps, stale = (640, 480), FPS, 0
    settings = MappingProxyType({})

    def __init__(self, images: list[Any], clock: Clock) -> None:
        self._images, self._clock, self._start_ns = images, clock, clock.now_ns()
        self._index = self.dropped = 0

    def read(self, until_ns: int) -> Frame | None:
        due_ns = self._start_ns + round((self._index + 1) * NS / FPS)
        if not self._images or due_ns > until_ns:
            self._clock.sleep_until_ns(until_ns)
            return None
        self._clock.sleep_until_ns(due_ns)
        self._index += 1
        return Frame(self._index - 1, self._clock.now_ns(), self._images[self._index % len(self._images)])


def rendered() -> list[Any]:
    """What the demo's camera sees of the arm at rest."""
    with open_rig(load_rig("demo"), seed=0) as rig:
        frames = [rig.camera.read(rig.clock.now_ns() + NS) for _ in range(PICTURES)]
    return [frame.image for frame in frames if frame is not None]


@contextmanager
def emulated() -> Iterator[str]:
    """The demo's servos in another process; the path of their device."""
    command = [sys.executable, "-c", "from station.cli import main; main()", "emulate", "demo"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        try:
            yield (program.stdout.readline() if program.stdout else "").strip()
        finally:
            program.terminate()


def capture(path: str, images: list[Any], seconds: float, folder: Path) -> Recording:
    """A capture of so many seconds, on the real clock; its recording."""
    source, clock = load_rig("demo"), MonotonicClock()
    table, limits = source.table, source.table.limits()
    away = MotionStep({limits[0].name: 0.5}, 0.2, 1.0, 1)
    back = MotionStep({limits[0].name: 0.0}, 0.2, 1.0, 1)
    rounds = max(1, round(seconds / plan_motion(Motion("to and fro", (away, back)), limits).duration_s))
    plan = plan_motion(Motion("to and fro", (away, back) * rounds, "stream"), limits)
    about = SessionDescription(
        camera=format_camera(source.camera_model),
        markers=format_markers(table.marker_table()),
        joints=tuple(joint.name for joint in limits),
        units=tuple(joint.unit for joint in limits),
        rig=None,
        motion=None,
        started=datetime.now(UTC),
    )
    with (
        DynamixelBus(path, baud=table.bus.baud, protocol=table.bus.protocol, clock=clock, reply_timeout_s=0.5) as bus,
        RecordingWriter(folder, about, start_ns=clock.now_ns()) as writer,
    ):
        arm, camera = Arm(bus, joint_configs(table), clock), cast(Camera, Pictures(images, clock))
        rig = Rig(table, clock, False, arm, camera, source.camera_model, table.marker_table(), None)
        print(" ", {name: n for name, n in Capture(rig, plan, writer).run().as_dict().items() if n})
    return Recording.load(folder)


def tell(name: str, recording: Recording) -> None:
    """How late the turns' requests were, from the grid of the servo loop's rate, and how long the turns took."""
    t_s = recording.stamps_ns[:, 0] * 1e-9
    phase_s = t_s % (1 / SERVO_RATE_HZ)
    late_ms = 1e3 * ((phase_s - np.quantile(phase_s, 0.05)) % (1 / SERVO_RATE_HZ))
    turn_ms = 1e3 * np.diff(t_s)
    rows = [("late", late_ms), ("from turn to turn", turn_ms)]
    for what, ms in rows:
        q = np.quantile(ms, SHARES)
        shares = "  ".join(f"{share:4.0%} {ms:7.2f}" for share, ms in zip(SHARES, q, strict=True))
        print(f"{name:16} {what:18} {shares} ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="of each capture")
    seconds = parser.parse_args().seconds
    images = rendered()
    with tempfile.TemporaryDirectory() as folder:
        for name, shown in (("without frames", []), ("with frames", images)):
            with emulated() as path:
                tell(name, capture(path, shown, seconds, Path(folder) / name.replace(" ", "-")))


if __name__ == "__main__":
    main()
