"""What a check found: where, what, whether it blocks a capture, and how to mend it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

MOST_PLACES = 3  # that one line names
TABLE_COLUMNS, BETWEEN_COLUMNS = 100, 8  # of a terminal; of the gaps of a table of three columns

Value = float | int | str | bool | list[str] | None


class Verdict(StrEnum):
    """Whether a capture can be made with what was found."""

    OK = "ok"
    WARNING = "warning"
    BLOCKS = "blocks"


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        where: "port", "servo 3 (elbow)", "joint elbow", "camera", "disk".
        check: what was looked at, a few words.
        found: in a few words, units included.
        mend: what to do about it; empty where all is well.
        values: the numbers, their units in the names.
        brief: what people want to see of it even where all is well; empty for most.
    """

    where: str
    check: str
    verdict: Verdict
    found: str
    mend: str = ""
    values: Mapping[str, Value] = field(default_factory=dict[str, Value])
    brief: str = ""

    def as_dict(self) -> dict[str, object]:
        """The finding for JSON."""
        about = {"where": self.where, "check": self.check, "verdict": self.verdict.value, "found": self.found}
        return {**about, "mend": self.mend or None, **self.values}


def blocks(findings: Iterable[Finding]) -> bool:
    """Whether any of them blocks a capture."""
    return any(finding.verdict is Verdict.BLOCKS for finding in findings)


def summary_rows(findings: Iterable[Finding]) -> list[list[str]]:
    """A table, the header first: a row a place for all that is well there, and one for each thing that isn't."""
    places: dict[str, list[Finding]] = {}
    for finding in findings:
        places.setdefault(finding.where, []).append(finding)
    room = TABLE_COLUMNS - BETWEEN_COLUMNS - len(Verdict.WARNING) - max(map(len, places), default=0)
    rows = [["where", "verdict", "found"]]
    for where, here in places.items():
        well = [finding for finding in here if finding.verdict is Verdict.OK]
        if well:
            briefs = [finding.brief for finding in well if finding.brief]
            others = len(well) - len(briefs)
            count = [f"{others} {'more ' if briefs else ''}check{'s' if others > 1 else ''} passed"] if others else []
            rows.append([where, Verdict.OK.value, _cut(", ".join(briefs + count), room)])
        rows += [
            [where, f.verdict.value, _cut(f"{f.check}: {f.found}", room)] for f in here if f.verdict is not Verdict.OK
        ]
    return rows


def _cut(text: str, room: int) -> str:
    """The text as far as it fits on one line; JSON and the mends have all of it."""
    return text if len(text) <= room else text[: room - 1] + "…"


def mends(findings: Iterable[Finding]) -> list[str]:
    """What to do, what blocks first; a mend that several places need is said once, with all of them."""
    places: dict[tuple[bool, str], list[str]] = {}
    for finding in findings:
        if finding.mend:
            key = (finding.verdict is not Verdict.BLOCKS, finding.mend)
            where = places.setdefault(key, [])
            if finding.where not in where:
                where.append(finding.where)
    ordered = sorted(places.items(), key=lambda item: item[0][0])
    return [f"{_listed(where)}: {mend}" for (_, mend), where in ordered]


def _listed(places: list[str]) -> str:
    if len(places) <= MOST_PLACES:
        return ", ".join(places)
    return f"{', '.join(places[: MOST_PLACES - 1])} and {len(places) - MOST_PLACES + 1} more"
