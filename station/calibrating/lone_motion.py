"""One joint at a time: a motion that moves each alone, and the stretches of a recording in which one did."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calibration.lag import period
from calibration.latency import SPAN_S, Sweep
from station.errors import InvalidData
from station.logs import BoolArray, FloatArray, JointLog
from station.motion import JointLimits
from station.perception.observations import ObservationLog
from station.perception.rolling_shutter import row_delay_s

# To either side of the park pose, in deg or mm: markers stay in view, and a person's hand out of the way.
SWING = {"rad": 15.0, "m": 10.0}
# A joint that can't swing by this much in all (deg, mm) tells little; limits are kept off by the margin.
LEAST_SWING = {"rad": 8.0, "m": 8.0}
MARGIN = {"rad": 1.0, "m": 0.5}
# Deg/s or mm/s, and its shares on the way there, back, ...: at one speed the rounding of the read-back would repeat.
SPEED = {"rad": 45.0, "m": 30.0}
SPEED_SHARES = (1.0, 0.83, 0.91, 0.76, 0.95)
REST_S = 0.25
UNIT = {"rad": "deg", "m": "mm"}
SCALE = {"rad": float(np.degrees(1.0)), "m": 1e3}

# rad/s or m/s over the window: slower is rest (a read-back that flickers by a count or two is).
MOVING = {"rad": float(np.radians(4.0)), "m": 4e-3}
SPEED_WINDOW_S = 0.2
# rad or m. A stretch in which the joint moves by less says nothing.
LEAST_TRAVEL = {"rad": float(np.radians(5.0)), "m": 5e-3}


def swinging_motion(joints: Sequence[JointLimits], names: Sequence[str] = ()) -> str:
    """The text of a motion.toml that swings joints to and fro about the park pose, one after the other.

    Args:
        joints: the rig's.
        names: which of them; all revolute ones that can swing if empty.

    Raises:
        InvalidData: a joint that isn't there, or none that can swing.
    """
    known = {joint.name: joint for joint in joints}
    missing = [name for name in names if name not in known]
    if missing:
        raise InvalidData(f"no joint '{missing[0]}'; the rig has {', '.join(known)}")
    chosen = [known[name] for name in names] or [joint for joint in joints if joint.unit == "rad"]
    steps = [step for joint in chosen for step in _swing(joint)]
    if not steps:
        listed = ", ".join(joint.name for joint in chosen) or "none is revolute"
        raise InvalidData(
            f"no joint can swing by {LEAST_SWING['rad']:g} deg about its park pose: {listed}; widen limits"
        )
    return "\n".join(['schema = "motion/1"', 'name = "one joint at a time"', *steps, ""])


def _swing(joint: JointLimits) -> list[str]:
    scale, margin, swing = SCALE[joint.unit], MARGIN[joint.unit], SWING[joint.unit]
    lower, upper, park = scale * joint.lower + margin, scale * joint.upper - margin, scale * joint.park
    ends = max(lower, park - swing), min(upper, park + swing)
    if ends[1] - ends[0] < LEAST_SWING[joint.unit]:
        return []
    fastest = min(SPEED[joint.unit], scale * joint.max_speed)
    targets = (ends[1], ends[0], ends[1], ends[0], park)
    return [
        f"[[step]]\nmove = {{ {joint.name} = {target:.3f} }}\n"
        f"speed_{UNIT[joint.unit]}_s = {share * fastest:.3f}\nhold_s = {REST_S}"
        for target, share in zip(targets, SPEED_SHARES, strict=True)
    ]


def lone_sweeps(
    measured: JointLog, observations: ObservationLog, *, readout_s: float, height_px: int, span_s: float = SPAN_S
) -> list[Sweep]:
    """The stretches in which one joint moved and the others rested, with the corners of all markers.

    Args:
        measured: read-back.
        observations: with the frames' stamps as they are.
        readout_s: from the first row of a frame to the last; the stamp is the middle row's.
        height_px: rows of a frame.
        span_s: frames are taken from so much before a stretch to so much after it.
    """
    if not len(measured.t_s) or not len(observations):
        return []
    t_s, px = _coordinates(observations, readout_s, height_px)
    sweeps: list[Sweep] = []
    for joint, rows in _stretches(measured):
        readback_t_s, states = measured.t_s[rows], measured.state(joint)[rows]
        near = (observations.t_s >= readback_t_s[0] - span_s) & (observations.t_s <= readback_t_s[-1] + span_s)
        seen = np.any(np.isfinite(px[near]), axis=0)
        sweeps.append(Sweep(joint, t_s[near][:, seen], px[near][:, seen], readback_t_s, states))
    return sweeps


def _coordinates(observations: ObservationLog, readout_s: float, height_px: int) -> tuple[FloatArray, FloatArray]:
    """Stamps and image coordinates (F, S) of all markers' corners; NaN where not seen."""
    ids, column = np.unique(observations.marker_id, return_inverse=True)
    px = np.full((len(observations.t_s), len(ids), 4, 2), np.nan)
    px[observations.frame, column] = observations.corners_px
    later_s = np.nan_to_num(row_delay_s(px[..., 1:], height_px, readout_s))
    t_s = observations.t_s[:, None, None, None] + np.broadcast_to(later_s, px.shape)
    return t_s.reshape(len(px), -1), px.reshape(len(px), -1)


def _stretches(measured: JointLog) -> Iterator[tuple[str, BoolArray]]:
    """Joints and the rows (N,) in which no other one moves, where the joint itself does enough."""
    moving = _moving(measured)
    for j, (name, unit) in enumerate(zip(measured.joints, measured.units, strict=True)):
        alone = ~np.any(np.delete(moving, j, axis=1), axis=1)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], alone, [False]]).astype(int)))
        for start, end in edges.reshape(-1, 2):
            states = measured.state(name)[start:end]
            known = states[np.isfinite(states)]
            if len(known) and np.ptp(known) >= LEAST_TRAVEL[unit]:
                rows = np.zeros(len(alone), dtype=np.bool_)
                rows[start:end] = True
                yield name, rows


def _moving(measured: JointLog) -> BoolArray:
    """(N, J) whether each joint moves, by its way over a window that is centred on the row."""
    half = max(1, round(SPEED_WINDOW_S / 2 / period(measured.t_s)))
    row = np.arange(len(measured.t_s))
    before, after = np.maximum(row - half, 0), np.minimum(row + half, len(row) - 1)
    way = np.abs(measured.q[after] - measured.q[before])
    least = np.array([MOVING[unit] for unit in measured.units])
    elapsed_s = np.maximum(measured.t_s[after] - measured.t_s[before], 1e-9)
    return np.nan_to_num(way) > least * elapsed_s[:, None]
