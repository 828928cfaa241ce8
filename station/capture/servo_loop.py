"""The servo loop of a planned motion: sends what is due, reads back, and puts the plan off where the arm was held."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drivers.errors import BusLost, NoReply
from station.capture.approach import approach
from station.capture.control import StopAsked, Wish
from station.capture.crew import NS_PER_S, SERVO_RATE_HZ, TURN_NS, Crew
from station.capture.leaving import RECONNECT_EVERY_S
from station.capture.lengthening import Lengthening, lacking_text
from station.capture.pausing import heed, hold
from station.capture.states import State
from station.logs import FloatArray
from station.motion import Plan

Progress = Callable[[float, float], None]
"""Is told seconds done and in all, in the servo loop's thread."""


class ServoLoop:
    """One plan on its way.

    The plan's time goes on with the clock but where the arm is held: after a pause, or with a camera that had gone
    away, the leg that was cut is done again from its start; where the bus had gone away the plan goes on later.

    Args:
        first_leg: the plan's leg to begin with.
        lengthening: adds legs at the plan's end while a joint lacks motion.
    """

    def __init__(
        self,
        crew: Crew,
        plan: Plan,
        progress: Progress | None,
        first_leg: int = 0,
        lengthening: Lengthening | None = None,
    ) -> None:
        self._crew, self._progress, self._lengthening = crew, progress, lengthening
        self._new_text: str | None = None  # the motion.toml of a plan that was lengthened, until a checkpoint has it
        self._leg, self._begins = first_leg, True  # the leg under way, and whether it is to begin, or begin again
        self._started = self._speeds_set = False
        self._start_ns = self._sent = self._turn = 0
        self._follow(plan)

    def _follow(self, plan: Plan) -> None:
        """Take over a plan; its legs before the one under way are those of the last plan."""
        self._plan = plan
        times_s = plan.command_times_s()
        self._due_ns = np.round(times_s * NS_PER_S).astype(np.int64)
        self._goals, self._legs = plan.commanded(times_s), plan.segment_index(times_s)
        self._leg_starts_ns = np.round([segment.t_start_s * NS_PER_S for segment in plan.segments]).astype(np.int64)
        self._end_ns = int(plan.duration_s * NS_PER_S)
        self._crew.situation.total_s = plan.duration_s

    def run(self) -> None:
        """To the end of the plan."""
        while self._begins or self._now_ns() < self._end_ns or self._lengthened():
            try:
                if self._begins:
                    self._begin_leg()
                else:
                    self._do_turn()
            except BusLost as lost:
                self._regain(lost)
        self._crew.frames.close()
        self._crew.journal.info("motion done")

    def _now_ns(self) -> int:
        """The plan's time."""
        return self._crew.clock.now_ns() - self._start_ns

    def _lengthened(self) -> bool:
        """Whether the plan, which is at its end, has got further legs; says what lacks."""
        crew, lengthening, legs = self._crew, self._lengthening, len(self._plan.segments)
        if lengthening is None:
            return False
        shares, lasted_ns = crew.motion.shares(), self._end_ns
        longer = lengthening.longer(self._plan, shares)
        if longer is None:
            if lacks := lengthening.lacks(shares):
                crew.journal.warn(lacks)
            return False
        self._new_text = lengthening.text
        self._follow(longer)
        begins_ns = int(self._leg_starts_ns[legs])
        self._start_ns += lasted_ns - begins_ns  # legs that were begun again in mid-curve took longer than they do here
        self._sent = int(np.searchsorted(self._due_ns, begins_ns, side="left"))
        self._turn = int(begins_ns * SERVO_RATE_HZ / NS_PER_S)
        more_s = (self._end_ns - begins_ns) / NS_PER_S
        crew.journal.info(
            f"further motion, round {lengthening.rounds}: {more_s:.1f} s more; of what a fit needs was seen of "
            f"these joints' motion: {lacking_text(shares)}"
        )
        return True

    def _begin_leg(self) -> None:
        """Go slowly to where the leg begins, once nothing holds the arm any more; then its time begins."""
        crew, leg = self._crew, self._leg
        crew.frames.close()
        while self._heed() or self._waited_for_camera():
            pass
        self._follow(self._plan.restarted(leg))
        segment, begins_ns = self._plan.segments[leg], int(self._leg_starts_ns[leg])
        crew.situation.step = f"to the start of step {segment.step}"
        most = self._speeds(leg) if self._started else None
        self._speeds_set = False
        approach(crew, self._plan.joints, segment.q_from, most, heed=self._heed)
        self._start_ns = crew.clock.now_ns() - begins_ns
        self._sent = int(np.searchsorted(self._due_ns, begins_ns, side="left"))
        self._turn = int(begins_ns * SERVO_RATE_HZ / NS_PER_S)
        self._say_begin(leg)
        self._begins, self._started = False, True
        crew.frames.open()

    def _say_begin(self, leg: int) -> None:
        legs = len(self._plan.segments)
        if self._started:
            self._crew.journal.info(f"leg {leg + 1} of {legs} again")
            return
        left_s = self._plan.duration_s - self._plan.segments[leg].t_start_s
        from_leg = f", from leg {leg + 1} of {legs}" if leg else ""
        self._crew.journal.info(f"motion '{self._plan.motion.name}' starts: {left_s:.1f} s{from_leg}")

    def _heed(self) -> bool:
        self._crew.check()
        return heed(self._crew, holds=True)

    def _do_turn(self) -> None:
        """Send what is due, read back, wait for the next turn, and look what happened meanwhile."""
        crew = self._crew
        due = int(np.searchsorted(self._due_ns, self._now_ns(), side="right"))
        if due > self._sent:  # of several that are due only the latest still counts
            self._send(self._goals[due - 1], int(self._legs[due - 1]))
            self._sent = due
        crew.read()
        self._turn = max(self._turn + 1, int(self._now_ns() * SERVO_RATE_HZ / NS_PER_S))
        crew.clock.sleep_until_ns(self._start_ns + int(self._turn * NS_PER_S / SERVO_RATE_HZ))
        crew.check()
        self._tell_progress()
        self._begins = crew.control.wish is not Wish.RUN or crew.frames.camera.away

    def _tell_progress(self) -> None:
        done_s = min(self._now_ns() / NS_PER_S, self._plan.duration_s)
        self._crew.situation.done_s = done_s
        if self._progress is not None:
            self._progress(done_s, self._plan.duration_s)

    def _send(self, goal: FloatArray, leg: int) -> None:
        """Command a goal; where a leg begins, with its speeds."""
        crew, segment = self._crew, self._plan.segments[leg]
        if leg != self._leg or not self._speeds_set:
            self._leg, self._speeds_set = leg, True
            crew.checkpoint(leg, len(self._plan.segments), self._new_text)
            self._new_text = None
            crew.rig.arm.set_speeds(self._speeds(leg))
            crew.journal.info(f"step {segment.step}")
            crew.situation.step = f"step {segment.step}, leg {leg + 1} of {len(self._plan.segments)}"
        crew.rig.arm.command(goal)
        crew.situation.goal = goal
        crew.tally.add("commands")

    def _speeds(self, leg: int) -> FloatArray:
        """The servos' own speed limits: the step's, which shapes a step; the joints' greatest, to follow a stream."""
        if self._plan.motion.mode == "step":
            return self._plan.segments[leg].speed
        return np.array([joint.max_speed for joint in self._plan.joints])

    def _waited_for_camera(self) -> bool:
        """Hold the arm while a camera that went away is waited for; raises what it failed with if it stays away."""
        crew = self._crew
        if not crew.frames.camera.away:
            return False
        crew.frames.close()
        hold(crew)
        crew.states.to(State.HOLDING)
        while crew.frames.camera.away:
            crew.clock.sleep_until_ns(crew.clock.now_ns() + TURN_NS)
            crew.read()
            self._check_stop()
        crew.check()
        crew.states.to(State.MOVING)
        return True

    def _regain(self, lost: BusLost) -> None:
        """Wait for a lost bus as long as the rig says, go back to where the arm was to be, and put the plan off.

        Raises `lost` where the rig doesn't wait or the bus doesn't come back; what the arm raises when it is back.
        """
        crew, patience_s = self._crew, self._crew.rig.table.safety.reconnect_s
        if patience_s <= 0:
            raise lost
        lost_ns, standing = crew.clock.now_ns(), crew.situation.goal
        crew.frames.close()
        crew.states.to(State.HOLDING)
        crew.journal.warn(f"{lost}\nwaiting {patience_s:g} s for it")
        while not self._is_back(standing):
            if crew.clock.now_ns() - lost_ns > patience_s * NS_PER_S:
                raise lost
            self._check_stop()
            crew.clock.sleep_until_ns(crew.clock.now_ns() + int(RECONNECT_EVERY_S * NS_PER_S))
        gone_ns = crew.clock.now_ns() - lost_ns
        self._start_ns += gone_ns
        self._speeds_set = False
        crew.tally.add("reconnects")
        crew.journal.info(f"the bus is back; the motion goes on, {gone_ns / NS_PER_S:.1f} s later than planned")
        crew.states.to(State.MOVING)
        if not self._begins:
            crew.frames.open()

    def _is_back(self, standing: FloatArray | None) -> bool:
        """Whether the bus is back, and the arm where it was to be."""
        crew, plan = self._crew, self._plan
        try:
            crew.rig.arm.connect()
            crew.rig.arm.torque_on()
            goal = plan.park if standing is None else standing
            approach(crew, plan.joints, goal, self._speeds(self._leg), heed=self._heed)
        except (BusLost, NoReply):
            return False
        return True

    def _check_stop(self) -> None:
        if self._crew.control.wish is Wish.STOP:
            raise StopAsked
