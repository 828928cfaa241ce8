"""motion.toml: a scripted motion in degrees and millimetres, read strictly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from station.errors import InvalidData, InvalidFile, LimitExceeded
from station.formats.motion_kinds import (
    CombinedModel,
    ExploreModel,
    Positive,
    ReachModel,
    ReplayModel,
    SinusoidsModel,
    Units,
    in_si,
)
from station.formats.toml_models import StrictModel, parse
from station.logs import JointLog
from station.motion import (
    DEFAULT_RATE_HZ,
    Combined,
    EachJoint,
    Explore,
    JointLimits,
    Motion,
    MotionStep,
    Replay,
    Sinusoids,
    SinusoidsInReach,
    Step,
    Unit,
    replay_of,
)

MOTION_SCHEMA = "motion/1"
# Longer ones are mistakes.
MOST_REPEATS = 10_000

Recorded = Callable[[str], JointLog]
"""The joint states in a session's folder or a commands.csv, by its path as a motion.toml has it."""


class StepModel(StrictModel):
    """One `[[step]]`: one of the kinds, how fast, and how it rests; see `Step` and what implements it."""

    move: dict[str, float] | None = None
    speed_deg_s: Positive | None = None
    speed_mm_s: Positive | None = None
    hold_s: Annotated[float, Field(ge=0)] = 0.0
    repeat: Annotated[int, Field(ge=1, le=MOST_REPEATS)] = 1
    each_joint: ReachModel | None = None
    combined: CombinedModel | None = None
    sinusoids: SinusoidsModel | None = None
    explore: ExploreModel | None = None
    replay: ReplayModel | None = None

    @model_validator(mode="after")
    def _check(self) -> StepModel:
        kinds = ("move", "each_joint", "combined", "sinusoids", "explore", "replay")
        have = [kind for kind in kinds if getattr(self, kind) is not None]
        if len(have) != 1:
            raise ValueError(f"have {' and '.join(have) or 'none'}; want one of {', '.join(kinds)}")
        timed = self.sinusoids is not None and self.sinusoids.joint is not None
        timed = timed or (self.replay is not None and self.replay.file is None)
        if timed and (self.speed_deg_s is not None or self.speed_mm_s is not None):
            raise ValueError(f"{have[0]} say by themselves when each joint is where; leave speed_deg_s, speed_mm_s out")
        return self

    def speeds(self) -> dict[Unit, float]:
        """rad/s and m/s, where they are given."""
        given: dict[Unit, float | None] = {"rad": self.speed_deg_s, "m": self.speed_mm_s}
        return {unit: in_si(speed, unit) for unit, speed in given.items() if speed is not None}


class MotionModel(StrictModel):
    """The keys of motion.toml; see `Motion`."""

    name: str
    mode: Literal["step", "stream"] = "step"
    rate_hz: Positive = DEFAULT_RATE_HZ
    step: list[StepModel]


def parse_motion(text: str, name: str, joints: Sequence[JointLimits], recorded: Recorded | None = None) -> Motion:
    """The motion in a motion.toml text, for the given joints, in SI units.

    Args:
        text: the file's text.
        name: the file's name, for errors.
        joints: of the rig.
        recorded: reads the recordings that replays name; without it those are refused.

    Raises:
        InvalidFile: with the file's `name`, for unknown keys, wrong types, joints that the rig doesn't have, a speed in
            the other unit than the joint's, or a recording that can't be replayed.
    """
    model = parse(MotionModel, text, name, MOTION_SCHEMA)
    units: Units = {joint.name: joint.unit for joint in joints}
    steps: list[Step] = []
    notes: list[str] = []
    for number, step in enumerate(model.step, start=1):
        try:
            if step.replay is not None and step.replay.file is not None:
                made, said = _replayed(step.replay.file, step, joints, recorded)
                notes += said
            else:
                made = _step(step, units)
        except (InvalidData, LimitExceeded) as error:
            raise InvalidFile(f"{name}, step {number}: {error}") from error
        steps.append(made)
    return Motion(model.name, tuple(steps), model.mode, model.rate_hz, tuple(notes))


def names_recordings(text: str, name: str) -> bool:
    """Whether a motion.toml text names recordings to replay: it isn't all of the motion then."""
    model = parse(MotionModel, text, name, MOTION_SCHEMA)
    return any(step.replay is not None and step.replay.file is not None for step in model.step)


def _step(step: StepModel, units: Units) -> Step:
    """The step in SI units, but for recordings; raises InvalidData."""
    speeds, hold_s, repeat = step.speeds(), step.hold_s, step.repeat
    if step.move is not None:
        return _move(step, step.move, units)
    if step.each_joint is not None:
        return EachJoint(step.each_joint.reach(units), speeds, hold_s, repeat)
    if step.combined is not None:
        return Combined(step.combined.reach(units), step.combined.poses, speeds, hold_s, repeat)
    if step.explore is not None:
        explore = step.explore
        return Explore(explore.reach(units), explore.poses, explore.seed, speeds, hold_s, repeat)
    if step.replay is not None:
        names, t_s, q = step.replay.states(units)
        return Replay(names, t_s, q, hold_s, repeat)
    waves = step.sinusoids or SinusoidsModel()
    if waves.joint is None:
        return SinusoidsInReach(waves.reach(units), waves.cycles, speeds, hold_s, repeat)
    return Sinusoids(waves.waves(units), waves.duration_s or 0.0, waves.ramp_s, hold_s, repeat)


def _move(step: StepModel, move: dict[str, float], units: Units) -> MotionStep:
    for joint in move:
        if joint not in units:
            raise InvalidData(f"no joint '{joint}'; the rig has {', '.join(units)}")
    moved = {units[joint] for joint in move}
    if (step.speed_deg_s is not None and "m" in moved) or (step.speed_mm_s is not None and "rad" in moved):
        raise InvalidData(
            "the speed's unit isn't that of all its joints\n"
            "use speed_deg_s for revolute joints, speed_mm_s for prismatic ones, and a step for each kind"
        )
    speed = next(iter(step.speeds().values()), None)
    return MotionStep({joint: in_si(x, units[joint]) for joint, x in move.items()}, speed, step.hold_s, step.repeat)


def _replayed(
    file: str, step: StepModel, joints: Sequence[JointLimits], recorded: Recorded | None
) -> tuple[Replay, list[str]]:
    """The replay of a recording, and what was changed in it."""
    if recorded is None:
        raise InvalidData(f"replay names the recording {file}, which isn't read here; give its states instead")
    replay, notes = replay_of(recorded(file), joints, step.speeds())
    replay = replace(replay, hold_s=step.hold_s, repeat=step.repeat)
    return replay, [f"{Path(file).name}: {note}" for note in notes]
