"""What the parts of one capture share: the rig, its state, its wishes, the recorder, the frames, who watches."""

from __future__ import annotations

import json

from drivers.arm import ArmReading
from drivers.camera import Frame
from station.capture.control import Control
from station.capture.counts import CaptureCounts, Tally
from station.capture.frame_line import FrameLine
from station.capture.journal import Journal
from station.capture.live_states import Beside, LiveStates
from station.capture.live_view import LiveDetected, LiveReading, LiveView
from station.capture.recorder import Recorder, SessionWriter
from station.capture.snapshot import Watcher
from station.capture.states import State, StateMachine
from station.capture.watching import Situation, Watching
from station.enough_motion import MotionTally, sides_of
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray
from station.perception.observations import FrameMarkers
from station.rig import Rig

NS_PER_S = 1_000_000_000
SERVO_RATE_HZ = 50.0
TURN_NS = round(NS_PER_S / SERVO_RATE_HZ)
# Temperatures and voltages change slowly.
SERVO_STATES_EVERY_NS = NS_PER_S // 2
# Motion is counted so often, with the parts that were seen within so long before.
MOTION_EVERY_NS = NS_PER_S // 10


class Crew:
    """The parts of one capture, made for it and ended with it.

    Args:
        tree: what the camera watches: joint states are then estimated frame by frame.

    Attributes:
        situation: what the servo loop knows at the moment.
        leaving: whether the arm is being left: who watches can't break that off any more.
    """

    def __init__(
        self,
        rig: Rig,
        writer: SessionWriter,
        *,
        control: Control | None = None,
        watch: Watcher | None = None,
        live: LiveView | None = None,
        motion: MotionTally | None = None,
        tree: KinematicTree | None = None,
    ) -> None:
        self.rig, self.clock, self.has_arm = rig, rig.clock, bool(rig.table.joint)
        self.control = control or Control()
        self.tally, self.situation = Tally(), Situation()
        self.motion = motion or MotionTally(rig.table.limits(), sides_of(rig.table))
        self.recorder = Recorder(writer, self.tally, waits=rig.virtual)
        self.journal = Journal(rig.clock, self.recorder, live)
        self.frames = FrameLine(rig, self._found, self.journal, self.tally, live)
        self._live_states: LiveStates | None = None
        if tree is not None:
            self._live_states = LiveStates(rig, tree, self._seen, self.journal.warn, self.tally)
            columns = len(self._live_states.columns.names)
            self._beside = Beside(columns, len(rig.table.joint), rig.table.camera.latency_s)
        self.states = StateMachine(self._entered)
        self.leaving = False
        self._live = live
        self._servos_ns: int | None = None
        self._motion_ns: int | None = None
        self._watching = Watching(rig.table, rig.clock.now_ns(), watch)

    def start(self) -> None:
        """Let the threads begin; from a thread that has its turn."""
        self.recorder.start()
        if self._live_states is not None:
            self._live_states.start()
        self.frames.start()
        self.journal.info(f"camera: {json.dumps(dict(self.rig.camera.settings))}")

    def check(self) -> None:
        """Raise what went wrong in one of the threads, if anything did."""
        self.recorder.check()
        self.frames.check()

    def read(self) -> ArmReading:
        """Read the arm, show it to who watches; recorded, beside the command that stands, where frames are.

        What the servos say of themselves is recorded throughout.
        """
        reading = self.rig.arm.read()
        self.situation.reading = reading
        if self._servos_ns is None or reading.t_ns - self._servos_ns >= SERVO_STATES_EVERY_NS:
            self._servos_ns = reading.t_ns
            self.recorder.servos(reading)
        if self.frames.is_open:
            if self.situation.goal is not None:
                self.recorder.command(reading.t_request_ns, self.situation.goal)
            self.recorder.reading(reading)
            self.tally.add("readings")
            self._count_motion(reading)
        if self._live_states is not None:
            self._beside.read(reading.t_ns, reading.q)
        if self._live is not None:
            self._live.offer(LiveReading(reading.t_ns, reading.q, self.situation.goal))
        self.tell()
        return reading

    def end_states(self) -> None:
        """Wait until the joint states of all frames are estimated; no frame may come after."""
        if self._live_states is not None:
            self._live_states.end()

    def _found(self, frame: Frame, markers: FrameMarkers) -> None:
        """A frame's markers, in detection's thread."""
        self.recorder.frame(frame, markers)
        if self._live_states is not None:
            self._live_states.offer(frame.t_ns, markers)

    def _seen(self, t_ns: int, q: FloatArray, std: FloatArray) -> None:
        """A frame's joint states, in the thread that estimates them."""
        if self._live_states is None:
            return
        columns, shown = self._live_states.columns, self._beside.shown(t_ns, q)
        self.recorder.live_states(t_ns, q, std, columns)
        self.situation.detected_units = dict(zip(columns.names, columns.units, strict=True))
        self.situation.detected = dict(zip(columns.names, shown.tolist(), strict=True))
        if self._live is not None:
            self._live.offer(LiveDetected(t_ns, shown))

    def _count_motion(self, reading: ArmReading) -> None:
        if self._motion_ns is None or reading.t_ns - self._motion_ns >= MOTION_EVERY_NS:
            self._motion_ns = reading.t_ns
            seen_ns = self.frames.detection.seen_ns
            self.motion.add(reading.q, {part for part, t in seen_ns.items() if reading.t_ns - t <= MOTION_EVERY_NS})
            self.situation.motion_shares = self.motion.shares()

    def tell(self) -> None:
        """Show the capture to who watches, if it is time."""
        if self._watching.is_due(self.clock.now_ns()):
            self._tell()

    def counts(self) -> CaptureCounts:
        """What was counted so far."""
        dropped, stale = self.frames.lost_since_open
        return self.tally.counts(
            dropped_by_camera=dropped,
            stale_frames=stale,
            bus_errors=sum(self.rig.arm.bus_errors.values()) if self.has_arm else 0,
            live_view_shed=0 if self._live is None else sum(self._live.shed.values()),
        )

    def tell_shed(self) -> None:
        """Tell how much the live view left out, and why."""
        if self._live is not None and (shed := self._live.shed):
            reasons = ", ".join(f"{count} ({reason})" for reason, count in shed.items())
            self.journal.info(f"not shown in the live view: {reasons}")

    def checkpoint(self, leg: int, legs: int, motion: str | None = None) -> None:
        """A leg of the plan begins: once the frames before it are recorded, all before it is safe from a kill.

        Args:
            motion: the session's motion.toml from now on, where the plan was lengthened.
        """
        self.frames.detection.afterwards(lambda: self.recorder.checkpoint(leg, legs, self.counts(), motion))

    def _entered(self, state: State) -> None:
        self.journal.info(f"state: {state}")
        self._tell()

    def _tell(self) -> None:
        try:
            self._watching.tell(
                self.clock.now_ns(),
                self.states.state,
                self.situation,
                self.counts(),
                dict(self.frames.detection.seen_ns),
                self.journal.said,
            )
        except Exception as error:
            if not self.leaving:
                raise
            self.journal.error(error, "who watches")
