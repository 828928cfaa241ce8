"""When each part was seen, and how obliquely: for sessions without commands, whose report has no Figure 7."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from station.logs import FloatArray
from station.report import thinning
from station.report.figure7 import OBLIQUE_DEG
from station.report.style import LIGHT, WIDTH_IN, styled
from station.report.tables import shortened

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROW_IN = 0.3
BAR = 0.62  # of a row
LABEL_LETTERS = 24


@dataclass(frozen=True, eq=False)
class Visibility:
    """Parts over time.

    Attributes:
        t_s: (T,).
        parts: K names.
        seen: (T, K) whether a pose of the part was found.
        viewing_deg: (T, K) between its markers' normal and the line of sight; NaN where no marker was detected.
    """

    t_s: FloatArray
    parts: tuple[str, ...]
    seen: NDArray[np.bool_]
    viewing_deg: FloatArray


def visibility_figure(what: Visibility) -> Figure:
    """A bar a part, where it was seen; lighter where it was seen obliquely. Right of it, in how many frames."""
    from matplotlib.figure import Figure

    height_in = 0.7 + ROW_IN * max(len(what.parts), 1)
    with styled():
        figure = Figure(figsize=(WIDTH_IN, height_in))
        top, bottom = 1 - 0.1 / height_in, 0.5 / height_in
        axes = figure.add_axes((0.17, bottom, 0.7, top - bottom))
        for row, part in enumerate(what.parts):
            _draw_part(axes, row, part, what)
        axes.set_ylim(len(what.parts) - 0.5, -0.5)
        axes.set_yticks([])
        axes.grid(visible=False, axis="y")
        if len(what.t_s):
            axes.set_xlim(float(what.t_s[0]), float(_ends(what.t_s)[-1]))
        axes.set_xlabel("time [s]")
        return figure


def _draw_part(axes: Axes, row: int, part: str, what: Visibility) -> None:
    seen, oblique = what.seen[:, row], what.viewing_deg[:, row] > OBLIQUE_DEG
    for shown, colour in ((seen & ~oblique, LIGHT.viewing), (seen & oblique, LIGHT.oblique)):
        axes.broken_barh(_runs(*thinning.flags(what.t_s, shown)), (row - BAR / 2, BAR), facecolors=colour, linewidth=0)
    beside = {"transform": axes.get_yaxis_transform(), "va": "center", "fontsize": 8.5}
    axes.text(-0.012, row, shortened(part, LABEL_LETTERS), ha="right", **beside)
    axes.text(1.012, row, f"{int(seen.sum())} of {len(seen)}", ha="left", **beside)


def _ends(t_s: FloatArray) -> FloatArray:
    """(T,) until when each frame counts: the next one; the last as long as the middle one of all."""
    step_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 1.0
    return np.append(t_s[1:], t_s[-1:] + step_s)


def _runs(t_s: FloatArray, shown: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Start and length [s] of each unbroken run of frames."""
    rows = np.flatnonzero(shown)
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if rows.size else []
    ends = _ends(t_s)
    return [(float(t_s[run[0]]), float(ends[run[-1]] - t_s[run[0]])) for run in runs]
