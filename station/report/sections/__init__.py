"""The report's sections, in the order of the page; one a file, each None where it has nothing to tell."""

from __future__ import annotations

from collections.abc import Callable

from station.report.blocks import Section
from station.report.material import Material
from station.report.sections.errors import errors_section
from station.report.sections.events import events_section
from station.report.sections.fit import fit_section
from station.report.sections.joints import joints_section
from station.report.sections.redoing import redoing_section
from station.report.sections.residuals import residuals_section
from station.report.sections.seen import seen_section
from station.report.sections.servos import servos_section
from station.report.sections.summary import summary_section
from station.report.sections.timing import timing_section
from station.report.sections.tree import tree_section

SECTIONS: tuple[Callable[[Material], Section | None], ...] = (
    summary_section,
    joints_section,
    errors_section,
    tree_section,
    fit_section,
    residuals_section,
    seen_section,
    timing_section,
    servos_section,
    events_section,
    redoing_section,
)
