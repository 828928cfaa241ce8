"""rig.toml as text: its tables in order, and those that don't depend on how the object is drawn."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.intrinsics import CameraModel
from station.builder.draft import limits_of
from station.builder.drawing import shown_unit
from station.kinematics.tree import Joint
from station.logs import FloatArray
from station.perception.markers import Marker

# Emulated: positions of one turn, all registers known (drivers/servo_models).
MODEL, COUNTS, CENTRE = "XM430-W350", 4096, 2048
# Of that turn, what a joint's whole range may take.
TURN_SHARE = 0.8
SPEEDS = {"deg": 60, "mm": 100}


@dataclass(frozen=True)
class Table:
    """A table of a TOML file: its header, "" for the top, in brackets for one of an array; and its keys."""

    header: str
    keys: Mapping[str, object]


def written(tables: Iterable[Table]) -> str:
    """Text of TOML tables."""
    blocks = []
    for table in tables:
        header = [f"[{table.header}]"] if table.header else []
        blocks.append("\n".join([*header, *(f"{key} = {_value(value)}" for key, value in table.keys.items())]))
    return "\n\n".join(blocks) + "\n"


def servo_tables(joints: Sequence[Joint]) -> Iterator[Table]:
    """`[bus]`, and of each joint `[[joint]]` with its limits and a servo whose one turn holds them."""
    yield Table("bus", {"port": "emulated", "baud": 1_000_000, "protocol": 2.0})
    for number, joint in enumerate(joints, start=1):
        unit, per_unit = shown_unit(joint)
        low, high = limits_of(joint)
        keys: dict[str, object] = {"name": joint.name, f"limits_{unit}": numbers(np.array([low, high]) / per_unit, 6)}
        keys[f"max_speed_{unit}_s"] = SPEEDS[unit]
        park = min(max(0.0, low), high)
        if park:
            keys[f"park_{unit}"] = round(park / per_unit, 6)
        yield Table("[joint]", keys)
        yield Table("[joint.servo]", {"id": number, "model": MODEL, **_gearing(joint)})


def _gearing(joint: Joint) -> dict[str, object]:
    """How a servo drives a joint so that its limits and its zero lie within a turn."""
    low, high = limits_of(joint)
    span, middle = max(high, 0.0) - min(low, 0.0), 0.5 * (max(high, 0.0) + min(low, 0.0))
    if joint.unit == "m":
        lead_mm = float(f"{1e3 * span / TURN_SHARE:.6g}")
        return {"zero": CENTRE - round(1e3 * middle / lead_mm * COUNTS), "lead_mm": lead_mm}
    gear = float(f"{min(1.0, TURN_SHARE * 2 * np.pi / span):.6g}")
    found: dict[str, object] = {"zero": CENTRE - round(gear * middle / (2 * np.pi) * COUNTS)}
    return found if gear == 1.0 else {**found, "gear": gear}


def hand_limits(joint: Joint) -> dict[str, object]:
    """How far a hand moves a joint without a servo."""
    unit, per_unit = shown_unit(joint)
    return {f"limits_{unit}": numbers(np.array(limits_of(joint)) / per_unit, 6)}


def camera_tables(camera: CameraModel) -> Iterator[Table]:
    """`[camera]` with its calibration."""
    size = list(camera.size_px)
    yield Table("camera", {"source": "rendered", "size_px": size, "fps": 30, "latency_s": 0.016})
    calibration = {"size_px": size, "matrix": camera.matrix.tolist(), "distortion": camera.distortion.tolist()}
    yield Table("camera.calibration", calibration)


def markers_table(dictionary: str, markers: Sequence[Marker], names: Sequence[str]) -> Table:
    """`[markers]`, each tracked as the part of that name."""
    rows = [
        {"id": marker.id, "part": name, "size_mm": round(1e3 * marker.size_m, 3)}
        for marker, name in zip(markers, names, strict=True)
    ]
    return Table("markers", {"dictionary": dictionary, "marker": rows})


def numbers(values: FloatArray, digits: int = 3) -> list[float]:
    """Floats with so many digits after the point; no -0."""
    return [round(float(value), digits) + 0.0 for value in values]


def _value(value: object) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        return "[\n" + "".join(f"  {_value(item)},\n" for item in value) + "]"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return repr(value)
