"""Screw: the child turns about an axis of the parent and advances along it in proportion, as a nut on its bolt."""

from __future__ import annotations

import numpy as np

from station.kinematics import se3
from station.kinematics.joints.base import (
    BALANCE_M,
    JointFrames,
    JointType,
    Z,
    mean_rotation,
    weighted_mean,
    weighted_scatter,
    wrapped,
)
from station.kinematics.joints.closed_forms import (
    axis_by_turns,
    centre_by_turns,
    circle_about_z,
    frames_along_axis,
    turns_about_z,
)
from station.logs import FloatArray

TURN = 2 * np.pi
# Pitch [m/rad]: below the first a turn advances by rounding; a slide is a screw of the last.
LEAST_PITCH_M, LARGEST_PITCH_M = 1e-9, 1e3
# Mean length of the unit vectors to advance / pitch - angle above which the advance tells the turns: the noise is less
# than the pitch. Without a relation, some hundred frames give 0.1.
COHERENT = 0.6
# Weight, as a share of the largest, below which a frame takes no part in counting turns over time.
TRUSTED = 0.1
# Ratio of mean squares off a line below which turns that don't go on from frame to frame are the better ones: by
# chance, some hundred frames differ by a hundredth. A screw without pitch has the states of a hinge then.
CLEARLY = 0.9
# Turns over the travel that are looked for by the advance, and the steps between.
MOST_TURNS, TURN_STEP = 24.0, 0.25
# Directions in which a helix's axis is looked for; then rounds of steps from the best, to four sides each, that halve
# when they find no better.
DIRECTIONS = 50
FIRST_STEP_RAD, ROUNDS = 0.1, 16


class Screw(JointType):
    """fk(c, r, h; q) = r T(h q z) R_z(q) c: as revolute, and the pitch h [m/rad], positive for a right-handed screw.

    Unlike a hinge's, the state's full turns are told by the pose: states count on over turns and are never wrapped. A
    pitch within the noise does not tell them; then they are those of a motion that turns less than half a turn a frame.
    """

    name = "screw"
    parameters = 10
    position_parameters = 7
    paper_parameters = 13
    states = 1
    position_states = 1
    unit = "rad"
    has_axis = True
    has_point = True
    axis_freedoms = (0, 1, 3, 4)
    child_freedoms = (0, 1, 2, 3, 4)
    form_freedoms = 1
    usual = 0.1
    includes = ("revolute",)
    simpler = ("revolute", "prismatic")

    def axis_motion(self, q: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 4, 4) rotation about z by q (..., 1) radians, and translation along z by form (..., 1) times q."""
        T = se3.rotation_z(q[..., 0])
        T[..., 2, 3] = form[..., 0] * q[..., 0]
        return T

    def state_twists(self, form: FloatArray) -> FloatArray:
        """(..., 6, 1) about z, and by the pitch along it."""
        twists = np.zeros((*np.shape(form)[:-1], 6, 1))
        twists[..., 2, 0], twists[..., 5, 0] = form[..., 0], 1.0
        return twists

    def form_twists(self, q: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 6, 1) along z by the state."""
        twists = np.zeros((*np.shape(q)[:-1], 6, 1))
        twists[..., 2, 0] = q[..., 0]
        return twists

    def axis_state(self, T_axis_child: FloatArray, zero: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 1) radians: the turn of the orientation, whole turns by the advance; then both weighed."""
        turn = turns_about_z(T_axis_child[..., :3, :3], zero[..., :3, :3])
        rise, h = T_axis_child[..., 2, 3] - zero[..., 2, 3], form[..., 0]
        return _weighed(_turns_by_rise(turn, rise, h), rise, h, BALANCE_M)[..., None]

    def axis_state_of_position(self, p_axis: FloatArray, zero_axis: FloatArray, form: FloatArray) -> FloatArray:
        """(..., 1) radians between the positions about z, whole turns by the advance; both weighed as distances."""
        turn = np.arctan2(p_axis[..., 1], p_axis[..., 0]) - np.arctan2(zero_axis[..., 1], zero_axis[..., 0])
        rise, h = p_axis[..., 2] - zero_axis[..., 2], form[..., 0]
        radius = np.hypot(zero_axis[..., 0], zero_axis[..., 1])
        return _weighed(_turns_by_rise(wrapped(turn), rise, h), rise, h, radius)[..., None]

    def over_time(
        self, q: FloatArray, p_axis: FloatArray, zero_axis: FloatArray, form: FloatArray, weights: FloatArray
    ) -> FloatArray:
        """(..., T, 1) with the turns of all frames together: by the advance if that tells them, else from frame to
        frame.
        """
        turns = _whole_turns(wrapped(q[..., 0]), p_axis[..., 2] - zero_axis[..., None, 2], form, weights)[..., None]
        return turns + wrapped(q - turns)

    def continuous(self, q: FloatArray) -> FloatArray:
        """(..., T, 1) as they are: another turn is another pose."""
        return q

    def nearest_turn(self, q: FloatArray, near: FloatArray) -> FloatArray:
        """(..., 1) as they are: another turn is another pose."""
        return q

    def starts(self, T_parent_child: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """Axis by the turns; axis along the way of the positions, for a large pitch; axis across their plane."""
        R, p = T_parent_child[..., :3, :3], T_parent_child[..., :3, 3]
        _, directions = weighted_scatter(p, weights)
        by_turns = _by_turns(p, *axis_by_turns(R, weights), weights)
        along = _by_turns(p, *_turns_about(directions[..., 0], R, weights), weights)
        return by_turns, along, _by_circle(p, R, directions[..., 2], weights)

    def position_starts(self, p_parent: FloatArray, weights: FloatArray) -> tuple[JointFrames, ...]:
        """Helices about the directions, of many, that suit best: a drawn-out one and a flat one."""
        axes = _best_axis(p_parent, weights, drawn_out=True), _best_axis(p_parent, weights, drawn_out=False)
        return tuple(_by_circle(p_parent, None, axis, weights) for axis in axes)


def _ratio(rise: FloatArray, h: FloatArray) -> FloatArray:
    """(...,) state at which a screw of pitch h has this advance."""
    return rise / np.where(np.abs(h) > LEAST_PITCH_M, h, np.inf)


def _turns_by_rise(turn: FloatArray, rise: FloatArray, h: FloatArray) -> FloatArray:
    """(...,) the angle `turn` told by the full turn whose advance is nearest `rise`."""
    told = np.abs(h) > LEAST_PITCH_M
    return turn + TURN * np.where(told, np.rint((_ratio(rise, h) - turn) / TURN), 0.0)


def _weighed(q: FloatArray, rise: FloatArray, h: FloatArray, arm_m: FloatArray | float) -> FloatArray:
    """(...,) state with the least (arm (state - q))^2 + (h state - rise)^2."""
    total = arm_m**2 + h**2
    return q + np.where(total > 0, h * (rise - h * q) / np.where(total > 0, total, 1.0), 0.0)


def _turns_in_time(turn: FloatArray, weights: FloatArray) -> FloatArray:
    """(..., T) angles that go on from trusted frame to trusted frame; others by the turn nearest to the one before."""
    trusted = weights > TRUSTED * weights.max(axis=-1, keepdims=True)
    count = np.cumsum(trusted, axis=-1)  # trusted frames so far; before the first, the first
    order = np.argsort(~trusted, axis=-1, kind="stable")
    last = np.take_along_axis(order, np.maximum(count - 1, 0), axis=-1)
    smooth = np.unwrap(np.take_along_axis(turn, last, axis=-1), axis=-1)
    return smooth + wrapped(turn - smooth)


def _turns_at_once(turn: FloatArray, weights: FloatArray) -> FloatArray:
    """(..., T) angles within half a turn of their mean direction."""
    mean = np.angle(np.sum(weights * np.exp(1j * turn), axis=-1, keepdims=True))
    return mean + wrapped(turn - mean)


def _whole_turns(turn: FloatArray, rise: FloatArray, form: FloatArray, weights: FloatArray) -> FloatArray:
    """(..., T) angles with the turns of a screw of known pitch, form (..., 1)."""
    share, h = weights / weights.sum(axis=-1, keepdims=True), form
    ahead = _ratio(rise, h) - turn
    coherence = np.abs(np.sum(share * np.exp(1j * ahead), axis=-1, keepdims=True))
    by_rise = (coherence > COHERENT) & (np.abs(h) > LEAST_PITCH_M)
    found, least = turn, np.full((*turn.shape[:-1], 1), np.inf)
    for q in (_turns_in_time(turn, weights), _turns_at_once(turn, weights)):
        lag = np.sum(share * (_ratio(rise, h) - q), axis=-1, keepdims=True)
        q = q + TURN * np.where(np.abs(h) > LEAST_PITCH_M, np.rint(lag / TURN), 0.0)
        off = np.sum(share * (rise - h * q) ** 2, axis=-1, keepdims=True)
        better = off < CLEARLY * least
        found, least = np.where(better, q, found), np.where(better, off, least)
    return np.where(by_rise, _turns_by_rise(turn, rise, h), found)


def _turns_by_phase(turn: FloatArray, rise: FloatArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angles (..., T) with the turns of the pitch at which rise / pitch and angle go together best, and how well they
    do (..., 1).

    The phase rise / pitch - angle is the same in all frames, whatever their order and however many turns lie between
    them. It is looked for as the frequency of largest power in exp(i angle) over the advance.
    """
    mean = np.sum(share * rise, axis=-1, keepdims=True)
    span = np.sqrt(12 * np.sum(share * (rise - mean) ** 2, axis=-1, keepdims=True))  # of an even motion
    step = TURN * TURN_STEP / np.where(span > 0, span, 1.0)
    count = round(MOST_TURNS / TURN_STEP)
    vector = share * np.exp(1j * (-count * step * (rise - mean) - turn))
    advance = np.exp(1j * step * (rise - mean))
    best, best_sum = np.zeros_like(span), np.zeros_like(span, dtype=np.complex128)
    for n in range(-count, count + 1):  # over candidates, not frames
        total = vector.sum(axis=-1, keepdims=True)
        better = np.abs(total) > np.abs(best_sum)
        best, best_sum = np.where(better, n * step, best), np.where(better, total, best_sum)
        vector *= advance
    ahead = best * (rise - mean) - np.angle(best_sum) - turn
    return turn + TURN * np.rint(ahead / TURN), np.abs(best_sum)


def _pitch(q: FloatArray, rise: FloatArray, share: FloatArray, arm_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slope of the line through (q, rise), and mean square off it [m^2] of (arm q, rise); (..., 1) each."""
    dq = arm_m * (q - np.sum(share * q, axis=-1, keepdims=True))
    dz = rise - np.sum(share * rise, axis=-1, keepdims=True)
    qq, qz, zz = (np.sum(share * product, axis=-1, keepdims=True) for product in (dq**2, dq * dz, dz**2))
    angle = 0.5 * np.arctan2(2 * qz, qq - zz)
    off = 0.5 * (qq + zz) - np.hypot(0.5 * (qq - zz), qz)
    return arm_m * np.sin(angle) / np.maximum(np.cos(angle), arm_m / LARGEST_PITCH_M), off


def _turns_and_pitch(
    turn: FloatArray, rise: FloatArray, weights: FloatArray, arm_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Angles (..., T) with their turns, and the pitch (..., 1), of the reading whose advances are nearest to a line."""
    share = weights / weights.sum(axis=-1, keepdims=True)
    by_phase, coherence = _turns_by_phase(turn, rise, share)
    q = _turns_in_time(turn, weights)
    pitch, off = _pitch(q, rise, share, arm_m)
    for reading, allowed in ((_turns_at_once(turn, weights), True), (by_phase, coherence > COHERENT)):
        its_pitch, its_off = _pitch(reading, rise, share, arm_m)
        better = allowed & (its_off < CLEARLY * off)
        q, pitch, off = np.where(better, reading, q), np.where(better, its_pitch, pitch), np.where(better, its_off, off)
    return q, pitch


def _by_turns(
    p: FloatArray, R_axis_parent: FloatArray, R_axis_child: FloatArray, turn: FloatArray, weights: FloatArray
) -> JointFrames:
    """Pitch, centre and arm by least squares in the turns (..., T) about a known axis."""
    p_axis = p @ np.swapaxes(R_axis_parent, -1, -2)
    q, pitch = _turns_and_pitch(turn, p_axis[..., 2], weights, np.array(BALANCE_M))
    centre, arm = centre_by_turns(_lowered(p_axis, pitch * q), q, weights)
    return frames_along_axis(R_axis_parent, R_axis_child, centre, arm, pitch)


def _turns_about(axis: FloatArray, R: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """R_axis_parent, R_axis_child and the turns (..., T) of rotations (..., T, 3, 3) about an axis of the parent."""
    R_axis_parent = np.swapaxes(se3.rotation_between(Z, axis), -1, -2)
    turned = R_axis_parent[..., None, :, :] @ R
    axis_child = np.einsum("...t,...tj->...j", weights, turned[..., 2, :])
    R_axis_child = se3.rotation_between(axis_child, Z)
    return R_axis_parent, R_axis_child, turns_about_z(turned, R_axis_child[..., None, :, :])


def _by_circle(p: FloatArray, R: FloatArray | None, axis: FloatArray, weights: FloatArray) -> JointFrames:
    """A circle through the positions seen along an axis (..., 3), and the pitch by the angles about its centre."""
    R_axis_parent = np.swapaxes(se3.rotation_between(Z, axis), -1, -2)
    p_axis = p @ np.swapaxes(R_axis_parent, -1, -2)
    centre, radius = circle_about_z(p_axis, weights)
    out = p_axis - centre[..., None, :]
    q, pitch = _turns_and_pitch(np.arctan2(out[..., 1], out[..., 0]), out[..., 2], weights, radius[..., None])
    share = weights / weights.sum(axis=-1, keepdims=True)
    centre[..., 2] -= np.sum(share * pitch * q, axis=-1)
    arm = np.stack([radius, 0 * radius, 0 * radius], axis=-1)
    if R is None:
        return frames_along_axis(R_axis_parent, R_axis_parent, centre, arm, pitch)
    back = np.swapaxes(se3.rotation_z(q)[..., :3, :3], -1, -2) @ R_axis_parent[..., None, :, :] @ R
    return frames_along_axis(R_axis_parent, mean_rotation(back, weights), centre, arm, pitch)


def _lowered(p: FloatArray, by: FloatArray) -> FloatArray:
    """Points (..., T, 3) taken down by (..., T) along z."""
    return np.stack([p[..., 0], p[..., 1], p[..., 2] - by], axis=-1)


def _best_axis(p: FloatArray, weights: FloatArray, *, drawn_out: bool) -> FloatArray:
    """(..., 3) axis of the helix with the least mean square distance of positions (..., T, 3) from it.

    Directions are laid out as they stand to the scatter, so that the frame in which positions are told changes nothing,
    and crowded about its longest extent, or its shortest. Valleys between the two may have several floors.
    """
    centre, directions = _scatter(p, weights)
    along = (p - centre[..., None, :]) @ directions
    spread = np.sqrt(weighted_mean(along**2, weights))
    spread = spread / np.maximum(spread[..., :1], np.finfo(float).tiny) + FIRST_STEP_RAD
    best = np.broadcast_to(np.eye(3)[0], centre.shape)
    least = np.full((*centre.shape[:-1], 1), np.inf)
    for direction in _half_sphere(DIRECTIONS):  # over candidates, not frames; all at once would be much memory
        best, least = _better_axis(direction * spread if drawn_out else direction / spread, along, weights, best, least)
    step = np.full(least.shape, FIRST_STEP_RAD)
    for turn in np.arange(ROUNDS)[:, None] + np.arange(4) * np.pi / 2:  # each round from the best so far
        before, R = least, se3.rotation_between(Z, best)
        for side in turn:
            aside = step * np.array([np.cos(side), np.sin(side), 0.0]) + Z
            best, least = _better_axis((R @ aside[..., None])[..., 0], along, weights, best, least)
        step = np.where(least < before, step, 0.5 * step)
    return (directions @ best[..., None])[..., 0]


def _better_axis(
    axis: FloatArray, p: FloatArray, weights: FloatArray, best: FloatArray, least: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The axis (..., 3), of any length, where a helix about it is nearer to the positions than `least`, else `best`."""
    axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    off = _off_helix(p @ se3.rotation_between(Z, axis), weights)
    return np.where(off < least, axis, best), np.fmin(off, least)


def _scatter(p: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (..., 3) of positions and their principal directions (..., 3, 3), a rotation with signs that they tell."""
    centre, directions = weighted_scatter(p, weights)
    along = (p - centre[..., None, :]) @ directions[..., :2]
    skew = weighted_mean(along**3, weights)
    signed = directions[..., :2] * np.where(skew < 0, -1.0, 1.0)[..., None, :]
    x, y = signed[..., 0], signed[..., 1]
    return centre, np.stack([x, y, np.cross(x, y)], axis=-1)


def _off_helix(p_axis: FloatArray, weights: FloatArray) -> FloatArray:
    """(..., 1) mean square distance [m^2] of positions from the best helix about z, turns counted in time."""
    share = weights / weights.sum(axis=-1, keepdims=True)
    centre, radius = circle_about_z(p_axis, weights)
    out = p_axis - centre[..., None, :]
    off_circle = np.hypot(out[..., 0], out[..., 1]) - radius[..., None]
    q = _turns_in_time(np.arctan2(out[..., 1], out[..., 0]), weights)
    _, off_line = _pitch(q, out[..., 2], share, radius[..., None])
    return np.sum(share * off_circle**2, axis=-1, keepdims=True) + off_line


def _half_sphere(count: int) -> FloatArray:
    """(count, 3) unit vectors evenly over the half sphere z >= 0, on a spiral (Fibonacci lattice)."""
    i = np.arange(count) + 0.5
    height, turn = 1 - i / count, np.pi * (1 + np.sqrt(5)) * i
    across = np.sqrt(1 - height**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=-1)
