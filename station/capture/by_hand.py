"""Records an arm, or any marked object, that people move by hand: torque off, read-back and frames, no commands."""

from __future__ import annotations

from drivers.errors import BusLost, NoReply
from station.capture.control import Control, StopAsked
from station.capture.counts import CaptureCounts
from station.capture.crew import NS_PER_S, SERVO_RATE_HZ, Crew
from station.capture.ending import Unbroken, end
from station.capture.leaving import RECONNECT_EVERY_S, leave_alone
from station.capture.live_view import LiveView
from station.capture.pausing import heed
from station.capture.recorder import SessionWriter
from station.capture.servo_loop import Progress
from station.capture.snapshot import Watcher
from station.capture.states import State
from station.kinematics.tree import KinematicTree
from station.releasing import Ask, release
from station.rig import Rig


def take_in_hand(rig: Rig, ask: Ask) -> None:
    """Check the arm's servos, if there are any, and switch torque off, after it was asked where it is on.

    Raises:
        StationError: the person says no.
        DriverError: a servo that isn't there, or isn't fit for use.
    """
    if rig.table.joint:
        rig.arm.connect()
        release(rig.arm, ask)


class HandCapture:
    """One capture by hand: from a rig whose arm is limp to a closed recording. Nothing is written to a servo.

    It has the same threads, states and wishes as a planned one. While the bus is away frames are recorded on, while the
    camera is away readings are.

    Args:
        duration_s: how long to record; until a stop or a KeyboardInterrupt if None: those are normal ends.
        progress, control, watch, live, tree: as of a planned capture.
    """

    def __init__(
        self,
        rig: Rig,
        writer: SessionWriter,
        *,
        duration_s: float | None = None,
        progress: Progress | None = None,
        control: Control | None = None,
        watch: Watcher | None = None,
        live: LiveView | None = None,
        tree: KinematicTree | None = None,
    ) -> None:
        self._rig, self._writer = rig, writer
        self._duration_s, self._progress = duration_s, progress
        self._crew = Crew(rig, writer, control=control, watch=watch, live=live, tree=tree)
        self._start_ns = self._turn = 0
        self._look_ns = 0  # when a bus that is away is looked for next
        self._lost: tuple[int, BusLost] | None = None  # since when the bus is away

    def run(self) -> CaptureCounts:
        """Record until the end.

        Raises:
            StationError: the recording can't be written.
            DriverError: the bus or the camera fails; the recording is then closed as "interrupted".
        """
        ending, failure = Unbroken("end of the capture"), None
        try:
            self._look_on()
        except BaseException as error:
            failure = error
        return end(
            ending,
            self._crew,
            self._writer,
            failure,
            complete=failure is None,
            leave=lambda: leave_alone(self._crew, "limp, as it was", failure),
        )

    def _look_on(self) -> None:
        with self._crew.clock.seat():
            try:
                self._begin()
                while self._duration_s is None or self._done_ns() < self._duration_s * NS_PER_S:
                    self._do_turn()
            except (KeyboardInterrupt, StopAsked):
                self._crew.journal.info("stopped")
            finally:
                self._crew.frames.ask_to_end()

    def _begin(self) -> None:
        crew = self._crew
        crew.start()
        crew.states.to(State.CHECKING)
        if crew.has_arm:
            crew.journal.info(f"moved by hand, torque off: {', '.join(self._rig.arm.names)}")
        crew.situation.step, crew.situation.total_s = "by hand", self._duration_s
        crew.states.to(State.MOVING)
        self._start_ns = crew.clock.now_ns()
        crew.frames.open()

    def _done_ns(self) -> int:
        return self._crew.clock.now_ns() - self._start_ns

    def _do_turn(self) -> None:
        crew = self._crew
        self._read()
        self._turn = max(self._turn + 1, int(self._done_ns() * SERVO_RATE_HZ / NS_PER_S))
        crew.clock.sleep_until_ns(self._start_ns + int(self._turn * NS_PER_S / SERVO_RATE_HZ))
        crew.check()
        crew.situation.done_s = self._done_ns() / NS_PER_S
        if self._progress is not None:
            self._progress(crew.situation.done_s, self._duration_s or crew.situation.done_s)
        held_from_ns = crew.clock.now_ns()
        if heed(crew, holds=False, read=self._read):
            self._start_ns += crew.clock.now_ns() - held_from_ns
            crew.frames.open()

    def _read(self) -> None:
        """Read the servos, or look for a bus that is away."""
        crew = self._crew
        if not crew.has_arm or self._is_away():
            crew.tell()
            return
        try:
            crew.read()
        except BusLost as lost:
            self._wait_for(lost)

    def _wait_for(self, lost: BusLost) -> None:
        """From now on wait for the bus as long as the rig says; raises `lost` where it doesn't wait."""
        patience_s = self._rig.table.safety.reconnect_s
        if patience_s <= 0:
            raise lost
        self._crew.journal.warn(f"{lost}\nwaiting {patience_s:g} s for it; frames are recorded on")
        self._lost = self._crew.clock.now_ns(), lost

    def _is_away(self) -> bool:
        """Whether the bus is still away; raises what it was lost with when the rig's patience is over."""
        if self._lost is None:
            return False
        (since_ns, lost), crew = self._lost, self._crew
        if crew.clock.now_ns() < self._look_ns:
            return True
        self._look_ns = crew.clock.now_ns() + int(RECONNECT_EVERY_S * NS_PER_S)
        try:
            self._rig.arm.connect()
        except (BusLost, NoReply):
            if crew.clock.now_ns() - since_ns > self._rig.table.safety.reconnect_s * NS_PER_S:
                raise lost from None
            return True
        self._lost = None
        crew.tally.add("reconnects")
        crew.journal.info("the bus is back")
        return False
