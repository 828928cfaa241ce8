"""What a trial found, as a table that fits the panel of controls."""

from __future__ import annotations

from html import escape

from station.builder.trial import Trial, TrialRow

# A fit's own deviation stands below what it is of, smaller.
STD_BEGINS, STD_ENDS = " (std ", ")"
HEADER = ("joint", "found", "axis off", "point off", "state off")
BOX = "padding: 0 0.75em 0.75em 0.75em; font-size: 0.8em; line-height: 1.35"
CELL = "padding: 0.25em 0.5em 0.25em 0; text-align: left; vertical-align: top"
FAINT, WRONG = "#6b7280", "#c92a2a"


def found_html(trial: Trial, *, is_older: bool) -> str:
    """HTML of a trial: its sentence, a row a joint, the fit's warnings.

    Args:
        trial: that was made.
        is_older: whether the draft has changed since.
    """
    older = f'<p style="color: {WRONG}">Of the tree before it was changed.</p>' if is_older else ""
    head = "".join(f'<th style="{CELL}; color: {FAINT}; font-weight: 500">{name}</th>' for name in HEADER)
    rows = "".join(_row(row) for row in trial.rows)
    warnings = "".join(f"<p>{escape(warning)}</p>" for warning in trial.fit.tree.warnings)
    legend = f'<p style="color: {FAINT}">In the scene: red as drawn, pink as found.</p>'
    table = f'<table style="width: 100%; border-collapse: collapse"><tr>{head}</tr>{rows}</table>'
    colour = "" if trial.scores.types_correct else f' style="color: {WRONG}"'
    headline = f"<p{colour}><b>{escape(trial.headline)}</b></p>"
    return f'<div style="{BOX}">{older}{headline}{table}{warnings}{legend}</div>'


def _row(row: TrialRow) -> str:
    wrong = f'<br><span style="color: {WRONG}">drawn {escape(row.true_type)}</span>'
    found = escape(row.found_type) + ("" if row.right else wrong)
    texts = (escape(row.true), found, *map(_with_std, (row.axis, row.point, row.states)))
    cells = "".join(f'<td style="{CELL}">{text}</td>' for text in texts)
    return f"<tr>{cells}</tr>"


def _with_std(text: str) -> str:
    value, begins, std = text.partition(STD_BEGINS)
    small = f'<br><span style="color: {FAINT}">std {escape(std.removesuffix(STD_ENDS))}</span>' if begins else ""
    return escape(value) + small
