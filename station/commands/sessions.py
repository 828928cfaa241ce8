"""A whole session: captured, fitted, compared, reported; and the viewer on one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Unpack

from station.commands.capturing import CaptureSettings, capture
from station.commands.fitting import fit
from station.commands.reporting import report_compared
from station.compare import Comparison


def run(
    rig: str,
    motion: str,
    out: Path,
    *,
    stage: Callable[[str], None] | None = None,
    **settings: Unpack[CaptureSettings],
) -> Comparison:
    """Capture, fit, compare and report: all of a session; settings as for `capture`; raises what each of them does."""
    if stage is not None:
        stage("capture")
    capture(rig, motion, out, **settings)
    return conclude(out, stage=stage)


def conclude(session: Path, *, stage: Callable[[str], None] | None = None) -> Comparison:
    """Fit a captured session, compare, report; raises what each of them does."""
    say = stage or (lambda name: None)
    say("fit")
    fit(session)
    say("report")
    return report_compared(session, None)


def view(session: Path) -> None:
    """Open a session, with its fit if there is one, in the rerun viewer until it is closed; raises StationError."""
    from station.view import open_viewer

    with open_viewer(session) as viewer:
        viewer.wait()
