"""Runs a planned motion on a rig into a recording: commands, read-back, frames and markers, and a declared end.

The servo loop has the thread that calls; the camera, detection and the recorder have threads of their own, with
bounded queues between them, so that nothing but the bus holds the servo loop up. On a virtual clock the same threads
take turns.
"""

from __future__ import annotations

from collections.abc import Sequence

from station.capture.control import Control, StopAsked
from station.capture.counts import CaptureCounts
from station.capture.crew import Crew
from station.capture.ending import Unbroken, end
from station.capture.leaving import leave, leave_alone
from station.capture.lengthening import Lengthening
from station.capture.live_view import LiveView
from station.capture.pausing import heed
from station.capture.recorder import SessionWriter
from station.capture.servo_loop import Progress, ServoLoop
from station.capture.snapshot import Watcher
from station.capture.states import State
from station.enough_motion import MotionTally
from station.kinematics.tree import KinematicTree
from station.motion import Plan
from station.rig import Rig


class Capture:
    """One capture: from a connected rig to a closed recording, with the arm left as the rig declares.

    Args:
        progress: is told seconds done and in all, in the servo loop's thread.
        control: what people ask of it while it runs.
        watch: is given snapshots.
        live: is shown frames while there is time for it.
        first_leg: the plan's leg to begin with, to go on in a session.
        lengthening: adds legs at the plan's end while a joint lacks motion.
        motion: what was seen of the joints' motion before, to go on in a session.
        remarks: warnings to be recorded at the start.
        tree: what the camera watches, if it is known: joint states are then estimated frame by frame.
    """

    def __init__(
        self,
        rig: Rig,
        plan: Plan,
        writer: SessionWriter,
        progress: Progress | None = None,
        *,
        control: Control | None = None,
        watch: Watcher | None = None,
        live: LiveView | None = None,
        first_leg: int = 0,
        lengthening: Lengthening | None = None,
        motion: MotionTally | None = None,
        remarks: Sequence[str] = (),
        tree: KinematicTree | None = None,
    ) -> None:
        self._plan, self._writer, self._remarks = plan, writer, tuple(remarks)
        self._crew = Crew(rig, writer, control=control, watch=watch, live=live, motion=motion, tree=tree)
        self._loop = ServoLoop(self._crew, plan, progress, first_leg, lengthening)
        self._powered = False

    def run(self) -> CaptureCounts:
        """Capture the plan to its end, or until somebody asks for a stop by `control`: then it returns all the same.

        On every exit the arm is left as `[safety] at_exit` says. The recording is then closed as "complete", or, after
        a stop or any exception, as "interrupted". A KeyboardInterrupt or SystemExit of this thread is such an
        exception; one that comes while the arm is being left is raised when that is done.

        Raises:
            StationError: the recording can't be written.
            DriverError: the bus or the camera fails, the arm doesn't arrive.
        """
        ending, finished, failure = Unbroken("end of the capture"), False, None
        try:
            finished = self._drive()
        except BaseException as error:
            failure = error
        return end(
            ending, self._crew, self._writer, failure, complete=finished, leave=lambda: self._leave(failure, finished)
        )

    def _drive(self) -> bool:
        """Whether the whole motion was made."""
        with self._crew.clock.seat():
            try:
                self._crew.start()
                self._prepare()
                self._loop.run()
                return True
            except StopAsked:
                self._crew.journal.info("stopped")
                return False
            finally:
                self._crew.frames.ask_to_end()

    def _prepare(self) -> None:
        """Check the servos and switch torque on where the arm stands."""
        crew, arm = self._crew, self._crew.rig.arm
        crew.states.to(State.CHECKING)
        arm.connect()
        crew.journal.info(f"connected: {', '.join(arm.names)}")
        for remark in (*self._plan.motion.notes, *self._remarks):
            crew.journal.warn(remark)
        heed(crew, holds=False)
        self._powered = True
        arm.torque_on()
        crew.states.to(State.MOVING)

    def _leave(self, failure: BaseException | None, finished: bool) -> None:
        if self._powered:
            leave(self._crew, self._plan.joints, self._plan.park, failure=failure, finished=finished)
        else:
            leave_alone(self._crew, "as it was found", failure)
