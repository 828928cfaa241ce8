"""The fit's joint states and axes in a rerun file beside the recording, so that the viewer shows both as one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from station.logs import FloatArray, JointLog, PoseLog
from station.recording import scene
from station.recording.layout import AXES, CAMERA_FRAME, DETECTED, ELAPSED
from station.recording.reader import Recording
from station.recording.rrd_stream import forget_ended_streams, open_stream, written
from station.session import FIT_FILE, FIT_FOLDER

if TYPE_CHECKING:
    from station.kinematics.tree import Joint, KinematicTree

S_TO_NS = 1e9
# Length of an axis, and radius of a ball's centre, as they are drawn, m.
AXIS_M = 0.12
CENTRE_RADIUS_M = 0.008


def append_detected(
    folder: Path, detected: JointLog, tree: KinematicTree | None = None, poses: PoseLog | None = None
) -> Path:
    """Write fit/fit.rrd beside a session's recording, replacing an earlier one; returns its path.

    Args:
        folder: the session's folder.
        detected: joint states at seconds since the session's start; NaN where a joint wasn't seen.
        tree: with `poses`, draws each joint's axis, or a ball's centre, where its parent was seen.
        poses: the parts' poses in the camera's frame.

    Raises:
        InvalidFile: the folder has no recording that can be read.
        StationError: the file can't be written.
    """
    recording = Recording.load(folder)
    target = folder / FIT_FOLDER / FIT_FILE
    target.parent.mkdir(exist_ok=True)
    part = target.with_name(f"{FIT_FILE}.part")
    states = _in_order(detected, recording.description.joints, recording.description.units)
    with written(part):
        _write(part, recording.recording_id, states, tree, poses)
    forget_ended_streams()
    return part.replace(target)


def _write(path: Path, recording_id: str, states: JointLog, tree: KinematicTree | None, poses: PoseLog | None) -> None:
    stream = open_stream(recording_id)
    stream.set_sinks(rr.FileSink(path))
    _send_states(stream, states)
    if tree is not None and poses is not None:
        for joint, colour in zip(tree.joints, scene.colours(len(tree.joints)), strict=True):
            _send_place(stream, joint, poses, colour)
    stream.flush()
    stream.disconnect()


def _times(t_s: FloatArray) -> rr.TimeColumn:
    return rr.TimeColumn(ELAPSED, duration=np.round(t_s * S_TO_NS).astype("timedelta64[ns]"))


def _in_order(detected: JointLog, joints: tuple[str, ...], units: tuple[str, ...]) -> JointLog:
    """The states with the session's joints first, NaN where not detected: the viewer shows a joint by its position."""
    extra = tuple(joint for joint in detected.joints if joint not in joints)
    absent = np.full(len(detected.t_s), np.nan)
    columns = [detected.state(joint) if joint in detected.joints else absent for joint in (*joints, *extra)]
    extra_units = tuple(detected.units[detected.joints.index(joint)] for joint in extra)
    q = np.stack(columns, axis=1) if columns else detected.q
    return JointLog(detected.t_s, joints + extra, q, units + extra_units)


def _send_states(stream: rr.RecordingStream, detected: JointLog) -> None:
    stream.log(DETECTED, scene.detected_series(detected.joints, detected.units), static=True)
    counts = np.full(len(detected.t_s), len(detected.joints))
    columns = rr.Scalars.columns(scalars=detected.q.ravel()).partition(counts)
    stream.send_columns(DETECTED, indexes=[_times(detected.t_s)], columns=columns)


def _send_place(stream: rr.RecordingStream, joint: Joint, poses: PoseLog, colour: scene.Colour) -> None:
    """The joint's axis as an arrow whenever its parent was seen, through the parent's origin where it has no point; a
    ball's centre as a dot.
    """
    axis, point = joint.axis_parent, joint.point_parent_m
    if (axis is None and point is None) or joint.parent not in poses.parts:
        return
    T_cam_parent = poses.T_ref_part[:, poses.parts.index(joint.parent)]
    seen = np.isfinite(T_cam_parent[:, 0, 0])
    T = T_cam_parent[seen]
    middle = T[:, :3, 3] if point is None else T[:, :3, :3] @ point + T[:, :3, 3]
    entity = f"{AXES}/{joint.name}"
    if axis is None:
        look: rr.AsComponents = rr.Points3D.from_fields(colors=[colour], labels=[joint.name], radii=[CENTRE_RADIUS_M])
        columns = rr.Points3D.columns(positions=middle)
    else:
        axis_cam = T[:, :3, :3] @ axis * AXIS_M
        look = rr.Arrows3D.from_fields(colors=[colour], labels=[joint.name])
        columns = rr.Arrows3D.columns(origins=middle - axis_cam / 2, vectors=axis_cam)
    stream.log(entity, rr.CoordinateFrame(CAMERA_FRAME), look, static=True)
    stream.send_columns(entity, indexes=[_times(poses.t_s[seen])], columns=columns)
