"""What the command line does, as functions: plan, capture, fit, compare, report, run, demo, view.

Each takes paths and options, returns values, and raises StationError or DriverError; printing is left to the caller.
rerun, OpenCV and matplotlib are imported where they are used: they take a second.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.lag import combined_lag
from station.compare import Comparison
from station.compare import compare as compare_logs
from station.comparison_files import write_comparison
from station.errors import InvalidData, InvalidFile, StationError
from station.fit.learner import Fit, FitOptions, learn
from station.fit_files import read_fit, write_fit
from station.formats.camera import format_camera, parse_camera
from station.formats.markers import format_markers, parse_markers
from station.formats.motion import parse_motion
from station.formats.read import read_commands, read_pose_log
from station.formats.rig import parse_rig
from station.formats.text import read_text
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray, JointLog, PoseLog
from station.motion import JointLimits, Plan, plan_motion
from station.session import (
    FIT_FOLDER,
    RECORDING_FILE,
    REPORT_FOLDER,
    SessionDescription,
    check_output_folder,
    read_status,
)
from station.smoothing import Smoother, smoother

if TYPE_CHECKING:
    from station.capture import CaptureCounts, Progress
    from station.recording import Recording
    from station.releasing import Ask
    from station.rig import Rig, RigFile
    from station.tracking import TrackedParts

# In the order of the report's facts.
VERSIONED = ("capture-fit-station", "numpy", "scipy", "opencv-contrib-python-headless", "rerun-sdk", "dynamixel-sdk")
# A lag between read-back and camera that is worth a warning: over this, and over three standard deviations.
NOTABLE_LAG_S = 0.005
NS_PER_S = 1e9


def versions() -> dict[str, str]:
    """Versions of the station and of what its numbers depend on."""
    return {name: metadata.version(name) for name in VERSIONED}


def plan(rig: str, motion: str) -> Plan:
    """Lay out a motion on a rig (names of packaged ones, or paths) and check all of it against the rig's limits."""
    from station.rig import load_rig

    return _plan(load_rig(rig), motion)[0]


def plan_rows(planned: Plan) -> list[list[str]]:
    """A table of a plan's legs, its header first."""
    rows = [["step", "at [s]", "move [s]", "hold [s]", "what moves"]]
    for leg in planned.segments:
        moves = [
            f"{joint.name} to {joint.text(there).replace('.0 ', ' ')}"
            for joint, here, there in zip(planned.joints, leg.q_from, leg.q_to, strict=True)
            if here != there
        ]
        rows.append([str(leg.step), f"{leg.t_start_s:.2f}", f"{leg.move_s:.2f}", f"{leg.hold_s:.2f}", ", ".join(moves)])
    return rows


def plan_document(planned: Plan) -> dict[str, object]:
    """A plan as JSON: duration and legs, in s, rad and m."""
    legs = [
        {
            "step": leg.step,
            "start_s": leg.t_start_s,
            "move_s": leg.move_s,
            "hold_s": leg.hold_s,
            "from": dict(zip([joint.name for joint in planned.joints], leg.q_from.tolist(), strict=True)),
            "to": dict(zip([joint.name for joint in planned.joints], leg.q_to.tolist(), strict=True)),
        }
        for leg in planned.segments
    ]
    units = {joint.name: joint.unit for joint in planned.joints}
    return {"motion": planned.motion.name, "duration_s": planned.duration_s, "units": units, "legs": legs}


def _plan(rig: RigFile, motion: str) -> tuple[Plan, str]:
    from station.rig_reading import check_arm, packaged, packaged_names

    check_arm(rig.table, rig.name)
    path = packaged("motions", motion)
    text = read_text(path, "motion", f"packaged ones are {', '.join(packaged_names('motions'))}")
    joints: tuple[JointLimits, ...] = rig.table.limits()
    return plan_motion(parse_motion(text, str(path), joints), joints), text


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
    planned, motion_text = _plan(rig_file, motion)
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


@dataclass(frozen=True)
class Session:
    """A recorded session as the fit takes it.

    Attributes:
        tracked: both candidates of every pose, and which was chosen.
        poses: of the tracked parts in the camera, at the middle of each frame's exposure.
        viewing: (T, K) rad between the line of sight and the normal of the part's marker; NaN where it was not seen.
    """

    recording: Recording
    tracked: TrackedParts
    poses: PoseLog
    viewing: FloatArray


def load_session(path: Path) -> Session:
    """Read a session's recording, and nothing else, and estimate its poses; raises StationError."""
    from station.recording import Recording
    from station.tracking import track_parts, viewing_angles_of_parts

    recording = Recording.load(path)
    about = recording.description
    rig = None if about.rig is None else parse_rig(about.rig, f"{path}: rig").camera
    latency_s, readout_s = (0.0, None) if rig is None else (rig.latency_s, rig.readout_s)
    seen = replace(recording.observations, t_s=recording.observations.t_s - latency_s)
    markers = parse_markers(about.markers, f"{path}: markers")
    camera = parse_camera(about.camera, f"{path}: camera")
    tracked = track_parts(seen, markers, camera, readout_s=readout_s)
    return Session(recording, tracked, tracked.poses, viewing_angles_of_parts(seen, markers))


def is_session(path: Path) -> bool:
    """Whether a path is a session folder or a recording."""
    return path.suffix == ".rrd" or (path / RECORDING_FILE).exists()


@dataclass(frozen=True)
class FitResult:
    """What a fit found and where it was written."""

    folder: Path
    fit: Fit
    notices: tuple[str, ...] = ()


def fit(
    source: Path,
    out: Path | None = None,
    *,
    options: FitOptions | None = None,
    smooth: str | None = None,
    force: bool = False,
) -> FitResult:
    """Discover the kinematic tree in a session, or in a log of poses, and write it.

    Writes kinematics.json, joint_states.csv, kinematics.urdf and a drawing of tree and states; for a session also
    fit.rrd, which the viewer shows together with the recording. The joints of a session with commands are named by the
    commanded joint that they follow.

    Args:
        source: a session folder, a recording, or a pose log in any format that is read.
        out: new or empty folder; for a session its own fit/ if None.
        options: how to fit.
        smooth: a smoother of the poses, see `station.smoothing.smoother`; it correlates the noise of neighbouring
            frames, which the fit takes for independent, so that what it states of its certainty is too good.
        force: overwrite an earlier fit in `out`.

    Raises:
        StationError: the input can't be read or has nothing to fit; `out` is occupied; there is no such smoother.
    """
    smoothed = smoother(smooth) if smooth else None
    if not source.exists():
        raise InvalidFile(f"no input '{source}'; want a session folder, a recording.rrd or a log of poses")
    session = load_session(source) if is_session(source) else None
    if out is None:
        if session is None or not source.is_dir():
            raise StationError(f"'{source}' is no session folder: name a folder for the result with --out")
        out = source / FIT_FOLDER
    check_output_folder(out, force=force)
    poses = read_pose_log(source) if session is None else session.poses
    notices = session.recording.notices if session else ()
    try:
        found, poses = _learned(poses, options, smoothed)
        if session is not None and (turned := _chosen_by_tree(session, found.tree)) is not None:
            found, poses = _learned(turned[0], options, smoothed)
            notices = (*notices, turned[1])
    except InvalidData as error:
        raise InvalidData(f"{source}: {error}") from error
    if session is not None:
        found = _named_by_commands(found, session.recording)
    write_fit(found, out, force=force)
    if session is not None and out == source / FIT_FOLDER:
        from station.recording import append_detected

        append_detected(source, found.states, found.tree, poses)
    return FitResult(out, found, notices)


def _learned(poses: PoseLog, options: FitOptions | None, smoothed: Smoother | None) -> tuple[Fit, PoseLog]:
    """A fit, and the poses that it is of."""
    poses = poses if smoothed is None else smoothed(poses)
    return learn(poses, options or FitOptions()), poses


def _chosen_by_tree(session: Session, tree: KinematicTree) -> tuple[PoseLog, str] | None:
    """The poses with ambiguous ones turned as the tree says, and how many; None if it turns none."""
    from station.kinematic_choice import choose_by_tree

    choice = choose_by_tree(session.tracked, tree)
    turned = int(np.count_nonzero(choice.chosen != session.tracked.choice.chosen))
    if not turned:
        return None
    poses = replace(session.tracked, choice=choice).poses
    return poses, f"{turned} ambiguous poses of markers seen from the front were turned over to agree with the tree"


def _named_by_commands(found: Fit, recording: Recording) -> Fit:
    """The same fit, its joints named by the commanded joints that they follow, and turned to increase with them."""
    matched = compare_logs(found.states, recording.commanded, recording.measured, types=joint_types(found.tree))
    names = {joint.fitted_joint: joint.joint for joint in matched.joints}
    signs = {joint.fitted_joint: joint.sign for joint in matched.joints}
    joints = tuple(
        replace(joint.with_sign(signs.get(joint.name, 1)), name=names.get(joint.name, joint.name))
        for joint in found.tree.joints
    )
    states = replace(
        found.states,
        joints=tuple(column for joint in joints for column in joint.columns),
        q=found.states.q * np.array([signs.get(name, 1) for name in found.states.joints]),
    )
    return replace(found, tree=replace(found.tree, joints=joints), states=states)


def joint_types(tree: KinematicTree) -> dict[str, str]:
    """Type of the joint that each column of joint states belongs to."""
    return {column: joint.type for joint in tree.joints for column in joint.columns}


def compare(session: Path, *, commands: Path | None = None) -> Comparison:
    """Compare a session's detected joint angles with its commands and read-back; writes into its report/.

    Args:
        commands: a commands.csv of another clock, in place of the recorded commands.

    Raises:
        StationError: the session isn't fitted, or has no commands.
    """
    return _compare(session, commands)[0]


def _compare(session: Path, commands: Path | None) -> tuple[Comparison, Recording, KinematicTree, JointLog]:
    from station.recording import Recording

    recording = Recording.load(session)
    fitted = read_fit(session / FIT_FOLDER)
    tree, states = fitted.tree, fitted.states
    if commands is None:
        commanded, measured = recording.commanded, recording.measured
        if not commanded.joints:
            raise StationError(
                f"{session} has neither commands nor read-back: nothing to compare with\n"
                "give commands with --commands FILE (t_s, then a column a joint)"
            )
    else:
        commanded, measured = read_commands(commands, tree.units), None
    comparison = compare_logs(states, commanded, measured, types=joint_types(tree), same_clock=commands is None)
    write_comparison(session / REPORT_FOLDER, comparison)
    return comparison, recording, tree, states


def report(session: Path, *, commands: Path | None = None) -> Comparison | None:
    """Compare a session and write its report: Figure 7, the tables and report.html; raises StationError.

    A session without commands, such as a video's, has nothing to be compared with: its report is the tree, the joints'
    states and when the parts were seen, and None comes back.
    """
    from station.recording import Recording

    if commands is None and not Recording.load(session).description.joints:
        _report_without_commands(session)
        return None
    return _report_compared(session, commands)


def _report_compared(session: Path, commands: Path | None) -> Comparison:
    from station.report import write_report

    comparison, recording, tree, states = _compare(session, commands)
    viewing = _viewing_of_joints(load_session(session), comparison, tree)
    warnings = (*recording.notices, *tree.warnings, *_lag_warnings(comparison))
    facts = _facts(session, recording) | ({"left alone": ", ".join(comparison.at_rest)} if comparison.at_rest else {})
    write_report(session / REPORT_FOLDER, comparison, tree, states, facts, viewing, warnings)
    return comparison


def _report_without_commands(path: Path) -> None:
    from station.report import Visibility, write_report

    session, fitted = load_session(path), read_fit(path / FIT_FOLDER)
    poses, recording = session.poses, session.recording
    seen = Visibility(poses.t_s, poses.parts, poses.seen, np.degrees(session.viewing))
    said = tuple(event.text for event in recording.events if event.level == "WARN")
    warnings = (*recording.notices, *said, *fitted.tree.warnings)
    write_report(path / REPORT_FOLDER, None, fitted.tree, fitted.states, _facts(path, recording), None, warnings, seen)


def _viewing_of_joints(
    session: Session, comparison: Comparison, tree: KinematicTree
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """For each compared joint, the best viewing angle [deg] of the markers on its child, over time [s]."""
    viewing: dict[str, tuple[FloatArray, FloatArray]] = {}
    for joint in comparison.joints:
        child = tree.joint(joint.fitted_joint).child
        trackers = [k for k, part in enumerate(session.poses.parts) if tree.body_of(part) == child]
        best = np.min(np.where(np.isnan(session.viewing), np.inf, session.viewing)[:, trackers], axis=1)
        viewing[joint.joint] = (session.poses.t_s, np.degrees(np.where(np.isinf(best), np.nan, best)))
    return viewing


def _facts(session: Path, recording: Recording) -> dict[str, str]:
    status = read_status(session)
    about = recording.description
    rig = None if about.rig is None else parse_rig(about.rig, "rig").name
    counts = {name.replace("_", " "): str(number) for name, number in status.counts.items()}
    return {
        "session": session.resolve().name,
        "state": status.state,
        "started": about.started.isoformat(timespec="seconds"),
        **({"rig": rig} if rig else {}),
        **({"moved": "by hand: compared with the read-back alone"} if _by_hand(recording) else {}),
        **({"seed": str(about.seed)} if about.seed is not None else {}),
        **counts,
        **about.versions,
    }


def _by_hand(recording: Recording) -> bool:
    return bool(len(recording.measured.t_s)) and not len(recording.commanded.t_s)


def _lag_warnings(comparison: Comparison) -> tuple[str, ...]:
    """Say how far the camera trails the servos, where that is certain and large enough to matter."""
    measured = [joint.against_measured for joint in comparison.joints if joint.against_measured is not None]
    lag = combined_lag(measured)
    if lag is None or abs(lag[0]) < max(NOTABLE_LAG_S, 3 * lag[1]):
        return ()
    trails = "trails" if lag[0] > 0 else "leads"
    return (
        f"the camera {trails} the servos by {abs(lag[0]) * 1e3:.1f} ms (std {lag[1] * 1e3:.1f} ms): "
        "add that to latency_s under [camera] in the rig",
    )


def run(
    rig: str, motion: str, out: Path, *, stage: Callable[[str], None] | None = None, **settings: object
) -> Comparison:
    """Capture, fit, compare and report: all of a session; settings as for `capture`; raises what each of them does."""
    say = stage or (lambda name: None)
    say("capture")
    capture(rig, motion, out, **settings)  # type: ignore[arg-type]
    say("fit")
    fit(out)
    say("report")
    return _report_compared(out, None)


def view(session: Path) -> None:
    """Open a session, with its fit if there is one, in the rerun viewer until it is closed; raises StationError."""
    from station.view import open_viewer

    with open_viewer(session) as viewer:
        viewer.wait()
