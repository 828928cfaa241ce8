"""Comparisons of fitted sessions with what was commanded or read back, and their reports."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from station.commands.fitting import joint_types, load_session
from station.compare import Comparison
from station.compare import compare as compare_logs
from station.comparison_files import write_comparison
from station.errors import StationError
from station.fit.result import Fit
from station.fit_files import TREE_FILE, read_fit, read_fit_residuals
from station.formats.read import read_commands
from station.formats.rig import parse_rig
from station.session import FIT_FOLDER, RECORDING_FILE, REPORT_FOLDER, read_status

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
    from station.recording import Recording

    comparison = _compared(session, Recording.load(session), read_fit(session / FIT_FOLDER), commands)
    write_comparison(session / REPORT_FOLDER, comparison)
    return comparison


def _compared(session: Path, recording: Recording, fitted: Fit, commands: Path | None) -> Comparison:
    if commands is None:
        commanded, measured = recording.commanded, recording.measured
        if not commanded.joints:
            raise StationError(
                f"{session} has neither commands nor read-back: nothing to compare with\n"
                "give commands with --commands FILE (t_s, then a column a joint)"
            )
    else:
        commanded, measured = read_commands(commands, fitted.tree.units), None
    types = joint_types(fitted.tree)
    return compare_logs(fitted.states, commanded, measured, types=types, same_clock=commands is None)


def report(session: Path, *, commands: Path | None = None) -> Comparison | None:
    """Compare a session and write its report: Figure 7, the tables and report.html; raises StationError.

    A session without commands, such as a video's, has nothing to be compared with, nor has one in which no marker was
    seen: its report is what there is, and None comes back. The same goes for a folder that a log of poses was fitted
    into.
    """
    from station.recording import Recording

    if (session / TREE_FILE).exists() and not (session / RECORDING_FILE).exists():
        _report_fit(session)
        return None
    recording = Recording.load(session)
    blind = not len(recording.observations) and not (session / FIT_FOLDER / TREE_FILE).exists()
    if blind or (commands is None and not recording.description.joints):
        _write(session, None, compared=False)
        return None
    return report_compared(session, commands)


def report_compared(session: Path, commands: Path | None) -> Comparison:
    """Compare a session and write its report; raises StationError where there is nothing to compare with."""
    comparison = _write(session, commands, compared=True)
    if comparison is None:
        raise StationError(f"no marker was seen in {session}: nothing to compare")
    return comparison


def _write(path: Path, commands: Path | None, *, compared: bool) -> Comparison | None:
    """The report of a session, with its comparison if it has one."""
    from station.commands.report_material import session_material
    from station.report import write_report

    session = load_session(path)
    recording = session.recording
    blind = not len(recording.observations)
    fitted = None if blind and not (path / FIT_FOLDER / TREE_FILE).exists() else read_fit(path / FIT_FOLDER)
    comparison = _compared(path, recording, fitted, commands) if compared and fitted is not None else None
    said = tuple(event.text for event in recording.events if event.level == "WARN")
    warnings = [*recording.notices, *said, *(("no marker was seen in any frame",) if blind else ())]
    warnings += fitted.tree.warnings if fitted is not None else ()
    warnings += _lag_warnings(comparison, recording) if comparison is not None else ()
    residuals = read_fit_residuals(path / FIT_FOLDER)
    material = session_material(path, session, read_status(path), fitted, comparison, warnings, residuals)
    write_report(path / REPORT_FOLDER, material)
    return comparison


def _report_fit(folder: Path) -> None:
    """The report of a fit alone."""
    from station.report import Material, Redoing, write_report

    fitted = read_fit(folder)
    redoing = Redoing(method=fitted.tree.method)
    material = Material(
        folder.resolve().name,
        fit=fitted,
        residuals=read_fit_residuals(folder),
        warnings=fitted.tree.warnings,
        redoing=redoing,
    )
    write_report(folder / REPORT_FOLDER, material)


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
