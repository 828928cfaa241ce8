"""Motions and steps as the text of a motion.toml: what a session keeps of motions that no file holds as such."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence

from station.formats.motion import MOTION_SCHEMA
from station.formats.motion_kinds import Units, in_text
from station.motion import (
    Combined,
    EachJoint,
    Explore,
    JointLimits,
    Motion,
    MotionStep,
    Reach,
    Replay,
    Sinusoids,
    SinusoidsInReach,
    Step,
    Unit,
    Wave,
)

UNIT_KEYS: Mapping[Unit, str] = {"rad": "deg", "m": "mm"}
NUMBERS_IN_A_LINE = 12


def format_motion(motion: Motion, joints: Sequence[JointLimits]) -> str:
    """The text of a motion.toml that reads back as this motion, to twelve digits; its notes become comments."""
    head = [
        f'schema = "{MOTION_SCHEMA}"',
        f"name = {json.dumps(motion.name, ensure_ascii=False)}",
        *(f"# {line}" for note in motion.notes for line in note.splitlines()),
        f'mode = "{motion.mode}"',
        f"rate_hz = {_number(motion.rate_hz)}",
    ]
    return "\n".join(head) + "\n\n" + format_steps(motion.steps, joints)


def format_steps(steps: Iterable[Step], joints: Sequence[JointLimits]) -> str:
    """The steps as [[step]] tables, to follow others in a motion.toml."""
    units: Units = {joint.name: joint.unit for joint in joints}
    return "\n\n".join("\n".join(["[[step]]", *_lines(step, units)]) for step in steps) + "\n"


def _lines(step: Step, units: Units) -> list[str]:
    match step:
        case MotionStep():
            targets = ", ".join(f"{joint} = {_number(in_text(x, units[joint]))}" for joint, x in step.move.items())
            return [f"move = {{ {targets} }}", *_common(step, _speeds(step, units))]
        case EachJoint() | Combined() | Explore() | SinusoidsInReach():
            return [*_common(step, step.speeds), f"{step.kind} = {{ {', '.join(_reach(step))} }}"]
        case Sinusoids():
            return [*_common(step, {}), "[step.sinusoids]", *_waves(step, units)]
        case Replay():
            return [*_common(step, {}), "[step.replay]", *_states(step, units)]
        case _:
            raise TypeError(f"a step of kind {step.kind} has no text")


def _speeds(step: MotionStep, units: Units) -> dict[Unit, float]:
    return {units[joint]: step.speed for joint in step.move if step.speed is not None}


def _common(
    step: MotionStep | EachJoint | Combined | Explore | SinusoidsInReach | Sinusoids | Replay,
    speeds: Mapping[Unit, float],
) -> list[str]:
    told = [(key, in_text(speeds[unit], unit)) for unit, key in UNIT_KEYS.items() if unit in speeds]
    lines = [f"speed_{key}_s = {_number(speed)}" for key, speed in told]
    lines += [f"hold_s = {_number(step.hold_s)}"] if step.hold_s else []
    return lines + ([f"repeat = {step.repeat}"] if step.repeat != 1 else [])


def _reach(step: EachJoint | Combined | Explore | SinusoidsInReach) -> list[str]:
    reach: Reach = step.reach
    keys = [f"share = {_number(reach.share)}"]
    keys += [f"at_most_{UNIT_KEYS[unit]} = {_number(in_text(most, unit))}" for unit, most in reach.at_most.items()]
    keys += [f"{key} = {json.dumps(names)}" for key, names in (("joints", reach.joints), ("skip", reach.skip)) if names]
    match step:
        case Combined(poses=int(poses)):
            keys.append(f"poses = {poses}")
        case Explore(poses=poses, seed=seed):
            keys += [f"poses = {poses}", f"seed = {seed}"]
        case SinusoidsInReach(cycles=cycles):
            keys.append(f"cycles = {cycles}")
        case _:
            pass
    return keys


def _waves(step: Sinusoids, units: Units) -> list[str]:
    lines = [f"duration_s = {_number(step.duration_s)}"]
    lines += [] if step.ramp_s is None else [f"ramp_s = {_number(step.ramp_s)}"]
    return lines + [f"joint.{name} = {{ {_wave(wave, units[name])} }}" for name, wave in step.waves.items()]


def _wave(wave: Wave, unit: Unit) -> str:
    key = UNIT_KEYS[unit]
    keys = [
        f"amplitude_{key} = {_number(in_text(wave.amplitude, unit))}",
        f"frequency_hz = {_number(wave.frequency_hz)}",
        f"phase_deg = {_number(in_text(wave.phase, 'rad'))}",
    ]
    keys += [] if wave.centre is None else [f"centre_{key} = {_number(in_text(wave.centre, unit))}"]
    return ", ".join(keys)


def _states(step: Replay, units: Units) -> list[str]:
    columns = [f"{UNIT_KEYS[units[name]]}.{name}" for name in step.joints]
    states = [[in_text(float(x), units[name]) for x in step.q[:, k]] for k, name in enumerate(step.joints)]
    return [f"t_s = {_array(step.t_s.tolist())}", *(f"{c} = {_array(q)}" for c, q in zip(columns, states, strict=True))]


def _array(values: Sequence[float]) -> str:
    """A TOML array, some numbers a line."""
    told = [_number(value) for value in values]
    rows = [", ".join(told[k : k + NUMBERS_IN_A_LINE]) for k in range(0, len(told), NUMBERS_IN_A_LINE)]
    return "[\n  " + ",\n  ".join(rows) + ",\n]"


def _number(value: float) -> str:
    """To twelve digits: what was written in degrees stays readable."""
    return repr(float(f"{value:.12g}"))
