"""Lengthens a motion at its end, round by round, until enough was seen of each joint or nothing more can be done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from station.enough_motion import further_steps, with_enough
from station.errors import InvalidFile
from station.formats.motion import parse_motion
from station.formats.motion_text import format_motion, format_steps
from station.motion import JointLimits, Plan

# Begins the comment before each round's steps in a motion.toml, by which rounds are counted when a session goes on.
ROUND = "# Further motion, round "


class Lengthening:
    """Further rounds of a motion, at most so many of a session.

    Args:
        text: the motion.toml that the session has; rounds in it count.
        most: rounds in all; with 0 there are none, and nothing is said about what lacks.

    Attributes:
        text: the motion.toml of the plan that was made last.
        rounds: done so far.
    """

    def __init__(self, text: str, most: int) -> None:
        self.text, self._most = text, most
        self.rounds = text.count(ROUND)

    def longer(self, plan: Plan, shares: Mapping[str, float | None]) -> Plan | None:
        """The plan with a further round of legs for the joints that lack motion; None if none does or none is left."""
        while self.rounds < self._most:
            steps = further_steps(shares, self.rounds)
            longer = with_enough(plan, shares, self.rounds)
            if longer is None:
                return None
            self.rounds += 1
            comment = f"{ROUND}{self.rounds}: {lacking_text(shares)}"
            self.text = _with_steps(self.text, f"{comment}\n{format_steps(steps, plan.joints)}", longer)
            if len(longer.segments) > len(plan.segments):
                return longer
        return None

    def lacks(self, shares: Mapping[str, float | None]) -> str:
        """What to warn of at the end; empty where nothing lacks, or no round was asked for."""
        lacking = lacking_text(shares)
        if not self._most or not lacking:
            return ""
        return (
            f"not enough motion was seen for a fit, also after {self.rounds} further rounds: {lacking}\n"
            "look where its markers are out of view or turned away, and move it by more in another motion"
        )


def lacking_text(shares: Mapping[str, float | None]) -> str:
    """Which joints lack motion, and how much of what the fit needs was seen: "elbow 13 %, wrist 40 %"."""
    return ", ".join(f"{name} {100 * share:.0f} %" for name, share in shares.items() if share is not None and share < 1)


def _with_steps(text: str, added: str, longer: Plan) -> str:
    """The motion.toml with steps after those that it has, as people wrote them where that can be."""
    grown = f"{text.rstrip()}\n\n{added}"
    if _reads(grown, longer.joints):
        return grown
    # `step = [...]` in one array can't be followed by a [[step]].
    whole = format_motion(longer.motion, longer.joints)
    return f"{whole}\n{added.splitlines()[0]}\n"


def _reads(text: str, joints: Sequence[JointLimits]) -> bool:
    try:
        parse_motion(text, "motion.toml", joints)
    except InvalidFile:
        return False
    return True
