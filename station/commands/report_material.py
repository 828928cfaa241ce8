"""Gathers what a session's report is made of: from its folder, its recording, its fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drivers.errors import DriverError
from station.commands.fitting import Session
from station.compare import Comparison
from station.fit.image_checks import Residuals
from station.fit.result import Fit
from station.formats.rig import RigTable, parse_rig
from station.kinematics import se3
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray, PoseLog
from station.report import Material, Redoing, Servos, Timing, Viewing, Visibility
from station.rig_reading import joint_configs
from station.session import MOTION_FILE, RIG_FILE, SessionStatus

if TYPE_CHECKING:
    from station.recording import Recording

NS_PER_S = 1e9
# A root that moved farther than this before the camera, or a camera that was moved, has no one place for the camera.
STILL_M = 0.03


def session_material(
    path: Path,
    session: Session,
    status: SessionStatus,
    fit: Fit | None,
    comparison: Comparison | None,
    warnings: Sequence[str],
    residuals: Residuals | None = None,
) -> Material:
    """All that the report of a session tells."""
    recording, poses = session.recording, session.poses
    about = recording.description
    rig = None if about.rig is None else parse_rig(about.rig, "rig")
    viewing = None if comparison is None or fit is None else viewing_of_joints(session, comparison, fit.tree)
    return Material(
        title=path.resolve().name,
        facts=_facts(recording, status, rig, comparison),
        fit=fit,
        residuals=residuals,
        comparison=comparison,
        viewing=viewing,
        readback_steps=_readback_steps(rig),
        warnings=warnings,
        visibility=Visibility(poses.t_s, poses.parts, poses.seen, np.degrees(session.viewing)),
        T_root_camera=None if fit is None else _camera_in_root(poses, fit.tree.root),
        timing=_timing(recording, rig),
        servos=_servos(recording, rig),
        counts=status.counts,
        events=recording.events,
        redoing=_redoing(recording, fit, rig),
    )


def viewing_of_joints(session: Session, comparison: Comparison, tree: KinematicTree) -> Viewing:
    """For each compared joint, the best viewing angle [deg] of the markers on its child, over time [s]."""
    viewing: dict[str, tuple[FloatArray, FloatArray]] = {}
    for joint in comparison.joints:
        child = tree.joint(joint.fitted_joint).child
        trackers = [k for k, part in enumerate(session.poses.parts) if tree.body_of(part) == child]
        best = np.min(np.where(np.isnan(session.viewing), np.inf, session.viewing)[:, trackers], axis=1)
        viewing[joint.joint] = (session.poses.t_s, np.degrees(np.where(np.isinf(best), np.nan, best)))
    return viewing


def _facts(
    recording: Recording, status: SessionStatus, rig: RigTable | None, comparison: Comparison | None
) -> dict[str, str]:
    about = recording.description
    at_rest = () if comparison is None else comparison.at_rest
    by_hand = bool(len(recording.measured.t_s)) and not len(recording.commanded.t_s)
    return {
        "state": status.state,
        "started": about.started.isoformat(timespec="seconds"),
        **({"rig": rig.name} if rig is not None else {}),
        **({"moved": "by hand: compared with the read-back alone"} if by_hand else {}),
        **({"seed": str(about.seed)} if about.seed is not None else {}),
        **({"left alone": ", ".join(at_rest)} if at_rest else {}),
    }


def _readback_steps(rig: RigTable | None) -> dict[str, float]:
    """Of each joint's first servo; nothing where its model isn't known."""
    try:
        joints = () if rig is None else joint_configs(rig)
    except DriverError:
        return {}
    return {joint.name: joint.servos[0].table.rad_per_count / joint.servos[0].ratio for joint in joints}


def _camera_in_root(poses: PoseLog, root: str) -> FloatArray | None:
    """(4, 4) where the camera stood; None where it isn't known, or the root moved before it."""
    if poses.reference != "camera":
        return None
    if root == poses.reference:
        return np.eye(4)
    if root not in poses.parts:
        return None
    column = poses.parts.index(root)
    T_root_camera = se3.inverse(poses.T_ref_part[poses.seen[:, column], column])
    if not len(T_root_camera) or np.max(np.std(T_root_camera[:, :3, 3], axis=0)) > STILL_M:
        return None
    return se3.mean(T_root_camera)


def _timing(recording: Recording, rig: RigTable | None) -> Timing:
    elapsed_s = (recording.stamps_ns - recording.start_ns) / NS_PER_S
    camera = None if rig is None else rig.camera
    return Timing(
        frame_s=recording.observations.t_s,
        frame_index=recording.frame_index,
        request_s=elapsed_s[:, 0],
        reply_s=elapsed_s[:, 1],
        latency_s=0.0 if camera is None else camera.latency_s,
        fps=None if camera is None else camera.fps,
    )


def _servos(recording: Recording, rig: RigTable | None) -> Servos | None:
    log = recording.servos
    if not len(log.t_s):
        return None
    return Servos(log.t_s, _servo_names(log.ids, rig), log.temperature_c, log.voltage_v, log.load)


def _servo_names(ids: Sequence[int], rig: RigTable | None) -> tuple[str, ...]:
    """The joint that each turns, and its number."""
    joints = {} if rig is None else {servo.id: joint.name for joint in rig.joint for servo in joint.servo}
    return tuple(f"{joints[n]} ({n})" if n in joints else f"servo {n}" for n in ids)


def _redoing(recording: Recording, fit: Fit | None, rig: RigTable | None) -> Redoing:
    about = recording.description
    texts = {RIG_FILE: about.rig, MOTION_FILE: about.motion, "camera.toml": about.camera, "markers.toml": about.markers}
    files = {name: text for name, text in texts.items() if text is not None}
    method = {} if fit is None else dict(fit.tree.method)
    lines = [*_capture_lines(recording, files), _fit_line(method), "station report ."]
    return Redoing(lines if rig is not None else lines[-2:], files, dict(about.versions), method)


def _capture_lines(recording: Recording, files: Mapping[str, str]) -> list[str]:
    seed = recording.description.seed
    seeded = "" if seed is None else f" --seed {seed} --simulate"
    moved = MOTION_FILE if MOTION_FILE in files else "--hand"
    return [f"station capture {RIG_FILE} {moved} --out ../again{seeded}"] if RIG_FILE in files else []


def _fit_line(method: Mapping[str, object]) -> str:
    """With the options that differ from the usual ones, as far as kinematics.json tells them."""
    words = ["station fit . --force"]
    if (name := method.get("name", "station")) != "station":
        words.append(f"--method {name}")
    if (criterion := method.get("criterion", "evidence")) != "evidence" and name == "station":
        words.append(f"--criterion {criterion}")
    types = method.get("joint_types")
    if isinstance(types, list | tuple) and list(types) != ["rigid", "prismatic", "revolute"]:
        words.append(f"--joint-types {','.join(map(str, types))}")
    return " ".join(words)
