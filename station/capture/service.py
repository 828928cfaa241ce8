"""Runs a planned motion on a rig into a recording: commands, read-back, frames and markers, and a declared end.

The servo loop runs in the calling thread; frames are detected, encoded and recorded in a thread of their own, in order.
On a virtual clock the loop waits for that thread (nothing is dropped); on a real one a full queue drops the frame and
counts it.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from drivers.errors import ArmFault, BusLost, DriverError, NoReply
from station.capture.counts import CaptureCounts
from station.capture.frame_worker import FrameWorker
from station.logs import FloatArray
from station.motion import Plan
from station.recording import RecordingWriter
from station.rig import Rig

NS_PER_S = 1_000_000_000
SERVO_RATE_HZ = 50.0
# Approaching the start and parking: no faster than this (rad/s, m/s), so that a person can step back.
APPROACH_SPEED = {"rad": np.radians(20.0), "m": 0.02}
# A joint within this (rad, m) of its goal has arrived; servos hold to a count or two (0.3 deg each on AX).
ARRIVED = {"rad": np.radians(2.0), "m": 0.002}
# Position control without an integral lets a loaded joint stand off its goal (a count is some 0.7 % of an X servo's
# output): one that has come this near (rad, m) and then moves by less than a share of ARRIVED for so long is there.
SAGGING = {"rad": np.radians(8.0), "m": 0.008}
STILL_SHARE, STILL_S = 0.2, 0.5
# An approach may take this many times as long as at constant speed, plus the extra seconds, before it counts as stuck.
PATIENCE = 1.5
PATIENCE_S = 3.0
# A bus that was lost is looked for this often.
RECONNECT_EVERY_S = 0.2

Progress = Callable[[float, float], None]


class Capture:
    """One capture: from a connected rig to a closed recording, with the arm left as the rig declares."""

    def __init__(self, rig: Rig, plan: Plan, writer: RecordingWriter, progress: Progress | None = None) -> None:
        self._rig = rig
        self._plan = plan
        self._writer = writer
        self._progress = progress
        self._standing: FloatArray = plan.park
        self._commands = 0
        self._readings = 0
        self._powered = False
        self._segment = -1

    def run(self) -> CaptureCounts:
        """Capture the whole plan.

        Raises:
            StationError: the arm doesn't arrive, the recording can't be written.
            DriverError: the bus or the camera fails. On every exit the arm is left as `[safety] at_exit` says, and the
                recording is closed as "complete" or, after any exception, "interrupted".
        """
        worker = FrameWorker(self._rig, self._writer)
        state = "interrupted"
        try:
            self._move(worker)
            self._leave()
            state = "complete"
        finally:
            self._writer.close(state, self._counts(worker).as_dict())
        return self._counts(worker)

    def _move(self, worker: FrameWorker) -> None:
        """The motion; after a failure the arm is left as declared before the failure goes on."""
        try:
            self._prepare()
            with worker:
                self._follow(worker)
        except BaseException as error:
            self._event("ERROR", str(error) or type(error).__name__)
            with suppress(DriverError):  # it is in the log; the first error is the one to tell
                self._halt()
            with suppress(DriverError):
                self._leave()
            raise

    def _counts(self, worker: FrameWorker) -> CaptureCounts:
        return CaptureCounts(
            frames=worker.recorded,
            dropped_frames=worker.dropped + self._rig.camera.dropped,
            stale_frames=self._rig.camera.stale,
            commands=self._commands,
            readings=self._readings,
            bus_errors=sum(self._rig.arm.bus_errors.values()),
        )

    def _event(self, level: str, text: str) -> None:
        self._writer.log_event(self._rig.clock.now_ns(), level, text)

    def _prepare(self) -> None:
        """Check the servos, switch torque on where the arm stands, and go to the park pose."""
        self._rig.arm.connect()
        self._event("INFO", f"connected: {', '.join(self._rig.arm.names)}")
        self._event("INFO", f"camera: {json.dumps(dict(self._rig.camera.settings))}")
        self._powered = True
        self._rig.arm.torque_on()
        self._approach(self._plan.park)

    def _approach(self, goal: FloatArray, most: FloatArray | None = None) -> None:
        """Go to a pose slowly, no faster than `most` (J,), and wait until the arm is there."""
        arm, clock = self._rig.arm, self._rig.clock
        speeds = np.array([min(joint.max_speed, APPROACH_SPEED[joint.unit]) for joint in self._plan.joints])
        speeds = speeds if most is None else np.minimum(speeds, most)
        arm.set_speeds(speeds)
        distance = np.abs(arm.read().q - goal)
        arm.command(goal)
        deadline = clock.now_ns() + int(NS_PER_S * (PATIENCE_S + PATIENCE * float(np.max(distance / speeds))))
        units = [joint.unit for joint in self._plan.joints]
        near, sagging = (np.array([least[unit] for unit in units]) for least in (ARRIVED, SAGGING))
        still_from_ns, still_at = clock.now_ns(), arm.read().q
        while np.any(np.abs((q := arm.read().q) - goal) > near):
            worst = int(np.argmax(np.abs(q - goal) / near))
            where = f"{arm.names[worst]} is {self._plan.joints[worst].text(q[worst] - goal[worst])} from its goal"
            if np.any(np.abs(q - still_at) > STILL_SHARE * near):
                still_from_ns, still_at = clock.now_ns(), q
            if clock.now_ns() - still_from_ns > STILL_S * NS_PER_S and np.all(np.abs(q - goal) <= sagging):
                self._event("WARN", f"{where}, and stays there: it sags under its load, or something holds it")
                return
            if clock.now_ns() > deadline:
                raise ArmFault(f"{where} and does not get there; is it blocked?", joint=arm.names[worst])
            clock.sleep_until_ns(clock.now_ns() + int(NS_PER_S / SERVO_RATE_HZ))

    def _follow(self, worker: FrameWorker) -> None:
        """The servo loop: send what is due, read back, take the frames that arrive before the next turn."""
        clock, plan = self._rig.clock, self._plan
        while self._rig.camera.read(clock.now_ns()) is not None:
            pass  # frames from before the motion
        start_ns = clock.now_ns()
        times_s = plan.command_times_s()
        due_ns = np.round(times_s * NS_PER_S).astype(np.int64)
        goals, segments = plan.commanded(times_s), plan.segment_index(times_s)
        self._event("INFO", f"motion '{plan.motion.name}' starts: {plan.duration_s:.1f} s")
        sent, turn, end_ns = 0, 0, int(plan.duration_s * NS_PER_S)
        while (now_ns := clock.now_ns() - start_ns) < end_ns:
            due = int(np.searchsorted(due_ns, now_ns, side="right"))
            try:
                if due > sent:  # of several that are due only the latest still counts
                    self._send(goals[due - 1], int(segments[due - 1]))
                    sent = due
                self._read()
            except BusLost as lost:
                start_ns += self._regain(lost)
                continue
            turn = max(turn + 1, int((clock.now_ns() - start_ns) * SERVO_RATE_HZ / NS_PER_S))
            next_ns = start_ns + int(turn * NS_PER_S / SERVO_RATE_HZ)
            while (frame := self._rig.camera.read(next_ns)) is not None:
                worker.put(frame)
            if self._progress is not None:
                self._progress(min((clock.now_ns() - start_ns) / NS_PER_S, plan.duration_s), plan.duration_s)
        self._event("INFO", "motion done")

    def _regain(self, lost: BusLost) -> int:
        """Wait for a lost bus as long as the rig says, go back to where the arm was to be; returns the ns it took.

        Raises `lost` where the rig doesn't wait or the bus doesn't come back; what the arm raises when it is back.
        """
        arm, clock, patience_s = self._rig.arm, self._rig.clock, self._rig.table.safety.reconnect_s
        lost_ns = clock.now_ns()
        if patience_s <= 0:
            raise lost
        self._event("WARN", f"{lost}\nwaiting {patience_s:g} s for it")
        while True:
            try:
                arm.connect()
                self._powered = True
                arm.torque_on()
                self._approach(self._standing, self._speeds(max(0, self._segment)))
                break
            except (BusLost, NoReply):
                if clock.now_ns() - lost_ns > patience_s * NS_PER_S:
                    raise lost from None
                clock.sleep_until_ns(clock.now_ns() + int(RECONNECT_EVERY_S * NS_PER_S))
        self._segment = -1  # the next command sets its speeds again
        gone_ns = clock.now_ns() - lost_ns
        self._event("INFO", f"the bus is back; the motion goes on, {gone_ns / NS_PER_S:.1f} s later than planned")
        return gone_ns

    def _send(self, goal: FloatArray, segment: int) -> None:
        """Command a goal; where a segment begins, with its speeds."""
        if segment != self._segment:
            self._segment = segment
            self._rig.arm.set_speeds(self._speeds(segment))
            self._event("INFO", f"step {self._plan.segments[segment].step}")
        self._rig.arm.command(goal)
        self._standing = goal
        self._commands += 1

    def _speeds(self, segment: int) -> FloatArray:
        """The servos' own speed limits: the step's, which shapes a step; the joints' greatest, to follow a stream."""
        if self._plan.motion.mode == "step":
            return self._plan.segments[segment].speed
        return np.array([joint.max_speed for joint in self._plan.joints])

    def _read(self) -> None:
        """Read the joints back and record them beside the command that stands."""
        reading = self._rig.arm.read()
        self._writer.log_command(reading.t_request_ns, self._standing)
        self._writer.log_reading(reading.t_request_ns, reading.t_reply_ns, reading.q, reading.t_joint_ns)
        self._readings += 1

    def _halt(self) -> None:
        """After a failure: stay where the arm is before anything else, so that it doesn't run on to its last goal."""
        if self._powered and self._rig.table.safety.at_exit != "release":
            self._rig.arm.stop()

    def _leave(self) -> None:
        """Leave the arm as the rig declares: each step is tried, the first failure is raised when all have been."""
        at_exit = self._rig.table.safety.at_exit
        failures: list[DriverError] = []
        steps: list[Callable[[], None]] = []
        if at_exit == "park-then-release":
            steps.append(lambda: self._approach(self._plan.park))
        steps.append(self._rig.arm.leave_holding if at_exit == "hold" else self._rig.arm.torque_off)
        for step in steps if self._powered else ():
            try:
                step()
            except DriverError as error:
                failures.append(error)
                self._event("ERROR", f"leaving the arm: {error}")
        if failures:
            raise failures[0]
        self._event("INFO", f"arm left: {at_exit if self._powered else 'as it was found'}")
