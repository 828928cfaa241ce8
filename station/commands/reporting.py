"""Comparisons of fitted sessions with what was commanded or read back, and their reports."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from station.commands.fitting import Session, joint_types, load_session
from station.compare import Comparison
from station.compare import compare as compare_logs
from station.comparison_files import write_comparison
from station.errors import StationError
from station.fit_files import read_fit
from station.formats.read import read_commands
from station.formats.rig import parse_rig
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray, JointLog
from station.session import (
    FIT_FOLDER,
    REPORT_FOLDER,
    read_status,
)

if TYPE_CHECKING:
    from station.recording import Recording

# A lag between read-back and camera that is worth a warning: over this, and over three standard deviations.
NOTABLE_LAG_S = 0.005


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
    return report_compared(session, commands)


def report_compared(session: Path, commands: Path | None) -> Comparison:
    """Compare a session and write its report; raises StationError where there is nothing to compare with."""
    from station.report import write_report

    comparison, recording, tree, states = _compare(session, commands)
    viewing = _viewing_of_joints(load_session(session), comparison, tree)
    warnings = (*recording.notices, *tree.warnings, *_lag_warnings(comparison, recording))
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


def _lag_warnings(comparison: Comparison, recording: Recording) -> tuple[str, ...]:
    """Say how far the camera trails the servos, where that is certain and large enough to matter."""
    from station.report import session_lag_text

    lag, rig = comparison.lag, recording.description.rig
    if comparison.clock_lag_s is not None or not lag.std_s or abs(lag.applied_s) < max(NOTABLE_LAG_S, 3 * lag.std_s):
        return ()
    before_s = 0.0 if rig is None else parse_rig(rig, "rig").camera.latency_s
    advice = (
        f"set latency_s = {before_s + lag.applied_s:.4f} under [camera] in the rig: the next session then needs none"
    )
    return (f"{session_lag_text(comparison)}\n{advice}",)
