"""Figures as PNG and as SVG: the same bytes for the same figure, curves thinned to what an eye can tell apart."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING

import numpy as np

from station.logs import FloatArray
from station.report.style import styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PNG_DPI = 150
# In points of 1/72 inch. Curves keep within this of what was drawn (matplotlib itself simplifies lines to 1/9) ...
TOLERANCE_PT = 0.05
# ... and of the points within such a column only the first, last, lowest and highest: all that can be seen of it.
COLUMN_PT = 0.4
# Coordinates are written in whole ones of these.
STEPS_PER_PT = 100

POLYLINE = re.compile(r'(?<= d=")M[-\d.\sMLz]+(?=")')
# Comments hold the figure's texts, metadata the version of matplotlib: no one sees either.
UNSEEN = re.compile(r"<!--.*?-->|<metadata>.*?</metadata>", re.DOTALL)
ID = re.compile(r' id="([^"]+)"')
REFERENCE = re.compile(r'(?:href="|url\()#([^")]+)')


def png(figure: Figure) -> bytes:
    """A figure as PNG."""
    content = io.BytesIO()
    with styled():
        figure.savefig(content, format="png", dpi=PNG_DPI)
    return content.getvalue()


def svg(figure: Figure) -> bytes:
    """A figure as SVG; an hour of frames makes it no heavier than a few minutes, save for each gap."""
    content = io.BytesIO()
    with styled():
        figure.savefig(content, format="svg", metadata={"Date": None})
    return compact(content.getvalue().decode()).encode()


def compact(drawing: str) -> str:
    """The same drawing of matplotlib's in fewer bytes: no comments, no ids that nothing refers to, thin polylines."""
    drawing = UNSEEN.sub("", drawing)
    used = set(REFERENCE.findall(drawing))
    drawing = ID.sub(lambda match: match[0] if match[1] in used else "", drawing)
    drawing = POLYLINE.sub(lambda match: "".join(map(_thin_part, match[0].split("M")[1:])), drawing)
    return re.sub(r"\s*\n\s*", "\n", drawing)


def _thin_part(part: str) -> str:
    """One connected part of a path, `x y L x y ... [z]`, thinned and in steps relative to the point before."""
    points = np.array(re.sub("[Lz]", " ", part).split(), float).reshape(-1, 2)
    steps = np.rint(STEPS_PER_PT * thinned(points)).astype(int)
    x, y = _numbers(steps[0])
    rest = f"l{' '.join(_numbers(np.diff(steps, axis=0).ravel()))}" if len(steps) > 1 else ""
    return f"M{x} {y}{rest}{'z' if part.rstrip().endswith('z') else ''}"


def _numbers(steps: np.ndarray) -> list[str]:
    return [f"{step / STEPS_PER_PT:.9g}" for step in steps.tolist()]


def thinned(points: FloatArray) -> FloatArray:
    """A polyline (N, 2) [pt] of fewer points that looks the same.

    Of the points that follow each other within one column, the first, last, lowest and highest (Jugel et al., M4: a
    visualization-oriented time series data aggregation, 2014); of these, those that the line needs to stay within the
    tolerance.
    """
    from matplotlib.path import Path

    column = np.floor(points[:, 0] / COLUMN_PT)
    run = np.cumsum(np.diff(column, prepend=column[0]) != 0)
    first = np.flatnonzero(np.diff(run, prepend=-1))
    last = np.append(first[1:], len(run)) - 1
    by_height = np.lexsort((points[:, 1], run))
    path = Path(points[np.unique(np.concatenate([first, last, by_height[first], by_height[last]]))])
    path.simplify_threshold = TOLERANCE_PT
    return np.asarray(path.cleaned(simplify=True).vertices)[:-1]
