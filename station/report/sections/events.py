"""What happened in the session: steps, pauses, faults; folded where there is much of it."""

from __future__ import annotations

from collections.abc import Sequence

from station.report.blocks import Block, Folded, Section, Table, Text
from station.report.material import Happening, Material

# More than these are folded; of more than those only the first and the last are told, and what is no mere INFO.
FOLDED, MOST = 12, 400
WORDS = {"INFO": "", "WARN": "warning", "ERROR": "error"}


def events_section(material: Material) -> Section | None:
    """Warnings and errors always in view; all events below, unfolded where they are few."""
    events = material.events
    if not events:
        return None
    grave = [event for event in events if event.level != "INFO"]
    blocks: list[Block] = []
    if len(events) <= FOLDED:
        return Section("events", "Events", "Events", [_table(events)])
    if grave:
        blocks.append(_table(_bounded(grave)))
    else:
        blocks.append(Text("No warnings and no errors.", soft=True))
    shown = _bounded(events)
    summary = f"all {len(events)} events" if len(shown) == len(events) else f"{len(shown)} of {len(events)} events"
    blocks.append(Folded(summary, [_table(shown)]))
    return Section("events", "Events", "Events", blocks)


def _bounded(events: Sequence[Happening]) -> Sequence[Happening]:
    return events if len(events) <= MOST else [*events[: MOST // 2], *events[-MOST // 2 :]]


def _table(events: Sequence[Happening]) -> Table:
    rows = [[f"{event.t_s:.2f}", WORDS.get(event.level, event.level), event.text] for event in events]
    return Table("events", ("time [s]", "", "what"), rows, frozenset({1, 2}))
