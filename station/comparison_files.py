"""The comparison as text, in degrees and millimetres: comparison.csv (every frame), comparison.json (the numbers)."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from station.compare import UNIT_NAME, UNIT_SCALE, Agreement, Comparison, JointComparison

SCHEMA = "comparison/1"
COLUMNS = ("t_s", "joint", "unit", "commanded", "measured", "detected", "detected_std")


def comparison_csv(comparison: Comparison) -> str:
    """A row a joint and frame: `t_s, joint, unit, commanded, measured, detected, detected_std`, joint after joint.

    `unit` (deg or mm) is that of the four states; detected is in the joint's own sign and zero; blank where unknown.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for joint in comparison.joints:
        writer.writerows(_rows(joint))
    return text.getvalue()


def _rows(joint: JointComparison) -> Iterable[list[str]]:
    states = np.stack([joint.commanded, joint.measured, joint.detected, joint.detected_std], axis=-1)
    unit = UNIT_NAME[joint.unit]
    for t_s, row in zip(joint.t_s.tolist(), (UNIT_SCALE[joint.unit] * states).tolist(), strict=True):
        yield [repr(t_s), joint.joint, unit, *("" if math.isnan(value) else f"{value:.6f}" for value in row)]


def comparison_json(comparison: Comparison) -> str:
    """The numbers of each joint, `"schema": "comparison/1"`; strict JSON: null where undefined.

    Lags in seconds; offset, rmse, mae and max carry their unit in their name (`_deg`, `_mm`). A section is null where
    there is no such reference. A joint's `lag_s` is its own, before any is applied; its errors are after sign, offset
    and `lag.applied_s`, the one lag of the session. `lag.rmse_before` tells them without it, in the joint's unit.
    """
    joints = [
        {
            "joint": joint.joint,
            "fitted_joint": joint.fitted_joint,
            "type": joint.type,
            "unit": UNIT_NAME[joint.unit],
            "sign": joint.sign,
            "commanded": _section(joint.against_commanded, joint.unit),
            "measured": _section(joint.against_measured, joint.unit),
        }
        for joint in comparison.joints
    ]
    return json.dumps({"schema": SCHEMA, "joints": joints, "lag": _lag(comparison)}, indent=2, allow_nan=False) + "\n"


def _lag(comparison: Comparison) -> dict[str, object]:
    lag, two_clocks = comparison.lag, comparison.clock_lag_s is not None
    return {
        "between": "clocks" if two_clocks else "camera and read-back",
        "lag_s": lag.lag_s,
        "std_s": lag.std_s,
        "applied_s": lag.applied_s,
        "why_not_applied": lag.why_not or None,
        "rmse_before": None if two_clocks else {joint.joint: _before(joint) for joint in comparison.joints},
    }


def _before(joint: JointComparison) -> dict[str, float | None]:
    agreements = {"commanded": joint.against_commanded, "measured": joint.against_measured}
    return {
        name: None if agreement is None else _or_none(UNIT_SCALE[joint.unit] * agreement.rmse_before_lag)
        for name, agreement in agreements.items()
    }


def _section(agreement: Agreement | None, unit: str) -> dict[str, float | int | None] | None:
    if agreement is None:
        return None
    suffix, scale = UNIT_NAME[unit], UNIT_SCALE[unit]
    return {
        "lag_s": _or_none(agreement.lag_s),
        "gain": _or_none(agreement.gain),
        f"offset_{suffix}": _or_none(scale * agreement.offset),
        f"rmse_{suffix}": _or_none(scale * agreement.rmse),
        f"mae_{suffix}": _or_none(scale * agreement.mae),
        f"max_{suffix}": _or_none(scale * agreement.max),
        "frames": agreement.frames,
    }


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def write_comparison(folder: Path, comparison: Comparison) -> None:
    """Write comparison.csv and comparison.json into `folder`, each whole or not at all."""
    write_files(
        folder,
        {
            "comparison.csv": comparison_csv(comparison).encode(),
            "comparison.json": comparison_json(comparison).encode(),
        },
    )


def write_files(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write files by name, all of them first under temporary names; a failure leaves what was there before."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = {name: folder / f".{name}.part" for name in contents}
    try:
        for name, content in contents.items():
            parts[name].write_bytes(content)
        for name, part in parts.items():
            part.replace(folder / name)
    finally:
        for part in parts.values():
            part.unlink(missing_ok=True)
