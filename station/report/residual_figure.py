"""What a fit on corners leaves of them: by place in the image, by tilt, and by marker over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from station.fit.image.views import CORNERS
from station.fit.image_checks import Finding, Residuals
from station.logs import FloatArray
from station.report.style import LIGHT, WIDTH_IN, styled
from station.report.tables import shortened

IntArray = NDArray[np.intp]

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TOP_IN, ROW_IN = 2.9, 0.34
CELLS = (12, 9)
ANGLES_DEG = np.arange(0.0, 91.0, 5.0)
TIME_BINS = 120
# Fewer sightings than this say nothing of a mean.
LEAST = 5
# Mean residuals are drawn with this many deviations of a mean filling a cell, or more if they are larger.
NOISE_CELLS = 6.0
LABEL_LETTERS = 22
# A row's height is this ratio of the residuals to what was stated.
MOST_RATIO = 3.0


def residual_figure(residuals: Residuals) -> Figure:
    """Above, mean residuals as arrows over the image and RMS by tilt; below, a row a marker over time."""
    from matplotlib.figure import Figure

    markers = marker_rows(residuals)
    below_in = 0.55 + ROW_IN * len(markers)
    height_in = 0.35 + TOP_IN + 0.75 + below_in
    with styled():
        figure = Figure(figsize=(WIDTH_IN, height_in))
        top, bottom = 1 - 0.35 / height_in, 1 - (0.35 + TOP_IN) / height_in
        _draw_place(figure.add_axes((0.075, bottom, 0.37, top - bottom)), residuals)
        _draw_tilt(figure.add_axes((0.545, bottom, 0.44, top - bottom)), residuals)
        low = 0.48 / height_in
        _draw_time(figure.add_axes((0.19, low, 0.68, ROW_IN * len(markers) / height_in)), residuals, markers)
        return figure


def marker_rows(residuals: Residuals) -> list[tuple[int, str]]:
    """The markers with their parts."""
    return sorted(set(zip(residuals.marker_id.tolist(), residuals.part, strict=True)))


def _titled(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=9.5, fontweight="bold", pad=5)


def _draw_place(axes: Axes, residuals: Residuals) -> None:
    """An arrow from the middle of each cell that was seen often enough: the mean residual, drawn large."""
    _titled(axes, "mean residual by place in the image")
    width, height = residuals.size_px
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal", xlabel="[px]", ylabel="[px]", anchor="NW")
    cell_px = width / CELLS[0]
    places, means, spread_px = cell_means(residuals)
    if not len(places):
        axes.text(0.5, 0.5, "too few corners", transform=axes.transAxes, ha="center", va="center", fontsize=8)
        return
    largest_px = max(float(np.linalg.norm(means, axis=1).max()), NOISE_CELLS * spread_px)
    length_px = _round(0.7 * largest_px)
    arrows = axes.quiver(
        *places.T, *means.T, angles="xy", scale_units="xy", scale=largest_px / (1.4 * cell_px), width=0.0045,
        color=LIGHT.detected, zorder=3,
    )  # fmt: skip
    axes.quiverkey(
        arrows,
        0.82,
        1.045,
        length_px,
        f"{length_px:g} px",
        labelpos="E",
        coordinates="axes",
        fontproperties={"size": 8},
    )


def cell_means(residuals: Residuals) -> tuple[FloatArray, FloatArray, float]:
    """Middles (C, 2) of the cells with corners enough, mean residuals (C, 2) there, and a mean's typical deviation.

    Corners count by their stated variances: those of oblique markers would drown all others.
    """
    good = residuals.good
    px, left = residuals.corners_px[good].reshape(-1, 2), residuals.residual_px[good].reshape(-1, 2)
    size = np.array(residuals.size_px, dtype=np.float64)
    cell = np.clip(np.floor(px / size * CELLS), 0, np.array(CELLS) - 1).astype(np.intp)
    number = cell[:, 0] + CELLS[0] * cell[:, 1]
    total = CELLS[0] * CELLS[1]
    weight = np.repeat(1.0 / residuals.sigma_px[good] ** 2, CORNERS)
    enough = np.flatnonzero(np.bincount(number, minlength=total) >= CORNERS * LEAST)
    weights = np.bincount(number, weights=weight, minlength=total)[enough]
    sums = [np.bincount(number, weights=weight * left[:, i], minlength=total)[enough] for i in range(2)]
    middles = (np.stack([enough % CELLS[0], enough // CELLS[0]], axis=-1) + 0.5) * size / CELLS
    deviation = float(np.median(weights) ** -0.5) if len(enough) else 0.0
    return middles, np.stack(sums, axis=-1) / weights[:, None], deviation


def _round(value: float) -> float:
    """The next number below with one digit of 1, 2 or 5."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= value) * power)


def _draw_tilt(axes: Axes, residuals: Residuals) -> None:
    """RMS and what was stated, by tilt; and how far edges lie outward on average."""
    _titled(axes, "by tilt")
    good = residuals.good
    bins = np.digitize(np.degrees(residuals.tilt_rad[good]), ANGLES_DEG[1:-1]).astype(np.intp)
    count = np.bincount(bins, minlength=len(ANGLES_DEG) - 1)
    squared = np.mean(residuals.residual_px[good] ** 2, axis=(1, 2))
    outward = residuals.outward_px[good]
    rms, stated = (np.sqrt(_means(bins, values, count)) for values in (squared, residuals.sigma_px[good] ** 2))
    share = axes.twinx()
    share.bar(ANGLES_DEG[:-1] + 2.5, count / max(len(bins), 1), 5.0, color=LIGHT.faint, lw=0)
    share.set_ylim(0, max(4 * float(count.max(initial=1)) / max(len(bins), 1), 1e-9))
    share.set_axis_off()
    axes.set_zorder(share.get_zorder() + 1)
    axes.patch.set_visible(False)
    middles = ANGLES_DEG[:-1] + 2.5
    axes.axhline(0, color=LIGHT.ink, lw=0.6)
    axes.plot(
        middles,
        stated,
        color=LIGHT.oblique,
        ls=(0, (4, 1.5)),
        lw=1.4,
        marker="_",
        ms=7,
        label="stated, by the marker's noise",
    )
    axes.plot(middles, rms, color=LIGHT.measured, marker="o", ms=3.5, lw=1.4, label="RMS residual")
    mean = _means(bins, outward, count)
    axes.plot(middles, mean, color=LIGHT.detected, marker="s", ms=3, lw=1.2, label="edges outward, mean")
    known = np.concatenate([x[np.isfinite(x)] for x in (stated, rms, mean)])
    if len(known):
        axes.set_ylim(min(1.3 * float(known.min()), 0.0) - 0.05 * float(known.max()), 1.55 * float(known.max()))
    axes.set(xlim=(0, 90), xlabel="angle from the marker's normal to the line of sight [deg]", ylabel="[px]")
    axes.legend(loc="upper left", frameon=False, fontsize=8, ncols=1)


def _means(bins: IntArray, values: FloatArray, count: IntArray) -> FloatArray:
    sums = np.bincount(bins, weights=values, minlength=len(count))
    return np.where(count >= LEAST, sums / np.maximum(count, 1), np.nan)


def _draw_time(axes: Axes, residuals: Residuals, markers: list[tuple[int, str]]) -> None:
    """A row a marker: its RMS residual as a multiple of the stated one; what was found at a time is marked."""
    _titled(axes, "over time, by marker: RMS residual over what is stated (dashed: 1)")
    start, end = (float(residuals.t_s[i]) for i in (0, -1))
    edges = np.linspace(start, max(end, start + 1e-9), TIME_BINS + 1)
    for row, (marker, part) in enumerate(markers):
        own = (residuals.marker_id == marker) & (np.array(residuals.part) == part)
        own &= np.isfinite(residuals.residual_px).all(axis=(1, 2))
        ratio = np.mean(residuals.residual_px[own] ** 2, axis=(1, 2)) / residuals.sigma_px[own] ** 2
        bins = np.clip(np.searchsorted(edges, residuals.t_s[own], side="right") - 1, 0, TIME_BINS - 1)
        count = np.bincount(bins, minlength=TIME_BINS)
        level = np.sqrt(np.bincount(bins, weights=ratio, minlength=TIME_BINS) / np.maximum(count, 1))
        height = np.minimum(np.where(count > 0, level, np.nan), MOST_RATIO) / MOST_RATIO
        base = row + 0.95
        axes.stairs(base - 0.9 * height, edges, baseline=base, fill=True, color=LIGHT.measured, lw=0)
        over = np.where(level > MOST_RATIO, height, np.nan)
        axes.stairs(base - 0.9 * over, edges, baseline=base, fill=True, color=LIGHT.detected, lw=0)
        axes.plot([start, end], 2 * [base - 0.9 / MOST_RATIO], color=LIGHT.ink, lw=0.6, ls=(0, (3, 2)))
        beside = {"transform": axes.get_yaxis_transform(), "va": "center", "fontsize": 8.5}
        axes.text(-0.012, row + 0.5, f"{shortened(part, LABEL_LETTERS)}, {marker}", ha="right", **beside)
        good = own & residuals.good
        rms_px = float(np.sqrt(np.mean(residuals.residual_px[good] ** 2))) if good.any() else np.nan
        axes.text(1.012, row + 0.5, "no inliers" if np.isnan(rms_px) else f"{rms_px:.3f} px", ha="left", **beside)
    for finding in residuals.checks.findings:
        _draw_finding(axes, finding, markers)
    axes.set(xlim=(start, end), ylim=(len(markers), 0), yticks=[], xlabel="time [s]")
    axes.grid(visible=False, axis="y")


def _draw_finding(axes: Axes, finding: Finding, markers: list[tuple[int, str]]) -> None:
    """A line at its time, across the rows that it is about."""
    if finding.t_s is None:
        return
    about = [
        row
        for row, (marker, part) in enumerate(markers)
        if finding.marker_id in (None, marker) and finding.part in (None, part)
    ]
    for row in about:
        axes.plot(2 * [finding.t_s], [row, row + 0.95], color=LIGHT.ink, lw=1.6, zorder=4)
