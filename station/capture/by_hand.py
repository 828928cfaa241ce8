"""Records an arm, or any marked object, that people move by hand: torque off, read-back and frames, no commands."""

from __future__ import annotations

import json

from station.capture.counts import CaptureCounts
from station.capture.frame_worker import FrameWorker
from station.capture.service import NS_PER_S, SERVO_RATE_HZ, Progress
from station.recording import RecordingWriter
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

    Args:
        duration_s: how long to record; until a KeyboardInterrupt if None, which is a normal end in either case.
    """

    def __init__(
        self,
        rig: Rig,
        writer: RecordingWriter,
        *,
        duration_s: float | None = None,
        progress: Progress | None = None,
    ) -> None:
        self._rig, self._writer = rig, writer
        self._duration_s, self._progress = duration_s, progress
        self._readings = self._dropped_before = 0
        self._has_arm = bool(rig.table.joint)

    def run(self) -> CaptureCounts:
        """Record until the end.

        Raises:
            StationError: the recording can't be written.
            DriverError: the bus or the camera fails; the recording is then closed as "interrupted".
        """
        worker = FrameWorker(self._rig, self._writer)
        state = "interrupted"
        try:
            if self._has_arm:
                self._event("INFO", f"moved by hand, torque off: {', '.join(self._rig.arm.names)}")
            self._event("INFO", f"camera: {json.dumps(dict(self._rig.camera.settings))}")
            with worker:
                self._look_on(worker)
            state = "complete"
        except BaseException as error:
            self._event("ERROR", str(error) or type(error).__name__)
            raise
        finally:
            self._writer.close(state, self._counts(worker).as_dict())
        return self._counts(worker)

    def _look_on(self, worker: FrameWorker) -> None:
        clock, camera = self._rig.clock, self._rig.camera
        while camera.read(clock.now_ns()) is not None:
            pass  # frames from before
        self._dropped_before = camera.dropped
        start_ns, turn = clock.now_ns(), 0
        try:
            while self._duration_s is None or clock.now_ns() - start_ns < self._duration_s * NS_PER_S:
                if self._has_arm:
                    self._read()
                turn = max(turn + 1, int((clock.now_ns() - start_ns) * SERVO_RATE_HZ / NS_PER_S))
                next_ns = start_ns + int(turn * NS_PER_S / SERVO_RATE_HZ)
                while (frame := camera.read(next_ns)) is not None:
                    worker.put(frame)
                if self._progress is not None:
                    done_s = (clock.now_ns() - start_ns) / NS_PER_S
                    self._progress(done_s, self._duration_s or done_s)
        except KeyboardInterrupt:
            self._event("INFO", "stopped")

    def _read(self) -> None:
        reading = self._rig.arm.read()
        self._writer.log_reading(reading.t_request_ns, reading.t_reply_ns, reading.q, reading.t_joint_ns)
        self._readings += 1

    def _counts(self, worker: FrameWorker) -> CaptureCounts:
        return CaptureCounts(
            frames=worker.recorded,
            dropped_frames=worker.dropped + self._rig.camera.dropped - self._dropped_before,
            stale_frames=self._rig.camera.stale,
            commands=0,
            readings=self._readings,
            bus_errors=sum(self._rig.arm.bus_errors.values()) if self._has_arm else 0,
        )

    def _event(self, level: str, text: str) -> None:
        self._writer.log_event(self._rig.clock.now_ns(), level, text)
