"""How much of what a joint type explains is a simpler type, seen by a tracker with errors of its own habits.

Trackers' errors are no white noise: they change with the view, so that a rigid part wobbles as another moves, a slide
looks bent and a hinge seems to advance along its axis. Likelihood takes every such trait for motion once there are
frames enough. So the evidence of a type that was seen is shared between it and what may be real, by the odds

    density of the trait if errors fake it : density of the trait if the motion is real,

times the odds that the tracker's errors have habits at all. Whoever has them shows them in what is left of the poses:
the odds are even where an error lasts for two frames or more, and fall to LEAST_HABITS where no error outlasts its own.

Faked traits are half-normal about none; real ones have any size (log-uniform over RANGE), unless a prior is said:

- any motion may be the wobble of a rigid part: WOBBLE times the noise that is left in the states;
- a hinge may be a slide. Straight lines look like circles of BENT_M or more, and the turn is faked up to BENT_TURN_RAD:
  they leave their chord by up to a hundredth of its length. A real hinge is ARM_M or so from what it carries;
- a screw may be a hinge or a slide if its poses differ from theirs by no more than WOBBLE times the noise;
- a ball may be a hinge if the second of its turns is FAKED_TURN_RAD or so; a real one's is LESSER_TURN_RAD.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from station.fit.noise import INLIER_ABOVE
from station.fit.pairwise import JointFit, PairTracks
from station.fit.priors import ARM_M, LESSER_TURN_RAD, RANGE, arm_m
from station.fit.state_spread import Spread
from station.logs import FloatArray

WOBBLE = 0.5
LEAST_HABITS = 0.01
# In a scene of more than a metre, for each metre of it.
BENT_M = 5.0
BENT_TURN_RAD = float(np.radians(4.5))
FAKED_TURN_RAD = float(np.radians(1.0))
# Sizes below this [m, or in units of the noise] are none.
NOTHING = 1e-9


@dataclass(frozen=True, eq=False)
class Seen:
    """A type as it was fitted: the spread of its states, and that over the states' noise (P,)."""

    fit: JointFit
    spread: Spread
    over_noise: FloatArray


Odds = Callable[[Seen, Seen, PairTracks], FloatArray]


def _half_normal(x: FloatArray, deviation: FloatArray | float) -> FloatArray:
    """Log density."""
    return 0.5 * np.log(2 / np.pi) - np.log(deviation) - 0.5 * (x / deviation) ** 2


def _within_noise(over_noise: FloatArray) -> FloatArray:
    """Log odds that a motion of a size in units of the noise is faked."""
    size = np.maximum(over_noise, NOTHING)
    return _half_normal(size, WOBBLE) + np.log(size) + np.log(RANGE)


def _bend(hinge: Seen, slide: Seen, tracks: PairTracks) -> FloatArray:
    """By the curvature 1 / r, in which both densities are told, with r in metres of the lab."""
    radius = np.maximum(arm_m(hinge.fit) / tracks.lab_m, NOTHING)
    length = radius * hinge.spread.travel
    faked = 1 / np.sqrt(BENT_M**2 + (length / BENT_TURN_RAD) ** 2)
    return _half_normal(1 / radius, faked) - _half_normal(radius, ARM_M) - 2 * np.log(radius)


def _difference(seen: Seen, real: Seen, tracks: PairTracks) -> FloatArray:
    """By how much worse the simpler type fits, in units of the noise that the richer one leaves."""
    good = (seen.fit.inlier > INLIER_ABOVE) & tracks.seen
    whitener, _ = tracks.noise.whitener(seen.fit.model.scales, tracks.seen, tracks.oriented)
    chi2 = [np.sum((whitener @ x.fit.residual[..., None])[..., 0] ** 2, axis=-1) for x in (real, seen)]
    soaked = seen.fit.joint.states - real.fit.joint.states
    worse = np.sum(good * (chi2[0] - chi2[1] - soaked), axis=-1) / np.maximum(good.sum(axis=-1), 1)
    return _within_noise(np.sqrt(np.maximum(worse, 0.0)))


def _second_turn(ball: Seen, hinge: Seen, tracks: PairTracks) -> FloatArray:
    turn = ball.spread.deviations[:, -2]
    return _half_normal(turn, FAKED_TURN_RAD) - _half_normal(turn, LESSER_TURN_RAD)


# What was seen, what may be real. A new type needs a line only for traits that errors fake beside wobbling.
LOOKALIKES: Mapping[tuple[str, str], Odds] = {
    ("revolute", "prismatic"): _bend,
    ("screw", "prismatic"): _difference,
    ("screw", "revolute"): _difference,
    ("spherical", "revolute"): _second_turn,
}


def shared(
    log_evidence: Mapping[str, FloatArray], seen: Mapping[str, Seen], tracks: PairTracks, time: FloatArray
) -> dict[str, FloatArray]:
    """Log evidence (P,) of what is real, from that of what was seen; richer types come first in `seen`.

    `time` (P,) are the frames that repeat an error of the likeliest type.
    """
    found, log_habits = dict(log_evidence), np.log(np.clip(time - 1, LEAST_HABITS, 1.0))
    for name, look in seen.items():
        odds: dict[str, FloatArray] = {}
        if "rigid" in found and name != "rigid":
            odds["rigid"] = _within_noise(look.over_noise)
        for (of, real), log_odds in LOOKALIKES.items():
            if of == name and real in seen:
                odds[real] = log_odds(look, seen[real], tracks)
        odds = {real: value + log_habits for real, value in odds.items()}
        whole = np.logaddexp.reduce([np.zeros_like(found[name]), *odds.values()], axis=0)
        for real, value in odds.items():
            found[real] = np.logaddexp(found[real], found[name] + value - whole)
        found[name] = found[name] - whole
    return found
