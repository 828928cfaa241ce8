"""Stamps: how evenly frames and readings came, what was lost, and the camera's latency."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from station.logs import FloatArray
from station.report.blocks import Block, Drawing, Facts, Section, Table, Text
from station.report.drawings import svg
from station.report.material import Material, Timing
from station.report.tables import session_lag_text, three_digits
from station.report.timing_figure import timing_figure

MS_PER_S = 1e3
PERCENTILES = (1.0, 50.0, 99.0)
# An interval longer than this many median ones is a gap.
GAP = 1.5
HEAD = ("what", "number", "median [ms]", "jitter (std) [ms]", "1 % [ms]", "99 % [ms]", "longest [ms]", "gaps")
HOW = (
    "From the stamps of the session's monotonic clock: frames are stamped as they arrive, readings midway between "
    f"request and reply. Jitter: standard deviation of the intervals that are no gaps; gaps: longer than {GAP:g} "
    "medians. 'Loop': from one reading to the next, once a turn of the servo loop."
)
ALT = "Intervals between frames and between readings over time and how often each, the bus's replies, frames lost"


def timing_section(material: Material) -> Section | None:
    """None without stamps."""
    timing = material.timing
    if timing is None or not (len(timing.frame_s) or len(timing.request_s)):
        return None
    rows = list(_rows(timing))
    blocks: list[Block] = []
    if rows:
        blocks += [
            Table("timing", HEAD, rows),
            Drawing("timing", svg(timing_figure(timing)), ALT),
            Text(HOW, soft=True),
        ]
    blocks += [Text("Counts:"), Facts(dict(_counts(material, timing)))]
    return Section("timing", "Timing", "Timing and drops", blocks)


def _rows(timing: Timing) -> Iterator[list[str]]:
    if len(timing.frame_s) > 1:
        yield _row("frames", len(timing.frame_s), np.diff(timing.frame_s))
    if len(timing.request_s) > 1:
        yield _row("readings (loop)", len(timing.request_s), np.diff(timing.reading_s))
    if len(timing.request_s):
        yield _row("request to reply", len(timing.request_s), timing.reply_s - timing.request_s)


def _row(name: str, number: int, interval_s: FloatArray) -> list[str]:
    low, middle, high = np.percentile(interval_s, PERCENTILES).tolist()
    gaps = interval_s > GAP * middle
    jitter_s = float(np.std(interval_s[~gaps])) if np.any(~gaps) else 0.0
    numbers = [three_digits(MS_PER_S * value) for value in (middle, jitter_s, low, high, float(interval_s.max()))]
    return [name, str(number), *numbers, str(int(gaps.sum()))]


def _counts(material: Material, timing: Timing) -> Iterator[tuple[str, str]]:
    for name, number in material.counts.items():
        yield name.replace("_", " "), str(number)
    if len(timing.frame_s):
        yield "missing in the camera's numbering", str(int(timing.lost.sum()))
    if timing.fps is not None:
        yield "frames asked for", f"{timing.fps:g} a second"
    yield "latency taken off the frames' stamps", f"{three_digits(MS_PER_S * timing.latency_s)} ms"
    if material.comparison is not None and material.comparison.joints:
        yield "lag that is left", session_lag_text(material.comparison)
