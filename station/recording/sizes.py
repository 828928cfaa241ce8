"""How many bytes a recording takes, foretold: how long the disk lasts, and whether a planned motion has room."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from station.formats.rig import RigTable

# Measured (tests/benchmarks/read_back.py --sizes) on numbers without any pattern, which can't be compressed, flushed
# twice a second: bytes of a frame beside its image, of each of its markers, of a turn of the servo loop with command
# and reading, of each of its joints, of a row of servo states, of each of its servos.
FRAME_BYTES, MARKER_BYTES = 400.0, 570.0
TURN_BYTES, JOINT_BYTES = 210.0, 21.0
SERVOS_BYTES, SERVO_BYTES = 90.0, 34.0
# Of a frame, bytes a pixel where none was measured: the demo's frames take 0.13 as JPEG; a room with more in it is
# taken to need twice as much. Without loss, a camera's noise leaves about half of the three bytes; neither is measured.
IMAGE_BYTES_PER_PX = {"jpeg": 0.3, "none": 0.0, "ffv1": 1.6}
HOUR_S = 3600.0


@dataclass(frozen=True)
class ExpectedRates:
    """What is recorded in a second.

    Attributes:
        fps: frames.
        image_bytes: of a frame's image, as it is kept.
        markers: seen in a frame.
        joints: commanded and read `rate_hz` times.
        servos: whose states are kept `states_hz` times.
    """

    fps: float
    image_bytes: float
    markers: int
    joints: int
    servos: int
    rate_hz: float = 50.0
    states_hz: float = 2.0

    @property
    def bytes_per_s(self) -> float:
        """How fast the recording grows."""
        frame = FRAME_BYTES + MARKER_BYTES * self.markers + self.image_bytes
        turn = TURN_BYTES + JOINT_BYTES * self.joints if self.joints else 0.0
        states = SERVOS_BYTES + SERVO_BYTES * self.servos if self.servos else 0.0
        return self.fps * frame + self.rate_hz * turn + self.states_hz * states

    @property
    def bytes_per_hour(self) -> float:
        """How much an hour takes; a recording that is joined or repaired has as much beside it for that time."""
        return HOUR_S * self.bytes_per_s


def expected_rates(table: RigTable, frames: str = "jpeg", frame_bytes: float | None = None) -> ExpectedRates:
    """What a capture on this rig records in a second, with all of its markers seen: the most that it can be.

    Args:
        frames: how images are kept.
        frame_bytes: of an image, where it was measured.
    """
    width, height = table.camera.size_px
    return ExpectedRates(
        fps=table.camera.fps,
        image_bytes=image_bytes((width, height), frames) if frame_bytes is None else frame_bytes,
        markers=len(table.marker_table().markers),
        joints=len(table.joint),
        servos=sum(len(joint.servo) for joint in table.joint),
    )


def image_bytes(size_px: tuple[int, int], frames: str = "jpeg") -> float:
    """What an image of this size is taken to need, where none was measured."""
    return size_px[0] * size_px[1] * IMAGE_BYTES_PER_PX[frames]


def disk_lasts_s(folder: Path, rates: ExpectedRates) -> float:
    """For how long there is room on the folder's disk, s; the folder need not be there yet."""
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free / rates.bytes_per_s


def room_warning(folder: Path, rates: ExpectedRates, duration_s: float) -> str | None:
    """What to tell before a motion of this length is recorded; None if its recording has room."""
    lasts_s = disk_lasts_s(folder, rates)
    if lasts_s >= duration_s:
        return None
    return (
        f"the disk of {folder} lasts for about {lasts_s / 60:.0f} min of recording; the motion takes "
        f"{duration_s / 60:.0f} min: make room, or record elsewhere (--out)"
    )
