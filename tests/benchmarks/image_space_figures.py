"""The figures of docs/image_space.md, of recordings of the demo: Figure 7 three ways, and errors by viewing angle.

The first is of one recording. The second pools several, and arms of `image_rendered` besides, whose cameras' gamma the
detector doesn't know, with the first marker of each body alone: frames are binned by how obliquely the marker of the
joint's child is seen, and beside the errors of both fits there is the Cramer-Rao bound of the same frames.

Run: python -m tests.benchmarks.image_space_figures [--seed N] [--trials N] [--keep FOLDER] [--out FOLDER] [--quick]
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

from station.commands import fitting
from station.logs import BoolArray, FloatArray
from station.perception.markers import MarkerTable
from station.perception.observations import MARKER_SHAPES, ObservationLog
from station.report.figure7 import OBLIQUE_DEG
from station.report.style import LIGHT, WIDTH_IN, styled
from station.tracking import viewing_angles_of_parts
from tests.benchmarks.arguments import parser, trials_of
from tests.benchmarks.demo_seeds import JOINTS
from tests.benchmarks.demo_sessions import DemoSession, demo_folder, demo_session
from tests.benchmarks.demo_truth import REFINE, options_of, read_back_errors
from tests.benchmarks.image_rendered import fitted
from tests.benchmarks.rendered_arm import RenderedArm, rendered_arm
from tests.benchmarks.rendered_bound import joint_bounds
from tests.benchmarks.rendered_truth import StateErrors, corner_noise, part_bodies, state_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DPI = 130
THREE_WAYS, BY_ANGLE = "figure7_three_ways.png", "error_by_angle.png"
NAMES = {"paper": "paper's method", "pose": "poses", "image": "corners", "read-back": "read-back"}
COLOURS = {"paper": LIGHT.commanded, "pose": LIGHT.measured, "image": LIGHT.detected, "read-back": LIGHT.viewing}
LINES = {
    "pose": ("fit to poses", LIGHT.measured, "s-"),
    "image": ("fit to corners", LIGHT.detected, "o-"),
    "bound": ("Cramér-Rao bound", LIGHT.ink, "--"),
}
BIN_DEG = 10.0
BINS_DEG = np.arange(0.0, 81.0, BIN_DEG)
TICKS_DEG = (0.002, 0.005, 0.01, 0.02, 0.05)
# A recording has 887 frames, an arm in motion 300.
ARMS_A_RECORDING = 2
# Frames in a bin below which it shows nothing.
FEWEST = 20


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording, its fits' errors by fit and joint, and views of the joints' children (T,) [deg]."""

    session: DemoSession
    errors: dict[tuple[str, str], StateErrors]
    view_deg: dict[str, FloatArray]


def recorded(folder: Path, seed: int) -> Recorded:
    """The recording of a seed, fitted each way."""
    session = demo_session(folder, seed)
    bodies = part_bodies(session.truth, session.table)
    errors: dict[tuple[str, str], StateErrors] = {}
    for name in REFINE:
        fit = fitting.fit(folder, folder / name, options=options_of(name), force=True).fit
        errors |= {(name, joint): of for joint, of in state_errors(fit, session.truth, bodies).items()}
    t_s = session.observations.t_s
    errors |= {("read-back", j): of for j, of in read_back_errors(session.measured, t_s, session.truth).items()}
    return Recorded(session, errors, views_deg(session))


def views_deg(pictures: RenderedArm | DemoSession) -> dict[str, FloatArray]:
    """(T,) angle between the line of sight and the normal of the child's better marker, by joint; NaN where unseen."""
    bodies = part_bodies(pictures.truth, pictures.table)
    of_parts = np.degrees(viewing_angles_of_parts(pictures.observations, pictures.table))
    found: dict[str, FloatArray] = {}
    for joint in pictures.truth.stage.tree.joints:
        on_child = [k for k, part in enumerate(pictures.table.parts) if bodies[part] == joint.child]
        least = np.where(np.isnan(of_parts[:, on_child]), np.inf, of_parts[:, on_child]).min(axis=1)
        found[joint.name] = np.where(np.isfinite(least), least, np.nan)
    return found


def draw_three_ways(of: Recorded, out: Path) -> None:
    """Columns of joints; rows: angle, errors of the read-back and of the three fits, viewing angle."""
    rows = ("read-back", *reversed(REFINE))
    figure, panels = plt.subplots(
        2 + len(rows),
        len(JOINTS),
        figsize=(WIDTH_IN, 8.4),
        sharex=True,
        sharey="row",
        layout="constrained",
        gridspec_kw={"height_ratios": [1.5, *(1.0 for _ in rows), 0.7]},
    )
    for column, joint in enumerate(JOINTS):
        angle, *of_fits, view = panels[:, column]
        _draw_angle(angle, of, joint)
        angle.set_title(joint, loc="left", fontsize=9.5, fontweight="bold")
        for axes, name in zip(of_fits, rows, strict=True):
            _draw_error(axes, of, name, joint)
        _draw_view(view, of, joint, panels[:, column])
        view.set_xlabel("time [s]")
    panels[0, 0].set_ylabel("angle [deg]")
    for axes, name in zip(panels[1:-1, 0], rows, strict=True):
        axes.set_ylabel(f"{NAMES[name]}\nerror [deg]")
    panels[-1, 0].set_ylabel("view [deg]")
    figure.align_ylabels(panels[:, 0])
    _limit_alike(panels[1 + rows.index("pose"), 0], panels[1 + rows.index("image"), 0])
    figure.savefig(out / THREE_WAYS, dpi=DPI)
    plt.close(figure)


def _draw_angle(axes: Axes, of: Recorded, joint: str) -> None:
    truth = of.session.truth
    t_s = of.session.observations.t_s
    axes.plot(t_s, np.degrees(truth.states(t_s)[:, truth.joint(joint)]), color=LIGHT.ink, lw=1.0)
    axes.margins(x=0)


def _draw_error(axes: Axes, of: Recorded, name: str, joint: str) -> None:
    axes.axhline(0.0, color=LIGHT.ink, lw=0.5)
    errors = of.errors.get((name, joint))
    if errors is None:
        axes.text(0.5, 0.8, "not found", transform=axes.transAxes, ha="center")
        return
    error = np.degrees(errors.error_rad)
    axes.plot(errors.t_s, error, color=COLOURS[name], lw=0.7)
    rms, median = np.sqrt(np.nanmean(error**2)), np.nanmedian(np.abs(error))
    said = f"RMS {rms:.3g}, median {median:.2g}"
    axes.text(0.03, 0.94, said, transform=axes.transAxes, ha="left", va="top", fontsize=7.5)
    high = max(axes.get_ylim()[1], 1.9 * np.nanmax(np.abs(error)))
    axes.set_ylim(-high, high)


def _draw_view(strip: Axes, of: Recorded, joint: str, column: FloatArray) -> None:
    t_s, view_deg = of.session.observations.t_s, of.view_deg[joint]
    strip.plot(t_s, view_deg, color=LIGHT.viewing, lw=0.8)
    strip.axhline(OBLIQUE_DEG, color=LIGHT.faint, lw=0.8)
    strip.set_ylim(0, 90)
    strip.set_yticks([0, 60])
    oblique = np.nan_to_num(view_deg, nan=90.0) > OBLIQUE_DEG
    for panel in column:
        bottom_top = panel.get_xaxis_transform()
        panel.fill_between(t_s, 0, 1, where=oblique, transform=bottom_top, color=LIGHT.oblique, alpha=0.18, lw=0)


def _limit_alike(one: Axes, other: Axes) -> None:
    high = max(one.get_ylim()[1], other.get_ylim()[1])
    for axes in (one, other):
        axes.set_ylim(-high, high)


@dataclass(frozen=True, eq=False)
class Pooled:
    """Frames of a joint (n,) in which both fits have a state: views, errors by fit and bounds, all [deg]."""

    view: FloatArray
    errors: dict[str, FloatArray]


def one_marker_a_body(pictures: RenderedArm) -> RenderedArm:
    """The same pictures with the first marker of each body alone."""
    bodies = part_bodies(pictures.truth, pictures.table)
    first: dict[str, int] = {}
    for marker in pictures.table.markers:
        first.setdefault(bodies[marker.part], marker.id)
    kept = tuple(marker for marker in pictures.table.markers if marker.id in first.values())
    table = MarkerTable(pictures.table.dictionary, kept)
    return RenderedArm(of_table(pictures.observations, table), table, pictures.truth)


def of_table(seen: ObservationLog, table: MarkerTable) -> ObservationLog:
    """What was seen of the table's markers."""
    rows = np.flatnonzero(table.rows(seen.marker_id) >= 0)
    of_rows = {name: getattr(seen, name)[rows] for name in (*MARKER_SHAPES, "frame")}
    return replace(seen, **of_rows)


def pooled(pictures: RenderedArm) -> dict[str, Pooled]:
    """By joint."""
    truth, seen, table = pictures.truth, pictures.observations, pictures.table
    bounds = joint_bounds(truth, seen, table, corner_noise(truth, seen, table, truth.camera))
    bodies = part_bodies(truth, table)
    errors = {name: state_errors(fitted(pictures, name), truth, bodies) for name in ("pose", "image")}
    views = views_deg(pictures)
    found: dict[str, Pooled] = {}
    for joint in JOINTS:
        if not all(joint in of for of in errors.values()):
            continue
        bound = np.degrees(np.sqrt(bounds[joint].states[:, 0]))
        both = {name: np.degrees(of[joint].error_rad) for name, of in errors.items()}
        rows = np.all([np.isfinite(x) for x in (views[joint], bound, *both.values())], axis=0)
        centred = {name: error[rows] - error[rows].mean() for name, error in both.items()}
        found[joint] = Pooled(views[joint][rows], centred | {"bound": bound[rows]})
    return found


def draw_by_angle(groups: dict[str, list[dict[str, Pooled]]], out: Path) -> None:
    """A row a group of cameras, a panel a joint: RMS errors and the bound in bins of the viewing angle."""
    figure, panels = plt.subplots(
        len(groups), len(JOINTS), figsize=(WIDTH_IN, 5.6), sharex=True, sharey=True, layout="constrained"
    )
    print(f"{'joint':9}  {'view [deg]':>10}  {'frames':>6}  {'poses':>8}  {'corners':>8}  {'bound':>8}   RMS [deg]")
    for row, (group, runs) in zip(panels, groups.items(), strict=True):
        print(group)
        for axes, joint in zip(row, JOINTS, strict=True):
            _draw_bins(axes, joint, [run[joint] for run in runs if joint in run])
        row[0].set_ylabel(f"{group}\nRMS error of the angle [deg]")
    for axes, joint in zip(panels[0], JOINTS, strict=True):
        axes.set_title(joint, loc="left", fontsize=9.5, fontweight="bold")
    for axes in panels[-1]:
        axes.set_xlabel("viewing angle [deg]")
    panels[0, 0].set_xlim(0, BINS_DEG[-1])
    panels[0, 0].set_yticks(TICKS_DEG, [f"{tick:g}" for tick in TICKS_DEG])
    panels[0, 0].minorticks_off()
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    figure.savefig(out / BY_ANGLE, dpi=DPI)
    plt.close(figure)


def _draw_bins(axes: Axes, joint: str, runs: list[Pooled]) -> None:
    view = np.concatenate([run.view for run in runs])
    inside = [(view >= low) & (view < high) for low, high in pairwise(BINS_DEG)]
    rms: dict[str, FloatArray] = {}
    for name in LINES:
        values = np.concatenate([run.errors[name] for run in runs])
        rms[name] = np.array([_rms(values, rows) for rows in inside])
        label, colour, style = LINES[name]
        axes.semilogy((BINS_DEG[1:] + BINS_DEG[:-1]) / 2, rms[name], style, color=colour, ms=4, lw=1.2, label=label)
    for low, rows, *values in zip(BINS_DEG, inside, *rms.values(), strict=False):
        told = "  ".join(f"{v:8.4f}" for v in values)
        print(f"{joint:9}  {low:4.0f}-{low + BIN_DEG:3.0f}    {rows.sum():6}  {told}")


def _rms(values: FloatArray, rows: BoolArray) -> float:
    return float(np.sqrt(np.mean(values[rows] ** 2))) if np.count_nonzero(rows) >= FEWEST else np.nan


def main() -> None:
    """Write both."""
    options = parser(__doc__, trials=10, quick=1)
    options.add_argument("--keep", type=Path, help="folder that keeps the recordings, and has those of earlier runs")
    options.add_argument("--out", type=Path, default=Path("docs"))
    chosen = options.parse_args()
    matplotlib.use("Agg")
    runs: list[dict[str, Pooled]] = []
    for seed in range(chosen.seed, chosen.seed + trials_of(chosen)):
        with demo_folder(chosen.keep, seed) as folder, styled():
            if seed == chosen.seed:
                draw_three_ways(recorded(folder, seed), chosen.out)
            session = demo_session(folder, seed)
            runs.append(pooled(one_marker_a_body(RenderedArm(session.observations, session.table, session.truth))))
    arms = range(chosen.seed, chosen.seed + ARMS_A_RECORDING * trials_of(chosen))
    groups = {"the demo's camera": runs, "cameras of unknown gamma": [_pooled_arm(seed) for seed in arms]}
    with styled():
        draw_by_angle(groups, chosen.out)


def _pooled_arm(seed: int) -> dict[str, Pooled]:
    return pooled(one_marker_a_body(rendered_arm(seed)))


if __name__ == "__main__":
    main()
