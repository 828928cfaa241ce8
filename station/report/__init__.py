"""Figures, tables and the HTML report of a session; matplotlib and jinja2 are imported here alone, and late."""

from station.report.figure7 import Viewing, figure7
from station.report.material import Material, Redoing, Servos, Timing
from station.report.page import save_figure, write_report
from station.report.tables import session_lag_text, summary_rows, tree_rows
from station.report.tree_figure import tree_figure
from station.report.visibility import Visibility, visibility_figure

__all__ = [
    "Material",
    "Redoing",
    "Servos",
    "Timing",
    "Viewing",
    "Visibility",
    "figure7",
    "save_figure",
    "session_lag_text",
    "summary_rows",
    "tree_figure",
    "tree_rows",
    "visibility_figure",
    "write_report",
]
