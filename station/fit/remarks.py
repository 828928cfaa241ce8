"""Warnings about a fit, in plain sentences: what moved too little, what may be another type, what is not connected."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from station.fit.comparison import MIN_FRAMES
from station.fit.excitation import motion_share
from station.fit.noise import ROUNDING
from station.fit.reading import JointReading
from station.kinematics.joints import JOINT_TYPES
from station.kinematics.tree import Joint
from station.logs import FloatArray, PoseLog

# Deviations above which an axis [rad], a point of it [m], and a pitch (as a share of itself) are not known.
UNCERTAIN_AXIS_RAD = float(np.radians(5.0))
UNCERTAIN_POINT_M = 0.05
UNCERTAIN_PITCH = 1 / 3
# A ball's second turn [rad], as a deviation, that is not told from none: below this, or so many deviations of a state.
ONE_TURN_RAD, ONE_TURN_DEVIATIONS = float(np.radians(2.0)), 2.0
# Share of a joint's frames that are outliers, above which they may well be a motion that the tree leaves unexplained.
MANY_OUTLIERS = 0.2
# Probability below which a type is worth a word.
SURE = 0.9


def remarks(
    log: PoseLog,
    joints: Sequence[Joint],
    readings: Sequence[JointReading],
    trees: Sequence[Sequence[str]],
    doubts: Sequence[tuple[Joint, str, str, float]],
) -> tuple[str, ...]:
    """All that there is to say.

    Args:
        log: what was fitted.
        joints: with readings in the same order.
        readings: of the joints.
        trees: parts that joints and bodies connect, a tuple each.
        doubts: joints that may as well connect two other parts, and the odds against that.
    """
    found = [*_hardly_seen(log), *_half_known(log)]
    for joint, reading in zip(joints, readings, strict=True):
        found += [*_motion(joint), *_of_type(joint, reading), *_runner_up(joint)]
    found += _many_outliers(joints)
    found += _in_a_plane(joints)
    for joint, a, b, odds in doubts:
        found.append(
            f"{joint.name} may as well connect {a} and {b}, which move along the same line as {joint.parent} and "
            f"{joint.child}: the odds are {odds:.1f} to 1; move them one at a time"
        )
    if not joints and len(trees) == 1:
        found.append("no part moved against another: the tree has no joints")
    return (*found, *_apart(log, trees))


def _hardly_seen(log: PoseLog) -> list[str]:
    seen = np.array(log.seen).sum(axis=0)
    return [
        f"{part} was seen in {n} of {len(log.t_s)} frames: too few to join it to anything (want {MIN_FRAMES})"
        for part, n in zip(log.parts, seen, strict=True)
        if n < MIN_FRAMES
    ]


def _half_known(log: PoseLog) -> list[str]:
    if log.covariance is None:
        return []
    unknown = np.any(np.isnan(log.covariance[log.seen][:, :3, :3]), axis=(-2, -1))
    if not unknown.any() or unknown.all():
        return []
    return [
        f"{unknown.sum()} of {len(unknown)} poses have no covariance: the others' are not used, the noise is estimated"
    ]


def _motion(joint: Joint) -> list[str]:
    """What the motion was too small, or the noise too large, to tell of an axis or a centre."""
    if joint.state_max is None or joint.axis_std_rad is None:
        return _place(joint, "its centre")
    travel, unit = joint.state_max - (joint.state_min or 0.0), joint.unit
    moved = f"{np.degrees(travel):.1f} deg" if unit == "rad" else f"{travel * 1e3:.1f} mm"
    if joint.axis_std_rad < UNCERTAIN_AXIS_RAD:
        return _place(joint, "a point of its axis")
    if motion_share(travel, unit) < 1:
        return [f"{joint.name} moved only {moved}: its axis is not identifiable"]
    return [f"{joint.name}: its axis is known to {np.degrees(joint.axis_std_rad):.0f} deg only"]


def _many_outliers(joints: Sequence[Joint]) -> list[str]:
    shares = {joint.name: (joint.outliers or 0) / joint.frames for joint in joints if joint.frames}
    many = {name: share for name, share in shares.items() if share > MANY_OUTLIERS}
    if not many:
        return []
    told = ", ".join(f"{share:.0%} of {name}" for name, share in many.items())
    return [
        f"many frames are outliers ({told}): if the poses are good, a motion is left unexplained and the tree may be "
        "wrong; move one joint at a time, each for about as long"
    ]


def _in_a_plane(joints: Sequence[Joint]) -> list[str]:
    """Whether a hinge explains all errors of orientation, as where a tracker in 2D errs about one axis only."""
    turned = [joint for joint in joints if joint.type == "revolute" and joint.rms_rotation_rad is not None]
    flat = [joint.name for joint in turned if _is_flat(joint.rms_rotation_rad, joint.rms_translation_m)]
    if not flat:
        return []
    return [
        f"positions of {', '.join(flat)} have noise and orientations none about other axes than its own: poses of a "
        "tracker in 2D? a fit takes noise for alike in all directions; compare with --method paper"
    ]


def _is_flat(rotation_rad: float | None, translation_m: float | None) -> bool:
    if rotation_rad is None or translation_m is None:
        return False
    return 0 < rotation_rad < ROUNDING < translation_m


def _place(joint: Joint, what: str) -> list[str]:
    std = joint.point_std_m
    return (
        [] if std is None or std < UNCERTAIN_POINT_M else [f"{joint.name}: {what} is known to {std * 1e3:.0f} mm only"]
    )


def _of_type(joint: Joint, reading: JointReading) -> list[str]:
    """What a type has of its own and the motion doesn't tell: a screw's pitch, a ball's other turns."""
    pitch, std = joint.pitch_m_per_rad, reading.pitch_std_m_per_rad
    if pitch is not None and std is not None and std > UNCERTAIN_PITCH * abs(pitch):
        told = f"{pitch * 1e3:.1f} mm/rad, known to {std * 1e3:.1f} only"
        return [f"{joint.name}: its pitch is not identifiable ({told})"]
    if joint.kind.states == 3 and reading.good.any() and _turns_one_way(reading.q[reading.good], reading.std):
        return [
            f"{joint.name} turned about one axis only: a revolute joint may do, and its centre is any point of that"
        ]
    return []


def _turns_one_way(q: FloatArray, std: FloatArray) -> bool:
    """Whether rotation vectors (N, 3) spread along one line, but for their noise (T, 3)."""
    second = float(np.linalg.svd(q - q.mean(axis=0), compute_uv=False)[1]) / np.sqrt(len(q))
    known = std[np.isfinite(std)]  # of positions alone not every turn is
    return second < max(ONE_TURN_RAD, ONE_TURN_DEVIATIONS * float(np.median(known)) if known.size else 0.0)


def _runner_up(joint: Joint) -> list[str]:
    chances = joint.probability or {}
    own = chances.get(joint.type, 1.0)
    others = sorted(((p, name) for name, p in chances.items() if name != joint.type), reverse=True)
    if own >= SURE or not others:
        return []
    p, name = others[0]
    other = f"{name} has {p:.2f}" if name in JOINT_TYPES else f"that nothing joins its parts has {p:.2f}"
    return [f"{joint.name} is {joint.type} with a probability of {own:.2f} only; {other}"]


def _apart(log: PoseLog, trees: Sequence[Sequence[str]]) -> list[str]:
    """Why there are several trees: parts that move freely, and parts that were not seen together."""
    if len(trees) < 2:
        return []
    seen = np.array(log.seen)
    column = {part: seen[:, k] for k, part in enumerate(log.parts)}
    everywhere = np.ones(len(seen), dtype=bool)

    def together(one: Sequence[str], other: Sequence[str]) -> bool:
        common = [np.sum(column.get(a, everywhere) & column.get(b, everywhere)) for a in one for b in other]
        return bool(max(common, default=0) >= MIN_FRAMES)

    free = [(one, other) for one, other in combinations(trees, 2) if together(one, other)]
    if not free:
        return [f"nothing connects the {len(trees)} trees: their parts were not seen together"]
    parts = ", ".join(f"{one[0]} and {other[0]}" for one, other in free)
    return [f"no joint explains how these move against each other, they are free: {parts}"]
