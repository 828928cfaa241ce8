"""Scripted motions: from steps to commanded joint states over time, checked against the joints' limits as a whole."""

from station.motion.layout import extended, plan_motion
from station.motion.limits import LIMIT_SLACK, SLOW, JointLimits, Unit
from station.motion.plan import DEFAULT_RATE_HZ, Mode, Motion, Plan, Segment
from station.motion.replay import Replay, replay_of
from station.motion.step import Step
from station.motion.steps import AT_MOST, SHARE, Combined, EachJoint, Explore, MotionStep, Reach
from station.motion.telling import ToldLegs, told_legs
from station.motion.waves import Sinusoids, SinusoidsInReach, Wave

__all__ = [
    "AT_MOST",
    "DEFAULT_RATE_HZ",
    "LIMIT_SLACK",
    "SHARE",
    "SLOW",
    "Combined",
    "EachJoint",
    "Explore",
    "JointLimits",
    "Mode",
    "Motion",
    "MotionStep",
    "Plan",
    "Reach",
    "Replay",
    "Segment",
    "Sinusoids",
    "SinusoidsInReach",
    "Step",
    "ToldLegs",
    "Unit",
    "Wave",
    "extended",
    "plan_motion",
    "replay_of",
    "told_legs",
]
