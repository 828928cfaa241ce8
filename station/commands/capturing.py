"""Captures: a motion on a rig, or an arm or object that people move by hand, into a session folder."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from station.commands.planning import planned_motion
from station.formats.camera import format_camera
from station.formats.markers import format_markers
from station.motion import JointLimits, Plan
from station.session import (
    SessionDescription,
    check_output_folder,
)

if TYPE_CHECKING:
    from station.capture import CaptureCounts, Progress
    from station.releasing import Ask
    from station.rig import Rig, RigFile

# In the order of the report's facts.
VERSIONED = ("capture-fit-station", "numpy", "scipy", "opencv-contrib-python-headless", "rerun-sdk", "dynamixel-sdk")


def versions() -> dict[str, str]:
    """Versions of the station and of what its numbers depend on."""
    return {name: metadata.version(name) for name in VERSIONED}


def capture(
    rig: str,
    motion: str,
    out: Path,
    *,
    seed: int | None = None,
    simulate: bool = False,
    realtime: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> CaptureCounts:
    """Run a motion on a rig into the session folder `out`.

    Args:
        rig, motion: names of packaged ones, or paths.
        seed: of everything random in a simulation.
        simulate: emulated bus and rendered camera whatever the rig names.
        realtime: the real clock also where all is simulated.
        force: overwrite an earlier session in `out`.
        progress: called with seconds done and in all.

    Raises:
        StationError: a bad rig or motion, an occupied folder, a recording that can't be written.
        DriverError: what the arm or the camera failed at; the session is then "interrupted".
    """
    from station.rig import load_rig

    rig_file = load_rig(rig)
    planned, motion_text = planned_motion(rig_file, motion)
    check_output_folder(out, force=force)
    return record_motion(
        rig_file,
        planned,
        motion_text,
        out,
        seed=seed,
        simulate=simulate,
        realtime=realtime,
        force=force,
        progress=progress,
    )


def record_motion(
    rig_file: RigFile,
    planned: Plan,
    motion_text: str,
    out: Path,
    *,
    seed: int | None = None,
    simulate: bool = False,
    realtime: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> CaptureCounts:
    """Run a planned motion on a rig into the session folder `out`; settings and errors as for `capture`."""
    from station.capture import Capture
    from station.recording import RecordingWriter
    from station.rig import open_rig
    from station.view import session_blueprint

    joints = tuple(joint.name for joint in planned.joints)
    with open_rig(rig_file, simulate=simulate, realtime=realtime, seed=seed) as opened:
        description = _description(rig_file, opened, planned.joints, motion_text)
        start_ns = opened.clock.now_ns()
        blueprint = session_blueprint(joints)
        with RecordingWriter(out, description, start_ns=start_ns, blueprint=blueprint, force=force) as writer:
            return Capture(opened, planned, writer, progress).run()


def capture_by_hand(
    rig: str,
    out: Path,
    *,
    ask: Ask,
    duration_s: float | None = None,
    seed: int | None = None,
    simulate: bool = False,
    realtime: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> CaptureCounts:
    """Record an arm without torque, or an object of a rig without one, that people move by hand, into `out`.

    Args:
        ask: is told before torque that is on is switched off; raises if that may not be.
        duration_s: until a KeyboardInterrupt if None; in a simulation until the made hand has done.

    Other settings and errors as for `capture`.
    """
    from station.hand_capture import HandCapture, take_in_hand
    from station.hand_motion import free_joints, hand_motion
    from station.recording import RecordingWriter
    from station.rig import RENDERED, load_rig, open_rig
    from station.view import session_blueprint

    rig_file = load_rig(rig)
    check_output_folder(out, force=force)
    table, by_hand = rig_file.table, None
    limits = table.limits()
    if table.simulation is not None and (simulate or table.camera.source == RENDERED):
        by_hand = hand_motion(limits or free_joints(table.simulation.units()), duration_s)
        duration_s = duration_s or by_hand.duration_s
    joints = tuple(joint.name for joint in limits)
    with open_rig(rig_file, simulate=simulate, realtime=realtime, seed=seed, by_hand=by_hand) as opened:
        take_in_hand(opened, ask)
        description = _description(rig_file, opened, limits, None)
        start_ns = opened.clock.now_ns()
        blueprint = session_blueprint(joints)
        with RecordingWriter(out, description, start_ns=start_ns, blueprint=blueprint, force=force) as writer:
            return HandCapture(opened, writer, duration_s=duration_s, progress=progress).run()


def _description(
    rig_file: RigFile, opened: Rig, limits: Sequence[JointLimits], motion: str | None
) -> SessionDescription:
    return SessionDescription(
        camera=format_camera(opened.camera_model),
        markers=format_markers(opened.markers),
        joints=tuple(joint.name for joint in limits),
        units=tuple(joint.unit for joint in limits),
        rig=rig_file.text,
        motion=motion,
        started=datetime.now(UTC),
        seed=opened.seed,
        versions=versions(),
    )
