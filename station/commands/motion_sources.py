"""Where a motion comes from: a packaged name, a motion.toml, a session to replay, or a commands.csv."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from station.errors import InvalidData, InvalidFile, LimitExceeded
from station.formats.motion import names_recordings, parse_motion
from station.formats.motion_text import format_motion
from station.formats.read import read_commands
from station.formats.text import read_text
from station.logs import JointLog
from station.motion import JointLimits, Motion, replay_of
from station.rig_reading import packaged, packaged_names


def read_motion(source: str, joints: Sequence[JointLimits]) -> tuple[Motion, str]:
    """A motion for the given joints, and the text of a motion.toml that is all of it: what a session keeps.

    Args:
        source: the name of a packaged one, the path of a motion.toml, of a session's folder (its read-back is
            replayed), or of a commands.csv.

    Raises:
        InvalidFile: with the file's name and what is wrong in it.
    """
    path = packaged("motions", source)
    if path.is_dir() or path.suffix.lower() == ".csv":
        return _as_kept(_replay(path, joints), joints)
    text = read_text(path, "motion", f"packaged ones are {', '.join(packaged_names('motions'))}")
    if not names_recordings(text, str(path)):
        return parse_motion(text, str(path), joints), text
    motion = parse_motion(text, str(path), joints, lambda file: recorded_states(path.parent / file, joints))
    return _as_kept(motion, joints)


def recorded_states(path: Path, joints: Sequence[JointLimits]) -> JointLog:
    """What the servos of a session reported, or a commands.csv has; raises InvalidFile."""
    if not path.exists():
        raise InvalidFile(f"{path} is missing; what is replayed is a session's folder or a commands.csv")
    if not path.is_dir():
        return read_commands(path, {joint.name: joint.unit for joint in joints})
    from station.recording import Recording

    measured = Recording.load(path).measured
    if not len(measured.t_s):
        raise InvalidFile(
            f"{path} has no read-back of servos: there is nothing to replay\n"
            "record one by hand with a rig that has servos: station capture RIG --hand --out DIR"
        )
    return measured


def _replay(path: Path, joints: Sequence[JointLimits]) -> Motion:
    try:
        step, notes = replay_of(recorded_states(path, joints), joints)
    except (InvalidData, LimitExceeded) as error:
        raise InvalidFile(f"{path}: {error}") from error
    return Motion(f"replay of {path.resolve().name}", (step,), "stream", notes=notes)


def _as_kept(motion: Motion, joints: Sequence[JointLimits]) -> tuple[Motion, str]:
    """The motion as its text has it, so that what is made again from that is the same to the bit."""
    text = format_motion(motion, joints)
    return replace(parse_motion(text, motion.name, joints), notes=motion.notes), text
