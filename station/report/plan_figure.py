"""What a camera will see of a planned motion: markers and joints over time, and the picture at a few moments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from station.foresight.detector import (
    HIDDEN,
    OBLIQUE,
    OUTSIDE,
    REASONS,
    SEEN,
    SMALL,
    SMEARED,
    STEEPEST_RAD,
    TURNED_AWAY,
)
from station.foresight.forecast import Forecast
from station.foresight.joints import JointOutlook
from station.logs import FloatArray
from station.report.style import LIGHT, WIDTH_IN, styled
from station.report.tables import shortened

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

ROW_IN = 0.22
GAP_PT = 2.2  # of white between two rows
LEFT, RIGHT = 0.2, 0.93
LABEL_LETTERS = 26
MOST_COLUMNS = 1600  # of time: more than a print can show
STEP_LABEL_IN = 0.2
# From the front, and as oblique as a marker can be seen.
TILT_COLOURS = (LIGHT.viewing, "#7fbf8e", LIGHT.oblique)
REASON_COLOURS = {
    OUTSIDE: "#c4c4c4",
    TURNED_AWAY: "#ececec",
    OBLIQUE: "#f6d5c3",
    SMALL: "#b9d3ea",
    HIDDEN: "#5b5b66",
    SMEARED: "#a3195b",
}
MISSED = "#b3202c"
PALE = 0.45  # how much of the rendered picture is left under the outlines

Picture = NDArray[np.uint8]


def plan_figure(forecast: Forecast, joints: Sequence[JointOutlook], views: Mapping[int, Picture]) -> Figure:
    """A bar for each marker and each joint over time, where the markers go in the image, and what is seen at moments.

    Args:
        forecast: what to draw.
        joints: of the forecast; those that the motion moves get a bar.
        views: pictures (H, W, 3) RGB of the whole image, at any size, by frame.
    """
    from matplotlib.figure import Figure

    moving = [joint for joint in joints if joint.moves]
    width_px, height_px = forecast.scene.camera.size_px
    view_in = 0.46 * WIDTH_IN * height_px / width_px + 0.32
    rows_in = [ROW_IN * max(len(forecast.scene.mounts), 1), ROW_IN * len(moving)]
    view_rows = -(-(1 + len(views)) // 2)
    height_in = 0.55 + rows_in[0] + 0.12 + rows_in[1] + 0.98 + view_rows * view_in
    with styled():
        figure = Figure(figsize=(WIDTH_IN, height_in))
        top = height_in - 0.55
        markers = _axes(figure, top, rows_in[0], height_in)
        _draw_markers(markers, forecast)
        _mark_steps(markers, forecast, list(views))
        last = markers
        if moving:
            last = _axes(figure, top - rows_in[0] - 0.12, rows_in[1], height_in)
            _draw_joints(last, forecast, moving)
            markers.tick_params(labelbottom=False)
        last.set_xlabel("time [s]", labelpad=1)
        _legend(figure, forecast, (top - sum(rows_in) - 0.12 - 0.76) / height_in, height_in)
        _draw_views(figure, forecast, views, view_in / height_in)
        return figure


def _axes(figure: Figure, top_in: float, rows_in: float, height_in: float) -> Axes:
    return figure.add_axes((LEFT, (top_in - rows_in) / height_in, RIGHT - LEFT, rows_in / height_in))


def tilt_colours() -> Colormap:
    """From a marker seen from the front to one that is hardly seen."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("tilt", list(TILT_COLOURS))


def _draw_markers(axes: Axes, forecast: Forecast) -> None:
    from matplotlib.colors import to_rgba

    colour = tilt_colours()(np.clip(forecast.sight.tilt_rad / STEEPEST_RAD, 0, 1))
    for reason, name in REASON_COLOURS.items():
        colour[forecast.reason == reason] = to_rgba(name)
    _draw_rows(axes, forecast, colour, forecast.seen)
    bodies = [mount.body for mount in forecast.scene.mounts]
    for row, (here, below) in enumerate(pairwise(bodies)):
        if here != below:
            across = {"clip_on": False, "transform": axes.get_yaxis_transform()}
            axes.plot([-0.2, 0], [row + 0.5] * 2, color=LIGHT.faint, lw=0.8, **across)
    for row, mount in enumerate(forecast.scene.mounts):
        name = f"{shortened(mount.part, LABEL_LETTERS)} ({mount.marker_id})"
        _label(axes, row, name, f"{100 * forecast.seen[:, row].mean():.0f} %")


def _draw_joints(axes: Axes, forecast: Forecast, joints: Sequence[JointOutlook]) -> None:
    """Where a joint moves and its angle is seen; where it rests and is seen, paler; where it moves unseen."""
    from matplotlib.colors import to_rgba

    names = [limits.name for limits in forecast.plan.joints]
    colour = np.empty((len(forecast.t_s), len(joints), 4))
    bad = np.zeros((len(forecast.t_s), len(joints)), dtype=bool)
    for row, joint in enumerate(joints):
        moves = forecast.travel[:, names.index(joint.name)] > 0
        looks = [(joint.seen & moves, LIGHT.viewing), (joint.seen, "#b5dccb"), (moves, MISSED)]
        colour[:, row] = to_rgba("#ececec")
        for where, name in reversed(looks):
            colour[where, row] = to_rgba(name)
        bad[:, row] = moves & ~joint.seen
        _label(axes, row, shortened(joint.name, LABEL_LETTERS), f"{100 * joint.travel_share:.0f} %")
    _draw_rows(axes, forecast, colour, ~bad)


def _draw_rows(axes: Axes, forecast: Forecast, colour: FloatArray, good: NDArray[np.bool_]) -> None:
    """Colours (T, R, 4) as R bars over time. Where a column stands for several frames, one that isn't good shows."""
    count, rows = good.shape
    columns = min(count, MOST_COLUMNS)
    column = np.arange(count) * columns // count
    key = np.where(good, 0, count) + np.arange(count)[:, None]
    shown = np.zeros((columns, rows), dtype=np.intp)
    np.maximum.at(shown, column, key)
    picked = colour[shown % count, np.arange(rows)]
    extent = (0.0, forecast.plan.duration_s, rows - 0.5, -0.5)
    axes.imshow(np.swapaxes(picked, 0, 1), aspect="auto", interpolation="nearest", extent=extent)
    for row in range(rows + 1):
        axes.axhline(row - 0.5, color=LIGHT.paper, lw=GAP_PT)
    axes.set_yticks([])
    axes.grid(visible=False)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)


def _label(axes: Axes, row: int, name: str, share: str) -> None:
    beside = {"transform": axes.get_yaxis_transform(), "va": "center", "fontsize": 8.5}
    axes.text(-0.012, row, name, ha="right", **beside)
    axes.text(1.008, row, share, ha="left", **beside)


def _mark_steps(axes: Axes, forecast: Forecast, frames: Sequence[int]) -> None:
    """Numbers of the steps where they begin, as far as they have room; letters above where the pictures are."""
    per_s = (RIGHT - LEFT) * WIDTH_IN / forecast.plan.duration_s
    over = {"transform": axes.get_xaxis_transform(), "ha": "center", "va": "bottom"}
    small = {"fontsize": 7.5, "color": LIGHT.commanded}
    free_from_s, step = -np.inf, 0
    for x, name, side in ((-0.012, "step", "right"), (1.008, "seen", "left")):
        axes.text(x, 1.0, name, transform=axes.transAxes, ha=side, va="bottom", **small)
    for segment in forecast.plan.segments:
        axes.axvline(segment.t_start_s, color=LIGHT.ink, lw=0.4, alpha=0.5)
        if segment.step != step and segment.t_start_s >= free_from_s:
            axes.text(segment.t_start_s, 1.0, str(segment.step), **small, **over)
            free_from_s, step = segment.t_start_s + STEP_LABEL_IN / per_s, segment.step
    drop = 0.3 / (ROW_IN * len(forecast.scene.mounts))
    free_from_s = -np.inf
    for letter, frame in zip("ABCDEFGH", frames, strict=False):
        t_s = float(forecast.t_s[frame])
        free_from_s = max(t_s, free_from_s)  # a letter that has no room moves on, its line doesn't
        axes.axvline(t_s, color=LIGHT.detected, lw=0.8, ls=(0, (3, 2)))
        axes.text(free_from_s, 1.0 + drop * 0.55, letter, fontsize=9, weight="bold", color=LIGHT.detected, **over)
        free_from_s += STEP_LABEL_IN / per_s


def _legend(figure: Figure, forecast: Forecast, bottom: float, height_in: float) -> None:
    """The colours of tilts, and of the reasons that there are."""
    from matplotlib.patches import Patch

    bar = figure.add_axes((LEFT, bottom + 0.13 / height_in, 0.15, 0.1 / height_in))
    bar.imshow(tilt_colours()(np.linspace(0, 1, 120))[None], aspect="auto", extent=(0, np.degrees(STEEPEST_RAD), 0, 1))
    bar.set_yticks([])
    bar.grid(visible=False)
    bar.set_xticks([0, 30, 60, round(np.degrees(STEEPEST_RAD))])
    bar.tick_params(labelsize=7, length=2, pad=1)
    figure.text(LEFT - 0.008, bottom + 0.18 / height_in, "seen, tilt [deg]", ha="right", va="center", fontsize=8)
    present = [reason for reason in REASON_COLOURS if np.any(forecast.reason == reason)]
    patches = [Patch(facecolor=REASON_COLOURS[reason], label=REASONS[reason]) for reason in present]
    patches.append(Patch(facecolor="#b5dccb", label="joint at rest, seen"))
    patches.append(Patch(facecolor=MISSED, label="joint moves unseen"))
    figure.legend(
        handles=patches,
        loc="center left",
        bbox_to_anchor=(LEFT + 0.17, bottom + 0.16 / height_in),
        ncols=4,
        frameon=False,
        fontsize=8,
        handlelength=1.2,
        columnspacing=1.2,
        borderaxespad=0,
        borderpad=0,
        labelspacing=0.3,
    )


def _draw_views(figure: Figure, forecast: Forecast, views: Mapping[int, Picture], height: float) -> None:
    """Where the markers go, then the pictures, two in a row from the bottom of the figure up."""
    rows = -(-(1 + len(views)) // 2)
    share = 1 - 0.32 / (height * figure.get_figheight())  # the rest is the title's
    places = [
        (0.025 + 0.49 * (k % 2), (rows - 1 - k // 2) * height + 0.008, 0.46, height * share)
        for k in range(1 + len(views))
    ]
    _draw_tracks(figure.add_axes(places[0]), forecast, next(iter(views.values()), None))
    for place, letter, (frame, picture) in zip(places[1:], "ABCDEFGH", views.items(), strict=False):
        axes = figure.add_axes(place)
        _draw_picture(axes, forecast, picture)
        _draw_outlines(axes, forecast, frame)
        seen = f"{int(forecast.seen[frame].sum())} of {len(forecast.scene.mounts)} markers seen"
        axes.set_title(f"{letter}: t = {forecast.t_s[frame]:.1f} s, {seen}", fontsize=9, loc="left", pad=3)


def _draw_picture(axes: Axes, forecast: Forecast, picture: Picture | None) -> None:
    width, height = forecast.scene.camera.size_px
    if picture is not None:
        pale = np.round(255 - PALE * (255 - picture.astype(np.float64))).astype(np.uint8)
        axes.imshow(pale, extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(True)


def _draw_tracks(axes: Axes, forecast: Forecast, picture: Picture | None) -> None:
    """The ways of the markers' middles over the whole motion, thin where they aren't seen."""
    _draw_picture(axes, forecast, picture)
    middles = forecast.sight.corners_px.mean(axis=-2)
    for row, mount in enumerate(forecast.scene.mounts):
        seen = forecast.seen[:, row, None]
        axes.plot(*middles[:, row].T, color=REASON_COLOURS[HIDDEN], lw=0.5, alpha=0.6)
        axes.plot(*np.where(seen, middles[:, row], np.nan).T, color=LIGHT.viewing, lw=1.3)
        first = np.flatnonzero(forecast.seen[:, row])
        if len(first):
            _number(axes, middles[first[0], row], mount.marker_id, LIGHT.viewing)
    axes.set_title("where the markers go: green where they are seen, thin where not", fontsize=9, loc="left", pad=3)


def _draw_outlines(axes: Axes, forecast: Forecast, frame: int) -> None:
    """Markers that are seen in solid lines; dashed those before the camera that aren't."""
    from matplotlib.patches import Polygon

    for row, mount in enumerate(forecast.scene.mounts):
        corners, reason = forecast.sight.corners_px[frame, row], int(forecast.reason[frame, row])
        if reason == TURNED_AWAY or not np.all(np.isfinite(corners)):
            continue
        look = (LIGHT.viewing, "solid") if reason == SEEN else (MISSED, (0, (2, 1.5)))
        axes.add_patch(Polygon(corners, closed=True, fill=False, ec=look[0], ls=look[1], lw=1.3))
        _number(axes, corners.mean(axis=0), mount.marker_id, look[0])


def _number(axes: Axes, at_px: FloatArray, marker_id: int, colour: str) -> None:
    box = {"boxstyle": "round,pad=0.12", "fc": LIGHT.paper, "ec": "none", "alpha": 0.8}
    x, y = at_px.tolist()
    axes.text(x, y, str(marker_id), ha="center", va="center", fontsize=6.5, color=colour, bbox=box, clip_on=True)
