"""What matters most, at a glance, and what is doubtful, in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from station.compare import UNIT_NAME, UNIT_SCALE, Comparison
from station.report.blocks import Block, Bullets, Facts, Section, Text, Tiles
from station.report.material import Material
from station.report.tables import shortened, three_digits

Tile = tuple[str, str, str]


def summary_section(material: Material) -> Section:
    """Tiles with the main numbers, warnings, and what the session is of."""
    blocks: list[Block] = [Tiles(tuple(_tiles(material)))]
    warnings = (*material.warnings, *_unmatched(material.comparison))
    blocks.append(Bullets(warnings) if warnings else Text("Nothing is doubtful: no warnings.", soft=True))
    if material.facts:
        blocks.append(Facts(material.facts))
    return Section("summary", "Summary", "Summary", blocks)


def _tiles(material: Material) -> Iterator[Tile]:
    if material.fit is not None:
        joints = material.fit.tree.movable
        types = Counter(joint.type for joint in joints)
        yield "joints found", str(len(joints)), ", ".join(f"{n} {kind}" for kind, n in types.items()) or "nothing moves"
    if material.comparison is not None and material.comparison.joints:
        yield _worst(material.comparison)
        yield _lag(material.comparison)
    if material.timing is not None:
        seconds = _length(material)
        yield "frames", str(len(material.timing.frame_s)), f"in {seconds:.1f} s"
        lost = material.counts.get("dropped_frames", int(material.timing.lost.sum()))
        yield "frames dropped", str(lost), "counted, not recorded"


def _length(material: Material) -> float:
    frame_s = material.timing.frame_s if material.timing else np.zeros(0)
    return float(np.ptp(frame_s)) if len(frame_s) else 0.0


def _worst(comparison: Comparison) -> Tile:
    """The joint with the largest RMSE of those in the unit that most have."""
    told = [(joint, joint.against_measured or joint.against_commanded) for joint in comparison.joints]
    unit = Counter(joint.unit for joint in comparison.joints).most_common(1)[0][0]
    among = [(agreement.rmse, joint) for joint, agreement in told if agreement is not None and joint.unit == unit]
    if not among:
        return "largest RMSE", "-", "nothing to compare with"
    rmse, joint = max(among, key=lambda pair: pair[0])
    reference = "read-back" if joint.against_measured else "command"
    number = f"{three_digits(UNIT_SCALE[unit] * rmse)} {UNIT_NAME[unit]}"
    return "largest RMSE", number, f"{shortened(joint.joint, 24)}, to its {reference}"


def _lag(comparison: Comparison) -> Tile:
    lag = comparison.lag
    name = "between the clocks" if comparison.clock_lag_s is not None else "camera's lag"
    if lag.lag_s is None:
        return name, "-", lag.why_not
    std = "" if lag.std_s is None else f" ± {three_digits(1e3 * lag.std_s)}"
    size = f"{three_digits(1e3 * lag.lag_s)}{std} ms" if abs(lag.lag_s) < 1 else f"{lag.lag_s:.3f} s"
    return name, size, "not applied" if lag.why_not else "applied"


def _unmatched(comparison: Comparison | None) -> Iterator[str]:
    if comparison is None:
        return
    for name in comparison.unmatched_commanded:
        yield f"{name}: no detected joint follows it, or it did not move"
    for name in comparison.unmatched_fitted:
        yield f"{name}: detected, but it follows no command or read-back"
