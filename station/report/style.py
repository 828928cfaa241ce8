"""The look of all figures: colours of the light and the dark page, sizes, fonts."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

WIDTH_IN = 10.0


@dataclass(frozen=True)
class Theme:
    """Colours; the series are of Okabe and Ito, told apart with any colour vision and by lightness."""

    paper: str
    ink: str
    faint: str
    commanded: str
    measured: str
    detected: str
    viewing: str
    oblique: str


# Figures are drawn in the light one. No two of its colours are equal: the page tells by them which is which.
LIGHT = Theme("#ffffff", "#1a1a1a", "#d9d9d9", "#4d4d4d", "#56b4e9", "#b84a00", "#00795a", "#e69f00")
DARK = Theme("#16181c", "#e8e8e8", "#3a3d44", "#b5b5b5", "#0072b2", "#ff9d4d", "#2fc79d", "#e69f00")


@contextmanager
def styled() -> Iterator[None]:
    """The style in which figures are drawn and saved; a person's own matplotlibrc has no say."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(
            {
                "figure.facecolor": LIGHT.paper,
                "axes.facecolor": LIGHT.paper,
                "axes.edgecolor": LIGHT.ink,
                "axes.labelcolor": LIGHT.ink,
                "text.color": LIGHT.ink,
                "xtick.color": LIGHT.ink,
                "ytick.color": LIGHT.ink,
                "grid.color": LIGHT.faint,
                "axes.grid": True,
                "axes.axisbelow": True,
                "axes.spines.top": False,
                "axes.spines.right": False,
                "axes.linewidth": 0.7,
                "grid.linewidth": 0.5,
                "font.size": 9.0,
                "axes.labelsize": 9.0,
                "xtick.labelsize": 8.5,
                "ytick.labelsize": 8.5,
                "svg.hashsalt": "station",
            }
        )
        yield
