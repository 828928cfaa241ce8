"""Each joint against its command and its read-back: the numbers, and the paper's Figure 7."""

from __future__ import annotations

import numpy as np

from station.compare import UNIT_NAME, UNIT_SCALE, Agreement, Comparison, JointComparison
from station.report.blocks import Block, Drawing, Section, Table, Text
from station.report.drawings import svg
from station.report.figure7 import OBLIQUE_DEG, figure7
from station.report.material import Material
from station.report.tables import error_texts, gain_text, lag_text, session_lag_text, three_digits

HEAD = ("joint", "type", "detected as", "sign", "unit")
MEASURED = ("RMSE", "before lag", "MAE", "max", "own lag [ms]", "gain", "frames")
COMMANDED = ("RMSE", "MAE", "max", "own lag [ms]")
ERRORS = (
    "Errors are after sign and offset, and after the session's one lag where it was applied: each frame is compared "
    "with what the servos read when its light fell. 'Before lag' is the same RMSE without it. Own lag: by how much "
    "this joint's detection trails, in the stamps as given, with its standard deviation. Gain: slope of detected "
    "against reference at that lag; never taken off. Commands are steps that the servo's speed limit turns into "
    "ramps: errors and lag against them are the servo's, not the camera's."
)
ROUNDING = (
    "The bands are two standard deviations of the detection alone. The error holds the read-back's own rounding as "
    "well: a servo tells its angle in whole counts (0.29 deg in the AX series, 0.09 deg in the X series). While a "
    "joint moves, about half a count comes on top of the band."
)
FIGURE7 = "figure7"
ALT = "Joint states over time: commanded, servo read-back and detected, their error, and the markers' viewing angle"


def joints_section(material: Material) -> Section | None:
    """None for sessions without commands."""
    comparison = material.comparison
    if comparison is None:
        return None
    title = "Commanded, read-back and detected"
    if not comparison.joints:
        return Section("joints", "Joints", title, [Text("No detected joint follows a command or a read-back.")])
    blocks: list[Block] = [
        _table(comparison),
        Text(f"Lag: {session_lag_text(comparison)}."),
        Drawing(FIGURE7, svg(figure7(comparison, material.viewing)), ALT),
        Text(ERRORS, soft=True),
    ]
    if any(joint.against_measured for joint in comparison.joints):
        blocks.append(Text(ROUNDING, soft=True))
    gaps = "Gaps: the joint's markers were not seen, the frame is an outlier, or the servos weren't read."
    oblique = (
        f" Shaded: seen at more than {OBLIQUE_DEG:.0f} deg from their normal, where the detection is less accurate."
    )
    blocks.append(Text(gaps + (oblique if material.viewing is not None else ""), soft=True))
    return Section("joints", "Joints", title, blocks)


def _table(comparison: Comparison) -> Table:
    groups = (
        ("", len(HEAD)),
        ("against the servo's read-back", len(MEASURED)),
        ("against the command", len(COMMANDED)),
    )
    rows = [_row(joint) for joint in comparison.joints]
    return Table("joints", (*HEAD, *MEASURED, *COMMANDED), rows, frozenset({1, 2}), groups)


def _row(joint: JointComparison) -> list[str]:
    return [
        joint.joint,
        joint.type,
        joint.fitted_joint,
        f"{joint.sign:+d}",
        UNIT_NAME[joint.unit],
        *_measured(joint.against_measured, joint.unit),
        *_commanded(joint.against_commanded, joint.unit),
    ]


def _measured(agreement: Agreement | None, unit: str) -> list[str]:
    if agreement is None:
        return [""] * len(MEASURED)
    rmse, mae, largest = error_texts(agreement, unit)
    before = agreement.rmse_before_lag
    before_text = "" if np.isnan(before) else three_digits(UNIT_SCALE[unit] * before)
    return [rmse, before_text, mae, largest, lag_text(agreement), gain_text(agreement), str(agreement.frames)]


def _commanded(agreement: Agreement | None, unit: str) -> list[str]:
    return [""] * len(COMMANDED) if agreement is None else [*error_texts(agreement, unit), lag_text(agreement)]
