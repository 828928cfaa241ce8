"""A comparison's and a fit's numbers as rows of text, for a terminal and for the page."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from station.compare import UNIT_NAME, UNIT_SCALE, Agreement, Comparison, JointComparison

if TYPE_CHECKING:
    from station.kinematics.tree import Joint, KinematicTree

Rows = list[list[str]]

MM_PER_M, TURN = 1e3, 2 * np.pi

MAX_COLUMNS = 100
# Of rich's SIMPLE_HEAD: a space either side of a cell and one for the rule, none inside the outer edges.
BETWEEN_CELLS, EDGES = 3, 2
# Names are shortened to no less and, in a terminal, shown to no more.
NAME_COLUMNS = (6, 32)


def summary_rows(comparison: Comparison) -> Rows:
    """The comparison as a table for a terminal, at most 100 columns wide; its first row is the header.

    Errors in deg or mm after sign, offset and the session's lag; lag and gain are a joint's own, against the read-back,
    else the command, in the stamps as given.
    """
    errors = "RMSE/MAE/max"
    header = ["joint", "type", "detected as", f"to read-back\n{errors}", f"to command\n{errors}", "lag [ms]", "gain"]
    return _widest_that_fit(lambda width: [header, *(_summary_row(joint, width) for joint in comparison.joints)])


def _summary_row(joint: JointComparison, name_width: int) -> list[str]:
    best = joint.against_measured or joint.against_commanded
    fitted = f"-{joint.fitted_joint}" if joint.sign < 0 else joint.fitted_joint
    return [
        shortened(joint.joint, name_width),
        joint.type,
        shortened(fitted, name_width),
        _errors(joint.against_measured, joint.unit),
        _errors(joint.against_commanded, joint.unit),
        lag_text(best),
        gain_text(best),
    ]


def tree_rows(tree: KinematicTree) -> Rows:
    """The joints of a fit as a table for a terminal, at most 100 columns wide; its first row is the header.

    Residuals are norms over inliers; a joint without a name of its own has none here.
    """
    return _widest_that_fit(lambda width: tree_rows_with(tree, width))


def tree_rows_with(tree: KinematicTree, name_width: int) -> Rows:
    """As `tree_rows`, with names of up to this many letters."""
    header = ["joint", "between", "type", "range", "prob.", "rms\n[deg]", "rms\n[mm]", "frames"]
    return [header, *(_tree_row(joint, name_width) for joint in tree.joints)]


def _tree_row(joint: Joint, name_width: int) -> list[str]:
    probability = None if joint.probability is None else joint.probability.get(joint.type)
    return [
        shortened(own_name(joint), name_width) or "-",
        f"{shortened(joint.parent, name_width)} > {shortened(joint.child, name_width)}",
        type_text(joint),
        range_text(joint),
        "" if probability is None else f"{probability:.3f}",
        "" if joint.rms_rotation_rad is None else three_digits(float(np.degrees(joint.rms_rotation_rad))),
        "" if joint.rms_translation_m is None else three_digits(1e3 * joint.rms_translation_m),
        "" if joint.frames is None else str(joint.frames),
    ]


def _widest_that_fit(rows_with: Callable[[int], Rows]) -> Rows:
    """The rows with the longest names with which the table is no wider than a terminal."""
    least, most = NAME_COLUMNS
    fitting = (rows for width in range(most, least, -1) if _columns(rows := rows_with(width)) <= MAX_COLUMNS)
    return next(fitting, None) or rows_with(least)


def _columns(rows: Rows) -> int:
    widths = [max(len(line) for cell in column for line in cell.split("\n")) for column in zip(*rows, strict=True)]
    return sum(widths) + BETWEEN_CELLS * (len(widths) - 1) + EDGES


def own_name(joint: Joint) -> str:
    """A joint's name, "" while that is only its parent's and child's."""
    return "" if joint.name == f"{joint.parent}__{joint.child}" else joint.name


def type_text(joint: Joint) -> str:
    """The type; of a screw with its advance, "screw, 12.5 mm/turn"."""
    pitch = joint.pitch_m_per_rad
    return joint.type if pitch is None else f"{joint.type}, {three_digits(MM_PER_M * TURN * pitch)} mm/turn"


def range_text(joint: Joint) -> str:
    """The observed range, "-29 to 34 deg"; of a ball that of its angle; "" where there is none."""
    unit = joint.kind.unit
    if unit is None or joint.state_min is None or joint.state_max is None:
        return ""
    low, high = UNIT_SCALE[unit] * joint.state_min, UNIT_SCALE[unit] * joint.state_max
    return f"{low:z.0f} to {high:z.0f} {UNIT_NAME[unit]}"


def _errors(agreement: Agreement | None, unit: str) -> str:
    if agreement is None:
        return ""
    return "/".join(error_texts(agreement, unit)) + ("°" if unit == "rad" else " mm")


def error_texts(agreement: Agreement, unit: str) -> list[str]:
    """RMSE, MAE and largest error in deg or mm."""
    return [three_digits(UNIT_SCALE[unit] * value) for value in (agreement.rmse, agreement.mae, agreement.max)]


def lag_text(agreement: Agreement | None) -> str:
    """The lag with its standard deviation [ms], "" where undefined."""
    if agreement is None or np.isnan(agreement.lag_s):
        return ""
    std = "" if agreement.lag_std_s is None else f" ± {three_digits(1e3 * agreement.lag_std_s)}"
    return f"{three_digits(1e3 * agreement.lag_s)}{std}"


def gain_text(agreement: Agreement | None) -> str:
    """The gain, "" where undefined."""
    return "" if agreement is None or np.isnan(agreement.gain) else f"{agreement.gain:.3f}"


def session_lag_text(comparison: Comparison) -> str:
    """What is known of the session's one lag and what was done about it: at most 100 letters, no full stop."""
    lag = comparison.lag
    if comparison.clock_lag_s is not None:
        return f"the references' clock is {_seconds_text(comparison.clock_lag_s, lag.std_s)} behind: applied to them"
    if lag.lag_s is None:
        return f"no lag of the camera was applied: {lag.why_not}"
    trails = "trails" if lag.lag_s >= 0 else "leads"
    size = f"the camera {trails} the read-back by {_milliseconds_text(abs(lag.lag_s), lag.std_s)}"
    return f"{size}; not applied: {lag.why_not}" if lag.why_not else f"{size}: applied to the detection's times"


def _milliseconds_text(lag_s: float, std_s: float | None) -> str:
    return f"{three_digits(1e3 * lag_s)} ms" + ("" if std_s is None else f" (std {three_digits(1e3 * std_s)} ms)")


def _seconds_text(lag_s: float, std_s: float | None) -> str:
    return f"{lag_s:.4f} s" + ("" if std_s is None else f" (std {three_digits(1e3 * std_s)} ms)")


def three_digits(value: float) -> str:
    """Three digits or so: 0.31, 12.3, 159."""
    size = abs(value)
    return f"{value:z.2f}" if size < 9.995 else f"{value:.1f}" if size < 99.95 else f"{value:.0f}"


def shortened(text: str, width: int) -> str:
    """At most so many letters, both ends kept: names of one arm often differ in the last letter alone."""
    if len(text) <= width:
        return text
    tail = (width - 1) // 3
    return f"{text[: width - 1 - tail]}…{text[len(text) - tail :]}"
