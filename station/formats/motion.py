"""motion.toml: a scripted motion in degrees and millimetres, read strictly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from station.errors import InvalidFile
from station.formats.toml_models import StrictModel, parse
from station.motion import DEFAULT_RATE_HZ, JointLimits, Motion, MotionStep, Unit

MOTION_SCHEMA = "motion/1"
MM_PER_M = 1e3

Positive = Annotated[float, Field(gt=0)]


class StepModel(StrictModel):
    """One `[[step]]`; see `MotionStep`."""

    move: dict[str, float]
    speed_deg_s: Positive | None = None
    speed_mm_s: Positive | None = None
    hold_s: Annotated[float, Field(ge=0)] = 0.0
    repeat: Annotated[int, Field(ge=1)] = 1


class MotionModel(StrictModel):
    """The keys of motion.toml; see `Motion`."""

    name: str
    mode: Literal["step", "stream"] = "step"
    rate_hz: Positive = DEFAULT_RATE_HZ
    step: list[StepModel]


def parse_motion(text: str, name: str, joints: Sequence[JointLimits]) -> Motion:
    """The motion in a motion.toml text, for the given joints, in SI units.

    Raises:
        InvalidFile: with the file's `name`, for unknown keys, wrong types, joints that the rig doesn't have, or a
            speed in the other unit than the joint's.
    """
    model = parse(MotionModel, text, name, MOTION_SCHEMA)
    units: dict[str, Unit] = {joint.name: joint.unit for joint in joints}
    steps = tuple(_step(step, number, name, units) for number, step in enumerate(model.step, start=1))
    return Motion(model.name, steps, model.mode, model.rate_hz)


def _step(step: StepModel, number: int, name: str, units: dict[str, Unit]) -> MotionStep:
    for joint in step.move:
        if joint not in units:
            raise InvalidFile(f"{name}, step {number}: no joint '{joint}'; the rig has {', '.join(units)}")
    moved = {units[joint] for joint in step.move}
    if (step.speed_deg_s is not None and "m" in moved) or (step.speed_mm_s is not None and "rad" in moved):
        raise InvalidFile(
            f"{name}, step {number}: the speed's unit isn't that of all its joints\n"
            "use speed_deg_s for revolute joints, speed_mm_s for prismatic ones, and a step for each kind"
        )
    speed = None if step.speed_deg_s is None else math.radians(step.speed_deg_s)
    speed = speed if step.speed_mm_s is None else step.speed_mm_s / MM_PER_M
    move = {joint: math.radians(x) if units[joint] == "rad" else x / MM_PER_M for joint, x in step.move.items()}
    return MotionStep(move, speed, step.hold_s, step.repeat)
