"""The errors against the viewing angle and against time."""

from __future__ import annotations

from station.report.blocks import Drawing, Section, Text
from station.report.drawings import svg
from station.report.error_figure import error_figure
from station.report.material import Material

ALT = "For each joint, the RMS error against the markers' viewing angle and against time, with what the fit predicts"
HOW = (
    "Left: the errors of Figure 7 by the angle between the line of sight and the markers' normal, in steps of 5 deg. "
    "Right: the same errors over time, in 60 parts. Grey: where the frames are. Orange: the root mean square of the "
    "standard deviations that the fit states for these frames. Blue: the same with the read-back's rounding to whole "
    "counts, an error that is no fault of the detection. Points well above both are errors that the fit doesn't know "
    "of: a marker that bends, a link that gives, a wrong calibration of the camera, a lag that is not one."
)


def errors_section(material: Material) -> Section | None:
    """None where nothing is compared."""
    comparison = material.comparison
    if comparison is None or not comparison.joints:
        return None
    figure = error_figure(comparison, material.viewing, material.readback_steps)
    return Section(
        "errors", "Errors", "Errors by angle and time", [Drawing("errors", svg(figure), ALT), Text(HOW, soft=True)]
    )
