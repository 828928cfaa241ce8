"""Captures: a motion on a rig, or an arm or object that people move by hand, into a session folder."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

import numpy as np

from station.commands.planning import planned_motion, room_remarks
from station.errors import InvalidData
from station.formats.camera import format_camera, parse_camera
from station.formats.markers import format_markers
from station.formats.text import read_text
from station.motion import Plan
from station.seen_columns import seen_columns
from station.session import (
    FIT_FOLDER,
    MOTION_FILE,
    NEXT_MOTION_FILE,
    RIG_FILE,
    Checkpoint,
    SessionDescription,
    SessionStatus,
    check_output_folder,
    motion_sha256,
    read_status,
    take_staged_motion,
)

if TYPE_CHECKING:
    from station.capture.control import Control
    from station.capture.counts import CaptureCounts
    from station.capture.live_view import LiveView
    from station.capture.servo_loop import Progress
    from station.capture.snapshot import Watcher
    from station.commands.live import LiveServer
    from station.enough_motion import MotionTally
    from station.formats.rig import RigTable
    from station.hand_motion import HandMotion
    from station.kinematics.tree import KinematicTree
    from station.recording import Recording, RecordingWriter
    from station.releasing import Ask
    from station.rig import Rig, RigFile

# On a virtual clock a session goes on so long after its last row: how long the machine took is of no account.
VIRTUAL_GAP_S = 1.0
# As the crew of a capture counts motion.
MOTION_EVERY_S = 0.1
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
        frames: how images are kept: "jpeg" (if not given), "none", or "ffv1", without loss; a session that is gone on
            with keeps its way.
        until_enough: add rounds of further motion, so many in a session at most, while a joint moved too little for a
            fit where the camera saw it; none if 0 or not given.
        progress: called with seconds done and in all.
        control: what people ask of the capture while it runs: pause, go on, stop.
        watch: called some times a second with what the capture is doing.
        live: serves a live view of the capture.
        tree: what the camera watches, as a fit found it: a kinematics.json, a URDF, the folder of a fit or of a fitted
            session. Joint states are then estimated frame by frame, shown, and recorded beside what is fitted later.
    """

    seed: int | None
    simulate: bool
    realtime: bool
    force: bool
    frames: str
    until_enough: int
    progress: Progress | None
    control: Control | None
    watch: Watcher | None
    live: LiveServer | None
    tree: str | Path | None


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
    check_output_folder(out, force=settings.get("force", False))
    _check_frames(settings)
    with _opened(rig_file, settings) as opened, _writer(rig_file, opened, motion_text, out, settings) as writer:
        return _captured(_Planned(rig_file, planned, motion_text), opened, writer, out, settings)


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
    from station.recording import Recording, RecordingWriter
    from station.view import session_blueprint

    check_resumable(session)
    recording = Recording.load(session)
    about = recording.description
    rig_file, status = _own_rig(session, about), read_status(session)
    planned, motion_text = _own_motion(session, rig_file, about, status)
    first_leg = _leg_to_go_on_from(session, planned, status.progress)
    moved = _moved_so_far(recording, rig_file.table)
    del recording  # hours of it are gigabytes
    settings["frames"] = status.images or "jpeg"
    _check_frames(settings)
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
    ):
        return _captured(_Planned(rig_file, planned, motion_text, first_leg, moved), opened, writer, session, settings)


@dataclass(frozen=True, eq=False)
class _Planned:
    """What is to be captured: a motion on a rig, from a leg on, and what was seen of it before."""

    rig_file: RigFile
    plan: Plan
    text: str
    first_leg: int = 0
    moved: MotionTally | None = None


def _captured(
    planned: _Planned, opened: Rig, writer: RecordingWriter, folder: Path, settings: CaptureSettings
) -> CaptureCounts:
    from station.capture.lengthening import Lengthening
    from station.capture.service import Capture

    with _live_view(opened, writer, folder, settings) as live:
        return Capture(
            opened,
            planned.plan,
            writer,
            live=live,
            first_leg=planned.first_leg,
            lengthening=Lengthening(planned.text, settings.get("until_enough", 0)),
            motion=planned.moved,
            remarks=room_remarks(planned.rig_file, planned.plan, folder, settings.get("frames", "jpeg")),
            **_wishes(planned.rig_file, settings),
        ).run()


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


def _own_motion(session: Path, rig_file: RigFile, about: SessionDescription, status: SessionStatus) -> tuple[Plan, str]:
    """The session's motion, lengthened if it was: also where a kill came before the new one was motion.toml."""
    own = status.motion_sha256 or motion_sha256(about.motion or "")
    staged = session / NEXT_MOTION_FILE
    if staged.exists() and motion_sha256(read_text(staged, "motion")) == own:
        take_staged_motion(session)
    planned, text = planned_motion(rig_file, str(session / MOTION_FILE))
    if motion_sha256(text) != own:
        raise InvalidData(
            f"{session / MOTION_FILE} isn't the motion that the session was captured with\n"
            "put the session's own back (the recording has it, the report shows it), or record into another folder"
        )
    return planned, text


def _moved_so_far(recording: Recording, table: RigTable) -> MotionTally:
    """What the session has seen of its joints' motion."""
    from station.enough_motion import MotionTally, sides_of

    tally, log, measured = MotionTally(table.limits(), sides_of(table)), recording.observations, recording.measured
    if not len(measured.t_s):
        return tally
    part_of = {marker.id: marker.part for marker in table.marker_table().markers}
    q = np.column_stack([np.interp(log.t_s, measured.t_s, states) for states in measured.q.T])
    starts = np.searchsorted(log.frame, np.arange(len(log.t_s) + 1))
    looked_s = -np.inf
    for row, t_s in enumerate(log.t_s):  # as seldom as the capture itself counts
        if t_s - looked_s >= MOTION_EVERY_S:
            looked_s = t_s
            seen = log.marker_id[starts[row] : starts[row + 1]].tolist()
            tally.add(q[row], {part_of[marker] for marker in seen if marker in part_of})
    return tally


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
    _check_frames(settings)
    table, by_hand = rig_file.table, None
    if table.simulation is not None and (settings.get("simulate") or table.camera.source == RENDERED):
        simulation = table.simulation
        by_hand = hand_motion(table.limits() or free_joints(simulation.units(), simulation.hand_limits()), duration_s)
        duration_s = duration_s or by_hand.duration_s
    with _opened(rig_file, settings, by_hand) as opened:
        take_in_hand(opened, ask)
        with (
            _writer(rig_file, opened, None, out, settings) as writer,
            _live_view(opened, writer, out, settings) as live,
        ):
            return HandCapture(opened, writer, duration_s=duration_s, live=live, **_wishes(rig_file, settings)).run()


def _check_frames(settings: CaptureSettings) -> None:
    """Raise StationError unless frames can be kept as wanted, before anything is made."""
    from station.recording.lossless import check_kind

    check_kind(settings.get("frames", "jpeg"))


def _opened(
    rig_file: RigFile, settings: CaptureSettings, by_hand: HandMotion | None = None
) -> AbstractContextManager[Rig]:
    from station.fit.image.live import StateFollower
    from station.rig import open_rig

    if (tree := _known_tree(settings)) is not None:
        StateFollower(tree, rig_file.table.marker_table().parts)  # before anything moves
    return open_rig(
        rig_file,
        simulate=settings.get("simulate", False),
        realtime=settings.get("realtime", False),
        seed=settings.get("seed"),
        by_hand=by_hand,
    )


class _Wishes(TypedDict):
    tree: KinematicTree | None
    progress: Progress | None
    control: Control | None
    watch: Watcher | None


def _wishes(rig_file: RigFile, settings: CaptureSettings) -> _Wishes:
    """Those of the settings that are for the capture itself."""
    from station.recording.sizes import expected_rates

    bytes_per_s = expected_rates(rig_file.table, settings.get("frames", "jpeg")).bytes_per_s
    watch = settings.get("watch")
    return {
        "tree": _known_tree(settings),
        "progress": settings.get("progress"),
        "control": settings.get("control"),
        "watch": None if watch is None else lambda shot: watch(replace(shot, bytes_per_s=bytes_per_s)),
    }


def _known_tree(settings: CaptureSettings) -> KinematicTree | None:
    """The tree that is told; raises InvalidFile."""
    from station.formats.trees import load_tree

    where = settings.get("tree")
    if where is None:
        return None
    fitted = Path(where) / FIT_FOLDER
    return load_tree(fitted if fitted.is_dir() else where)


def _live_view(
    opened: Rig, writer: RecordingWriter, out: Path, settings: CaptureSettings
) -> AbstractContextManager[LiveView | None]:
    """The live view of a session, if one is wanted."""
    server, tree = settings.get("live"), _known_tree(settings)
    if server is None:
        return nullcontext()
    seen = None if tree is None else seen_columns(opened.table, tree)
    return server.serving(out.resolve().name, writer, opened.clock.now_ns, seen)


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
