"""What a running capture looks like on a terminal: one Snapshot drawn in 80 x 24 characters, or narrower."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.text import Text

from station.capture.snapshot import JointSnapshot, Snapshot
from station.capture.states import State
from station.motion import Unit

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult

STATE_STYLES: Mapping[State, str] = {
    State.IDLE: "reverse",
    State.CHECKING: "black on cyan",
    State.MOVING: "black on green",
    State.HOLDING: "black on cyan",
    State.PAUSED: "black on yellow",
    State.PARKING: "black on cyan",
    State.FAULT: "bold white on red",
}
# From here on a value is shown as doubtful, then as bad. AX servos shut down at 75 degC, X servos at 80 degC, unless
# set otherwise; any at a load of 1 for long.
WARM_C, HOT_C = 60.0, 70.0
LABOURING, STRAINED = 0.7, 0.9
# A part whose markers were seen so lately, s, is seen: some frames of any camera.
SEEN_S = 0.5
SAID_LINES = 2
# Among what was lost.
NOT_SHOWN = "live view"
ENOUGH = 1.0
BAR_CELLS = 10


@dataclass(frozen=True)
class Dashboard:
    """A capture at one moment, drawn; nothing in it is wider than the console.

    Args:
        disk: what is left, in words.
        asked: what the person is asked or told to do; shown beneath the state.
        foot: shown last, such as where the live view is.
    """

    snapshot: Snapshot
    disk: str = ""
    asked: str = ""
    foot: str = ""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield line by line."""
        for line in self.lines(options.max_width):
            line.no_wrap = True
            line.truncate(options.max_width, overflow="ellipsis")
            yield line

    def lines(self, width: int) -> list[Text]:
        """The lines for a console of so many columns."""
        now = self.snapshot
        lines = [_head(now, width), _bar(now, width)]
        lines += [Text(line, "bold") for line in _wrapped(self.asked, width, 2)]
        lines += _joint_table(now.joints, width)
        lines += _pairs(
            width, ("frames", _frames(now)), ("lost", _lost(now.lost)), ("not shown live", _not_shown(now.lost))
        )
        lines += _pairs(width, ("parts", _parts(now.seen_s, width - len("parts  "))))
        lines += _pairs(width, ("seen", _others(now.detected)))
        lines += _pairs(width, ("bus errors", _count(now.bus_errors)), ("disk", Text(self.disk)))
        lines += [Text(line, "yellow") for line in _wrapped(now.said, width, SAID_LINES)]
        if self.foot:
            lines.append(Text(self.foot, "dim"))
        return lines


def duration(seconds: float) -> str:
    """Minutes and seconds, with hours where there are some: 1:05, 2:00:07."""
    whole = max(0, int(seconds))
    minutes, s = divmod(whole, 60)
    h, m = divmod(minutes, 60)
    return f"{h}:{m:02}:{s:02}" if h else f"{m}:{s:02}"


def _head(now: Snapshot, width: int) -> Text:
    state = Text(f" {now.state.upper()} ", STATE_STYLES[now.state])
    times = duration(now.done_s) + ("" if now.total_s is None else f" of {duration(now.total_s)}")
    step = Text(f"  {now.step}", no_wrap=True)
    step.truncate(max(0, width - state.cell_len - len(times) - 1), overflow="ellipsis", pad=True)
    return Text.assemble(state, step, " ", (times, "bold"))


def _bar(now: Snapshot, width: int) -> Text:
    if now.total_s is None or now.total_s <= 0:
        return Text("until it is ended", "dim")
    share = min(1.0, max(0.0, now.done_s / now.total_s))
    told = f" {100 * share:3.0f} %, {duration(now.total_s - now.done_s)} left"
    return Text.assemble(_filled(share, max(4, width - len(told)), "green"), told)


def _filled(share: float, cells: int, style: str) -> Text:
    full = min(cells, int(share * cells))
    return Text.assemble(("━" * full, style), ("╌" * (cells - full), "dim"))


def _wrapped(text: str, width: int, most: int) -> list[str]:
    """The text in at most so many lines; the last one says by dots that there was more."""
    import textwrap

    return textwrap.wrap(" ".join(text.split()), max(width, 20), max_lines=most, placeholder=" …")


def _pairs(width: int, *pairs: tuple[str, Text]) -> list[Text]:
    """Names and values: side by side if they fit, else a line each; those without a value are left out."""
    told = [Text.assemble((name, "dim"), " ", value) for name, value in pairs if value.plain]
    joined = Text("   ").join(told)
    return [joined] if told and joined.cell_len <= width else told


def _frames(now: Snapshot) -> Text:
    return Text(f"{now.frames} at {now.frame_rate_hz:.1f}/s")


def _lost(lost: Mapping[str, int]) -> Text:
    told = [f"{reason} {count}" for reason, count in lost.items() if count and reason != NOT_SHOWN]
    return Text(", ".join(told), "yellow") if told else Text("none")


def _not_shown(lost: Mapping[str, int]) -> Text:
    """What the live view left out is no loss."""
    return Text(str(lost[NOT_SHOWN]), "dim") if lost.get(NOT_SHOWN) else Text("")


def _others(detected: Mapping[str, tuple[float | None, Unit]]) -> Text:
    """States of joints that are none of the arm's."""
    told = [Text.assemble(f"{name} ", _seen(value, unit)) for name, (value, unit) in detected.items()]
    return Text(", ").join(told)


def _count(count: int) -> Text:
    return Text(str(count), "yellow" if count else "")


def _parts(seen_s: Mapping[str, float | None], width: int) -> Text:
    """How many parts are seen, and those that aren't, the longest unseen first, as many as fit."""
    gone = {part: math.inf if since is None else since for part, since in seen_s.items()}
    gone = {part: since for part, since in gone.items() if since > SEEN_S}
    text = Text(f"{len(seen_s) - len(gone)} of {len(seen_s)} seen") if seen_s else Text("")
    if not gone:
        return text
    text.append("; not ")
    ordered = sorted(gone, key=lambda part: -gone[part])
    for k, part in enumerate(ordered):
        since = "never" if math.isinf(gone[part]) else f"for {gone[part]:.0f} s"
        more = f", {len(ordered) - k - 1} more"
        entry = f"{', ' if k else ''}{part} {since}"
        if k and text.cell_len + len(entry) + (len(more) if k + 1 < len(ordered) else 0) > width:
            text.append(f", {len(ordered) - k} more", "yellow")
            break
        text.append(entry, "yellow")
    return text


@dataclass(frozen=True)
class _Column:
    """A column of the joints' table: its cells, and how soon it goes where there is no room (the highest first)."""

    name: str
    cells: Sequence[Text]
    goes: int
    right: bool = True

    @property
    def width(self) -> int:
        return max([len(self.name), *(cell.cell_len for cell in self.cells)])


def _joint_table(joints: Sequence[JointSnapshot], width: int) -> list[Text]:
    if not joints:
        return []
    columns = [
        _Column("joint", [Text(joint.name) for joint in joints], 0, right=False),
        _Column("at", [_state(joint, joint.q) for joint in joints], 0),
        _Column("goal", [_state(joint, joint.goal) for joint in joints], 1),
        _Column("temp", [_graded(joint.temperature_c, "°C", WARM_C, HOT_C) for joint in joints], 4),
        _Column("volt", [Text(f"{joint.voltage_v:.1f} V") for joint in joints], 6),
        _Column("load", [_graded(abs(joint.load) * 100, " %", LABOURING * 100, STRAINED * 100) for joint in joints], 5),
    ]
    if any(joint.detected is not None for joint in joints):
        columns.insert(2, _Column("seen", [_seen(joint.detected, joint.unit) for joint in joints], 2))
    if any(joint.motion_share is not None for joint in joints):
        columns.append(_Column("enough motion?", [_enough(joint.motion_share) for joint in joints], 3, right=False))
    while len(columns) > 1 and _table_width(columns) > width:
        columns.remove(max(columns, key=lambda column: column.goes))
    return [_row(columns, None), *(_row(columns, k) for k in range(len(joints)))]


def _table_width(columns: Sequence[_Column]) -> int:
    return sum(column.width for column in columns) + 2 * (len(columns) - 1)


def _row(columns: Sequence[_Column], k: int | None) -> Text:
    cells: list[Text] = []
    for column in columns:
        cell = Text(column.name, "dim") if k is None else column.cells[k]
        space = Text(" " * (column.width - cell.cell_len))
        cells.append(space + cell if column.right else cell + space)
    return Text("  ").join(cells)


def _seen(value: float | None, unit: Unit) -> Text:
    """A state that the camera saw, which tells it finer than a servo does."""
    if value is None:
        return Text("unseen", "dim")
    return Text(f"{math.degrees(value):z.2f}°" if unit == "rad" else f"{value * 1e3:z.2f} mm")


def _state(joint: JointSnapshot, value: float | None) -> Text:
    if value is None:
        return Text("limp", "dim")
    return Text(f"{math.degrees(value):z.1f}°" if joint.unit == "rad" else f"{value * 1e3:z.1f} mm")


def _graded(value: float, unit: str, doubtful: float, bad: float) -> Text:
    return Text(f"{value:.0f}{unit}", "bold red" if value >= bad else "yellow" if value >= doubtful else "")


def _enough(share: float | None) -> Text:
    if share is None:
        return Text("")
    if share >= ENOUGH:
        return Text.assemble(("━" * BAR_CELLS, "green"), " yes ")
    return Text.assemble(_filled(max(0.0, share), BAR_CELLS, "yellow"), f" {100 * share:2.0f} %")
