"""What `station calibrate latency`, `servos` and `scale` do, as functions; as `station.commands` for sessions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import numpy as np

from calibration.latency import Latency, estimate_latency
from calibration.scale import Scale, combine_lengths
from calibration.servo_zeros import ServoZero, find_zeros
from station.calibrating.known_lengths import axis_distances, prismatic_travels
from station.calibrating.lone_motion import lone_sweeps, swinging_motion
from station.calibrating.reference_pose import open_bus, read_counts, reference_joints, reference_states
from station.commands.capturing import CaptureSettings, record_motion
from station.commands.fitting import joint_types
from station.compare import compare as compare_logs
from station.errors import InvalidData, StationError
from station.fit_files import read_fit
from station.formats.camera import parse_camera
from station.formats.motion import parse_motion
from station.formats.rig import parse_rig
from station.formats.toml_edit import Key, rewrite
from station.motion import plan_motion
from station.releasing import release
from station.rig_reading import check_arm, packaged, packaged_names, read_rig
from station.session import FIT_FOLDER

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from station.recording import Recording
    from station.releasing import Ask

MOTION_NAME = "one joint at a time"
HOLD = "Bear its weight, or let it rest against a stop; hold it still"
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


def capture_swings(rig: str, out: Path, *, joints: Sequence[str] = (), **settings: Unpack[CaptureSettings]) -> None:
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
    check_arm(rig_file.table, rig_file.name)
    limits = rig_file.table.limits()
    text = swinging_motion(limits, joints)
    planned = plan_motion(parse_motion(text, MOTION_NAME, limits), limits)
    record_motion(rig_file, planned, text, out, **settings)


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
    readout_s = (camera.readout_s if rig.camera.readout_s is None else rig.camera.readout_s) or 0.0
    sweeps = lone_sweeps(recording.measured, recording.observations, readout_s=readout_s, height_px=camera.size_px[1])
    reply_s = _reply_s(recording)
    found = estimate_latency(sweeps, reply_s=reply_s)
    slow = () if reply_s < SLOW_REPLY_S else (SLOW_REPLY.format(reply_s * 1e3),)
    return CameraLatency(found, rig.camera.latency_s, (*found.warnings, *slow))


def _reply_s(recording: Recording) -> float:
    """From request to reply of one joint: they share the time of a reading of all."""
    took_s = float(np.median(np.diff(recording.stamps_ns, axis=1))) * 1e-9
    return took_s / max(len(recording.measured.joints), 1)


@dataclass(frozen=True)
class ServoZeros:
    """The zeros of a rig's servos, in the order of the rig, and where each belongs in the file.

    Attributes:
        units: of each servo's joint, "rad" or "m".
        pose: what the joints were taken to be at, in words.
    """

    zeros: tuple[ServoZero, ...]
    units: tuple[str, ...]
    keys: tuple[Key, ...]
    pose: str

    @property
    def problems(self) -> tuple[str, ...]:
        """Why they can't be used, in words."""
        return tuple(problem for zero in self.zeros for problem in zero.problems)

    @property
    def values(self) -> dict[Key, int | float]:
        """What is to be written where."""
        return {key: zero.zero for key, zero in zip(self.keys, self.zeros, strict=True)}


def servo_zeros(rig: str, *, pose: Mapping[str, float], ask: Ask, simulate: bool = False) -> ServoZeros:
    """Find the servos' zeros while a person holds the arm in a reference pose; torque is off, and stays off.

    Args:
        rig: the name of a packaged one, or a path.
        pose: where joints are held, deg or mm by name; those that aren't given are held at zero.
        ask: tells the person what happens next and returns when it may; raises if it may not.
        simulate: the emulated bus whatever the rig names.

    Raises:
        StationError: a bad rig, a pose outside the limits.
        CalibrationError: the arm moved while it was read.
        DriverError: a servo that isn't there, or another than the rig says.
    """
    table, _, path = read_rig(rig)
    check_arm(table, str(path))
    states = reference_states(table.limits(), pose)
    said = ", ".join(f"{joint.name} {joint.text(q)}" for joint, q in zip(table.limits(), states, strict=True))
    with open_bus(table, str(path), simulate=simulate) as opened:
        joints = reference_joints(opened, states)
        release(opened.arm, ask)
        ask(f"put the arm into its reference pose: {said}. {HOLD}")
        counts = read_counts(opened)
    zeros = find_zeros(joints, counts, disagreement_rad=float(np.radians(table.safety.disagreement_deg)))
    keys = [("joint", j, "servo", s, "zero") for j, joint in enumerate(joints) for s in range(len(joint.servos))]
    units = tuple(joint.unit for joint in joints for _ in joint.servos)
    return ServoZeros(zeros, units, tuple(keys), said)


def scale_of(session: Path, known_m: Mapping[tuple[str, str], float]) -> Scale:
    """Whether a fitted session's lengths are right, by what is known of its arm.

    Args:
        known_m: distances of pairs of joints' axes [m]; prismatic joints with read-back are taken by themselves.

    Raises:
        StationError: the session isn't fitted, or has no such joints.
        CalibrationError: nothing is known.
    """
    from station.recording import Recording

    recording, fitted = Recording.load(session), read_fit(session / FIT_FOLDER)
    comparison = compare_logs(fitted.states, recording.commanded, recording.measured, types=joint_types(fitted.tree))
    return combine_lengths([*prismatic_travels(comparison), *axis_distances(fitted.tree, known_m)])


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
