"""What the fit leaves of the corners, and what tests on it found."""

from __future__ import annotations

import numpy as np

from station.fit.image_checks import Residuals
from station.report.blocks import Block, Bullets, Drawing, Section, Table, Text
from station.report.drawings import svg
from station.report.material import Material
from station.report.residual_figure import marker_rows, residual_figure

ALT = "Mean residuals over the image, by tilt, and by marker over time"
HOW = (
    "Left: corners as detected less where the tree puts them, averaged over cells of the image: arrows every which way "
    "are noise, a pattern is the lens. Right: residuals by the angle between the line of sight and the marker's "
    "normal, in steps of 5 deg, beside the noise that is stated for these corners, of which the fit follows some; the "
    "mean shift of the edges that is left; behind, where the markers were seen. Below: each marker over time, in the "
    "other colour where it is more than three times what is stated; an upright line is where a test found that "
    "something moved."
)
TESTED = (
    "The tests ask for each marker, and each part of several, whether it moved on what it is on at some time, for the "
    "camera whether it moved or drifted, for the focal length and the edge shift whether they disagree with the "
    "calibration, and whether residuals go with the place in the image or with tilt. What a joint's own motion can do, "
    "and what holds from the first frame to the last, no residual shows. The level is for all tests of a session "
    "together."
)


def residuals_section(material: Material) -> Section | None:
    """None where the tree was not refined on corners."""
    residuals = material.residuals
    if residuals is None or not len(residuals):
        return None
    checks = residuals.checks
    found: Block = (
        Bullets([finding.text for finding in checks.findings])
        if checks.findings
        else Text(f"No test found anything: {checks.tests} tests, level {100 * checks.level:g} in 100.")
    )
    blocks: list[Block] = [found, Drawing("residuals", svg(residual_figure(residuals)), ALT), Text(HOW, soft=True)]
    blocks += [_by_marker(residuals), Text(_tests(residuals), soft=True)]
    return Section("residuals", "Residuals", "What the corners leave unexplained", blocks)


def _tests(residuals: Residuals) -> str:
    checks = residuals.checks
    untested = "".join(f" Not tested: {what}." for what in checks.untested)
    found = (
        "" if not checks.findings else f" {checks.tests} tests were made, at a level of {100 * checks.level:g} in 100."
    )
    return TESTED + found + untested


def _by_marker(residuals: Residuals) -> Table:
    head = ("marker", "part", "sightings", "outliers", "RMS [px]", "stated [px]", "tilt [deg]")
    rows = [_row(residuals, marker, part) for marker, part in marker_rows(residuals)]
    return Table("residuals by marker", head, rows, frozenset({1}))


def _row(residuals: Residuals, marker: int, part: str) -> list[str]:
    own = (residuals.marker_id == marker) & (np.array(residuals.part) == part)
    good = own & residuals.good
    if not good.any():
        return [str(marker), part, str(int(own.sum())), str(int(own.sum())), "", "", ""]
    tilt_deg = np.degrees(np.nanpercentile(residuals.tilt_rad[good], [5.0, 95.0]))
    return [
        str(marker),
        part,
        str(int(own.sum())),
        str(int((own & ~residuals.good).sum())),
        f"{np.sqrt(np.mean(residuals.residual_px[good] ** 2)):.4f}",
        f"{np.sqrt(np.mean(residuals.sigma_px[good] ** 2)):.4f}",
        f"{tilt_deg[0]:.0f} to {tilt_deg[1]:.0f}",
    ]
