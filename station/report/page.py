"""The HTML report, one file for screen and print, and the files beside it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from station.compare import UNIT_NAME, Agreement, Comparison, JointComparison
from station.comparison_files import comparison_csv, comparison_json, write_files
from station.logs import JointLog
from station.report.drawings import png, svg
from station.report.figure7 import OBLIQUE_DEG, Viewing, figure7
from station.report.style import DARK, LIGHT
from station.report.tables import error_texts, gain_text, lag_text, tree_rows_with
from station.report.tree_figure import tree_figure
from station.report.visibility import Visibility, visibility_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from station.kinematics.tree import KinematicTree

TEMPLATE = "page.html.j2"
# Letters of a name in the page's tables, which scroll.
NAME_LETTERS = 64


def save_figure(figure: Figure, path: Path) -> None:
    """Write `path`.png and `path`.svg."""
    write_files(path.parent, {f"{path.name}.png": png(figure), f"{path.name}.svg": svg(figure)})


def write_report(
    folder: Path,
    comparison: Comparison | None,
    tree: KinematicTree,
    states: JointLog,
    facts: Mapping[str, str],
    viewing: Viewing | None,
    warnings: Sequence[str],
    visibility: Visibility | None = None,
) -> None:
    """Write report.html and, with a comparison, figure7.png, figure7.svg, comparison.csv and comparison.json.

    All of them are made before any is written, and each is renamed to its name when it is whole.

    Args:
        folder: made if it isn't there.
        comparison: None for a session or log without commands.
        tree: the fit.
        states: the detected states, by the tree's joints.
        facts: of the session: frames, drops, versions, ...
        viewing: by commanded joint.
        warnings: sentences; joints without a counterpart are added here.
        visibility: when the parts were seen, to be drawn.
    """
    figures = {"tree": svg(tree_figure(tree, states))}
    if visibility is not None:
        figures["visibility"] = svg(visibility_figure(visibility))
    files: dict[str, bytes] = {}
    if comparison is not None:
        figure = figure7(comparison, viewing)
        figures["figure7"] = svg(figure)
        files = {
            "figure7.png": png(figure),
            "figure7.svg": figures["figure7"],
            "comparison.csv": comparison_csv(comparison).encode(),
            "comparison.json": comparison_json(comparison).encode(),
        }
    oblique_deg = None if viewing is None else OBLIQUE_DEG
    page = _page(comparison, tree, facts, (*warnings, *_unmatched(comparison)), figures, oblique_deg)
    write_files(folder, files | {"report.html": page.encode()})


def _page(
    comparison: Comparison | None,
    tree: KinematicTree,
    facts: Mapping[str, str],
    warnings: Sequence[str],
    drawings: Mapping[str, bytes],
    oblique_deg: float | None,
) -> str:
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string(resources.files("station.report").joinpath(TEMPLATE).read_text(encoding="utf-8"))
    return template.render(
        title=facts.get("session", "report"),
        compared=None if comparison is None else [_html_row(joint) for joint in comparison.joints],
        clock_lag=None if comparison is None else _clock_lag(comparison),
        has_readback=comparison is not None and any(joint.against_measured for joint in comparison.joints),
        oblique_deg=oblique_deg,
        steep_deg=OBLIQUE_DEG,
        tree_rows=tree_rows_with(tree, NAME_LETTERS),
        groups=tree.rigid_groups,
        trees=len(tree.trees),
        facts=facts,
        warnings=warnings,
        light=asdict(LIGHT),
        dark=asdict(DARK),
        figures={name: inline(drawing.decode(), name) for name, drawing in drawings.items()},
    )


def inline(drawing: str, name: str) -> str:
    """An SVG file's text as an element of a page: its ids made unique by `name`, its colours the page's variables."""
    drawing = drawing[drawing.index("<svg") :]
    drawing = re.sub(r'( id="|href="#|url\(#)', rf"\g<1>{name}-", drawing)
    for role, colour in asdict(LIGHT).items():
        drawing = drawing.replace(colour, f"var(--{role})")
    return drawing


def _html_row(joint: JointComparison) -> dict[str, object]:
    def numbers(agreement: Agreement | None) -> list[str]:
        if agreement is None:
            return [""] * 6
        return [
            *error_texts(agreement, joint.unit),
            lag_text(agreement),
            gain_text(agreement),
            str(agreement.frames),
        ]

    return {
        "name": joint.joint,
        "type": joint.type,
        "fitted": joint.fitted_joint,
        "sign": f"{joint.sign:+d}",
        "unit": UNIT_NAME[joint.unit],
        "measured": numbers(joint.against_measured),
        "commanded": numbers(joint.against_commanded),
    }


def _clock_lag(comparison: Comparison) -> str | None:
    if comparison.clock_lag_s is None:
        return None
    std = "" if comparison.clock_lag_std_s is None else f" (std {1e3 * comparison.clock_lag_std_s:.1f} ms)"
    return f"{comparison.clock_lag_s:.4f} s{std}"


def _unmatched(comparison: Comparison | None) -> Iterator[str]:
    if comparison is None:
        return
    for name in comparison.unmatched_commanded:
        yield f"{name}: no detected joint follows it, or it did not move"
    for name in comparison.unmatched_fitted:
        yield f"{name}: detected, but it follows no command or read-back"
