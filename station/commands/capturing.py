"""Captures: a motion on a rig, or an arm or object that people move by hand, into a session folder."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

from station.commands.planning import planned_motion
from station.errors import InvalidData
from station.formats.camera import format_camera, parse_camera
from station.formats.markers import format_markers
from station.motion import Plan
from station.session import (
    MOTION_FILE,
    RIG_FILE,
    Checkpoint,
    SessionDescription,
    check_output_folder,
    read_status,
)

if TYPE_CHECKING:
    from station.capture.control import Control
    from station.capture.counts import CaptureCounts
    from station.capture.live_view import LiveView
    from station.capture.servo_loop import Progress
    from station.capture.snapshot import Watcher
    from station.commands.live import LiveServer
    from station.hand_motion import HandMotion
    from station.recording import RecordingWriter
    from station.releasing import Ask
    from station.rig import Rig, RigFile

# On a virtual clock a session goes on so long after its last row: how long the machine took is of no account.
VIRTUAL_GAP_S = 1.0
# In the order of the report's facts.
VERSIONED = ("capture-fit-station", "numpy", "scipy", "opencv-contrib-python-headless", "rerun-sdk", "dynamixel-sdk")


def versions() -> dict[str, str]:
    """Versions of the station and of what its numbers depend on."""
    return {name: metadata.version(name) for name in VERSIONED}


class CaptureSettings(TypedDict, total=False):
    """How a capture is made.

    Attributes:
        seed: of everything random in a simulation.
        simulate: emulated bus and rendered camera whatever the rig names.
        realtime: the real clock also where all is simulated.
        force: overwrite an earlier session in the folder.
        frames: how images are kept: "jpeg" (if not given), "none", or "ffv1", without loss.
        progress: called with seconds done and in all.
        control: what people ask of the capture while it runs: pause, go on, stop.
        watch: called some times a second with what the capture is doing.
        live: serves a live view of the capture.
    """

    seed: int | None
    simulate: bool
    realtime: bool
    force: bool
    frames: str
    progress: Progress | None
    control: Control | None
    watch: Watcher | None
    live: LiveServer | None


def capture(rig: str, motion: str, out: Path, **settings: Unpack[CaptureSettings]) -> CaptureCounts:
    """Run a motion on a rig (names of packaged ones, or paths) into the session folder `out`.

    Raises:
        StationError: a bad rig or motion, an occupied folder, a recording that can't be written.
        DriverError: what the arm or the camera failed at; the session is then "interrupted".
    """
    from station.rig import load_rig

    rig_file = load_rig(rig)
    planned, motion_text = planned_motion(rig_file, motion)
    return record_motion(rig_file, planned, motion_text, out, **settings)


def record_motion(
    rig_file: RigFile, planned: Plan, motion_text: str, out: Path, **settings: Unpack[CaptureSettings]
) -> CaptureCounts:
    """Run a planned motion on a rig into the session folder `out`; errors as for `capture`."""
    from station.capture.service import Capture

    check_output_folder(out, force=settings.get("force", False))
    with (
        _opened(rig_file, settings) as opened,
        _writer(rig_file, opened, motion_text, out, settings) as writer,
        _live_view(opened, writer, out, settings) as live,
    ):
        return Capture(opened, planned, writer, live=live, **_wishes(settings)).run()


def resume(session: Path, **settings: Unpack[CaptureSettings]) -> CaptureCounts:
    """Go on with an interrupted session, also one that was killed, from its last checkpoint, into the same folder.

    Rig, motion and camera are the session's own copies. The arm goes slowly from where it stands to where the leg that
    was cut begins, and does that leg again. A session of a simulation goes on in the simulation, with its seed.

    Returns the counts of what is captured now; session.json has those of the whole session.

    Raises:
        InvalidData: it was recorded by hand, or its motion.toml isn't the one that it was captured with.
        StationError: there is nothing to go on with: no session, a complete one, or one that is being recorded.
        DriverError: as for `capture`.
    """
    from station.capture.service import Capture
    from station.recording import Recording, RecordingWriter
    from station.view import session_blueprint

    check_resumable(session)
    about = Recording.load(session).description
    rig_file = _own_rig(session, about)
    planned, text = planned_motion(rig_file, str(session / MOTION_FILE))
    if text != about.motion:
        raise InvalidData(
            f"{session / MOTION_FILE} isn't the motion that the session was captured with\n"
            "put the session's own back (the recording has it, the report shows it), or record into another folder"
        )
    first_leg = _leg_to_go_on_from(session, planned, read_status(session).progress)
    settings["seed"] = about.seed
    settings["simulate"] = about.seed is not None
    with (
        _opened(rig_file, settings) as opened,
        RecordingWriter.resume(
            session,
            now_ns=opened.clock.now_ns(),
            since_last_s=VIRTUAL_GAP_S if opened.virtual else None,
            blueprint=session_blueprint(about.joints),
        ) as writer,
        _live_view(opened, writer, session, settings) as live,
    ):
        return Capture(opened, planned, writer, live=live, first_leg=first_leg, **_wishes(settings)).run()


def check_resumable(session: Path) -> None:
    """Raise StationError unless the session is an interrupted one with a motion."""
    if read_status(session).state == "complete":
        raise InvalidData(f"{session} is complete: there is nothing to go on with; record into another folder")
    if not (session / MOTION_FILE).is_file():
        raise InvalidData(
            f"{session} was recorded by hand: nobody knows where it is to go on; record into another folder"
        )


def _own_rig(session: Path, about: SessionDescription) -> RigFile:
    """The rig as the session has it, with the camera as it was calibrated then."""
    from station.rig import RigFile
    from station.rig_reading import read_rig

    table, text, path = read_rig(str(session / RIG_FILE))
    return RigFile(table, text, str(path), parse_camera(about.camera, f"{session}, camera.toml"))


def _leg_to_go_on_from(session: Path, planned: Plan, reached: Checkpoint | None) -> int:
    if reached is None:
        return 0
    if reached.legs != len(planned.segments):
        raise InvalidData(
            f"{session / MOTION_FILE} has {len(planned.segments)} legs; the session was captured with {reached.legs}\n"
            "put the session's own motion.toml back, or record into another folder"
        )
    return reached.leg


def capture_by_hand(
    rig: str, out: Path, *, ask: Ask, duration_s: float | None = None, **settings: Unpack[CaptureSettings]
) -> CaptureCounts:
    """Record an arm without torque, or an object of a rig without one, that people move by hand, into `out`.

    Args:
        ask: is told before torque that is on is switched off; raises if that may not be.
        duration_s: until a KeyboardInterrupt if None; in a simulation until the made hand has done.

    Errors as for `capture`.
    """
    from station.capture.by_hand import HandCapture, take_in_hand
    from station.hand_motion import free_joints, hand_motion
    from station.rig import RENDERED, load_rig

    rig_file = load_rig(rig)
    check_output_folder(out, force=settings.get("force", False))
    table, by_hand = rig_file.table, None
    if table.simulation is not None and (settings.get("simulate") or table.camera.source == RENDERED):
        by_hand = hand_motion(table.limits() or free_joints(table.simulation.units()), duration_s)
        duration_s = duration_s or by_hand.duration_s
    with _opened(rig_file, settings, by_hand) as opened:
        take_in_hand(opened, ask)
        with (
            _writer(rig_file, opened, None, out, settings) as writer,
            _live_view(opened, writer, out, settings) as live,
        ):
            return HandCapture(opened, writer, duration_s=duration_s, live=live, **_wishes(settings)).run()


def _opened(
    rig_file: RigFile, settings: CaptureSettings, by_hand: HandMotion | None = None
) -> AbstractContextManager[Rig]:
    from station.rig import open_rig

    return open_rig(
        rig_file,
        simulate=settings.get("simulate", False),
        realtime=settings.get("realtime", False),
        seed=settings.get("seed"),
        by_hand=by_hand,
    )


class _Wishes(TypedDict):
    progress: Progress | None
    control: Control | None
    watch: Watcher | None


def _wishes(settings: CaptureSettings) -> _Wishes:
    """Those of the settings that are for the capture itself."""
    return {
        "progress": settings.get("progress"),
        "control": settings.get("control"),
        "watch": settings.get("watch"),
    }


def _live_view(
    opened: Rig, writer: RecordingWriter, out: Path, settings: CaptureSettings
) -> AbstractContextManager[LiveView | None]:
    """The live view of a session, if one is wanted."""
    server = settings.get("live")
    return nullcontext() if server is None else server.serving(out.resolve().name, writer, opened.clock.now_ns)


def _writer(
    rig_file: RigFile, opened: Rig, motion: str | None, out: Path, settings: CaptureSettings
) -> RecordingWriter:
    """The recording of a session that starts now."""
    from station.recording import RecordingWriter
    from station.view import session_blueprint

    limits = opened.table.limits()
    joints = tuple(joint.name for joint in limits)
    description = SessionDescription(
        camera=format_camera(opened.camera_model),
        markers=format_markers(opened.markers),
        joints=joints,
        units=tuple(joint.unit for joint in limits),
        rig=rig_file.text,
        motion=motion,
        started=datetime.now(UTC),
        seed=opened.seed,
        versions=versions(),
    )
    return RecordingWriter(
        out,
        description,
        start_ns=opened.clock.now_ns(),
        blueprint=session_blueprint(joints),
        force=settings.get("force", False),
        frames=settings.get("frames", "jpeg"),
    )
