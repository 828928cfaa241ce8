"""Fits of sessions and of logs of poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from station.compare import compare as compare_logs
from station.errors import InvalidData, InvalidFile, StationError
from station.fit.learner import Fit, FitOptions, learn
from station.fit_files import write_fit
from station.formats.camera import parse_camera
from station.formats.markers import parse_markers
from station.formats.read import read_pose_log
from station.formats.rig import parse_rig
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray, PoseLog
from station.session import (
    FIT_FOLDER,
    RECORDING_FILE,
    check_output_folder,
)
from station.smoothing import Smoother, smoother

if TYPE_CHECKING:
    from station.recording import Recording
    from station.tracking import TrackedParts

# Markers of all frames that a fit takes into account. Reading, tracking and learning want some 10 kB of memory for each
# at once, which makes 2 GB; of longer sessions frames are left out, evenly, and it is said.
MOST_MARKERS = 200_000


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


def load_session(path: Path, *, most_markers: int | None = MOST_MARKERS) -> Session:
    """Read a session's recording, and nothing else, and estimate its poses; raises StationError.

    Args:
        most_markers: of all frames; of a session with more, frames are left out evenly, with a notice; all of them
            count if None.
    """
    from station.recording import Recording
    from station.tracking import track_parts, viewing_angles_of_parts

    recording = Recording.load(path, most_markers=most_markers)
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
