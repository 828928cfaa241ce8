"""Rigs as files: which file a name means, its table, and the joints in it; no device, no camera, no OpenCV."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np

from drivers.errors import DriverError
from drivers.joints import JointConfig, ServoConfig
from drivers.servo_models import load_model
from station.errors import InvalidData, InvalidFile
from station.formats.rig import RigTable, ServoTable, parse_rig
from station.formats.simulation import MM_PER_M
from station.formats.text import read_text


def packaged(kind: str, name_or_path: str) -> Path:
    """Path of a packaged rig or motion (`kind` "rigs" or "motions") of that name, else of the file itself."""
    inside = Path(str(resources.files("station") / kind / f"{name_or_path}.toml"))
    return inside if inside.is_file() else Path(name_or_path)


def packaged_names(kind: str) -> list[str]:
    """Names of the rigs or motions that come with the package."""
    return sorted(path.stem for path in Path(str(resources.files("station") / kind)).glob("*.toml"))


def read_rig(name_or_path: str) -> tuple[RigTable, str, Path]:
    """A rig's table, text and file, no calibration; raises InvalidFile, also for servos that can't be."""
    path = packaged("rigs", name_or_path)
    text = read_text(path, "rig", f"packaged ones are {', '.join(packaged_names('rigs'))}")
    table = parse_rig(text, str(path))
    try:
        joint_configs(table)
    except DriverError as error:
        raise InvalidFile(f"{path}: {error}") from error
    return table, text, path


def check_arm(table: RigTable, name: str) -> None:
    """Raise InvalidData for a rig without servos."""
    if not table.joint:
        raise InvalidData(
            f"{name} has no [bus] and no [[joint]]: there is no arm to command\n"
            "record what it shows while people move it: station capture RIG --hand --out DIR"
        )


def joint_configs(table: RigTable) -> tuple[JointConfig, ...]:
    """The rig's joints as the arm takes them; raises DriverError for what its servos can't be.

    A model whose firmware comes for either protocol ("MX-28") is the one of the bus's.
    """
    return tuple(
        JointConfig(
            name=joint.name,
            servos=tuple(
                ServoConfig(
                    id=servo.id,
                    model=load_model(servo.model, protocol=table.bus.protocol).name,
                    zero_count=servo.zero,
                    sign=servo.sign,
                    ratio=_ratio(servo),
                    ganging=servo.ganging,
                    reversed=servo.reversed,
                )
                for servo in joint.servo
            ),
            lower=limits.lower,
            upper=limits.upper,
            max_speed=limits.max_speed,
            unit=limits.unit,
        )
        for joint, limits in zip(table.joint, table.limits(), strict=True)
    )


def _ratio(servo: ServoTable) -> float:
    """Turn of the servo for one unit of the joint, rad/rad or rad/m."""
    return servo.gear or 1.0 if servo.lead_mm is None else 2 * np.pi / (servo.lead_mm / MM_PER_M)
