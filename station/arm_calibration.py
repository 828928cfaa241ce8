"""What `station calibrate latency`, `servos` and `scale` do, as functions; as `station.commands` for sessions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.latency import Latency, estimate_latency
from station.commands import record_motion
from station.errors import InvalidData, StationError
from station.formats.camera import parse_camera
from station.formats.motion import parse_motion
from station.formats.rig import parse_rig
from station.formats.toml_edit import Key, rewrite
from station.lone_motion import lone_sweeps, swinging_motion
from station.motion import plan_motion
from station.rig_reading import packaged, packaged_names
from station.session import check_output_folder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from station.capture import Progress
    from station.recording import Recording

MOTION_NAME = "one joint at a time"
# s. A read-back that takes longer a servo is stamped no better than by half of it.
SLOW_REPLY_S = 0.004
SLOW_REPLY = (
    "reading a joint takes {:.0f} ms, so that the latency may be off by half of that; "
    "set the adapter's latency timer to 1 ms: station doctor says how"
)


@dataclass(frozen=True)
class CameraLatency:
    """A camera's latency as a session shows it.

    Attributes:
        present_s: the rig's.
        warnings: what is doubtful, in words.
    """

    found: Latency
    present_s: float
    warnings: tuple[str, ...]

    @property
    def value_s(self) -> float:
        """What belongs into the rig: to a tenth of a millisecond."""
        return round(self.found.latency_s, 4)

    @property
    def agrees(self) -> bool:
        """Whether the rig has it within two standard deviations, or a tenth of a millisecond."""
        return abs(self.present_s - self.found.latency_s) <= max(2 * self.found.std_s, 1e-4)

    @property
    def line(self) -> str:
        """The line of the rig's [camera]."""
        return f"latency_s = {self.value_s!r}"


def capture_swings(
    rig: str,
    out: Path,
    *,
    joints: Sequence[str] = (),
    seed: int | None = None,
    simulate: bool = False,
    realtime: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> None:
    """Swing the joints of a rig to and fro, one after the other, and record it into the session folder `out`.

    Args:
        rig: the name of a packaged one, or a path.
        joints: which; all revolute ones that can if empty.

    Raises:
        StationError: a bad rig, a joint that can't swing, an occupied folder.
        DriverError: what the arm or the camera failed at.
    """
    from station.rig import load_rig

    rig_file = load_rig(rig)
    limits = rig_file.table.limits()
    text = swinging_motion(limits, joints)
    planned = plan_motion(parse_motion(text, MOTION_NAME, limits), limits)
    check_output_folder(out, force=force)
    record_motion(
        rig_file,
        planned,
        text,
        out,
        seed=seed,
        simulate=simulate,
        realtime=realtime,
        force=force,
        progress=progress,
    )


def latency_of(session: Path) -> CameraLatency:
    """The latency of the camera of a session in which joints moved alone.

    Raises:
        StationError: the session can't be read, or has no read-back.
        CalibrationError: it shows no latency.
    """
    from station.recording import Recording

    recording = Recording.load(session)
    about = recording.description
    if not len(recording.measured.t_s) or about.rig is None:
        raise InvalidData(f"{session} has no read-back of servos: a camera's latency is told against it")
    rig, camera = parse_rig(about.rig, f"{session}: rig"), parse_camera(about.camera, f"{session}: camera")
    readout_s = rig.camera.readout_s or camera.readout_s or 0.0
    sweeps = lone_sweeps(recording.measured, recording.observations, readout_s=readout_s, height_px=camera.size_px[1])
    reply_s = _reply_s(recording)
    found = estimate_latency(sweeps, reply_s=reply_s)
    slow = () if reply_s < SLOW_REPLY_S else (SLOW_REPLY.format(reply_s * 1e3),)
    return CameraLatency(found, rig.camera.latency_s, (*found.warnings, *slow))


def _reply_s(recording: Recording) -> float:
    """From request to reply of one joint: they share the time of a reading of all."""
    took_s = float(np.median(np.diff(recording.stamps_ns, axis=1))) * 1e-9
    return took_s / max(len(recording.measured.joints), 1)


def check_writable(rig: str) -> None:
    """Raise StationError for a packaged rig: it is left as it is."""
    if rig in packaged_names("rigs"):
        path = packaged("rigs", rig)
        raise StationError(
            f"'{rig}' comes with the package and is left as it is\ncopy {path} to a file of your own, and name that"
        )


def write_into_rig(rig: str, values: dict[Key, int | float]) -> Path:
    """Write numbers into a rig's file; the old file is kept beside it, and its path returned.

    Raises:
        StationError: a packaged rig, or a file in which they can't be changed safely.
    """
    check_writable(rig)
    return rewrite(Path(rig), values)
