"""Joint states by a known tree from the corners of a capture's frames, in a thread of its own.

Nothing waits for it: a frame that comes while another one is under way is left out, and counted. What goes wrong in it
is said once; the capture goes on without.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import cast

import numpy as np

from station.capture.counts import Tally
from station.capture.worker import Worker
from station.fit.image.camera_numbers import CameraNumbers
from station.fit.image.live import StateFollower
from station.kinematics.tree import KinematicTree
from station.logs import FloatArray
from station.perception.observations import FrameMarkers
from station.rig import Rig
from station.seen_columns import seen_columns
from station.tracking import views_of_frame

NS_PER_S = 1_000_000_000
MOVING = "moving"
# Two seconds of them: frames are some tenths of a second old when their states are known.
READINGS_KEPT = 100


class LiveStates:
    """Estimates states frame by frame.

    Args:
        rig: whose camera sees the markers.
        tree: of what they are on, as a fit found it or as it was drawn.
        told: is given the stamp of each frame, its states and their deviations (C,), as `columns` says, in the thread.
        say: is told why no more states come, once.
        tally: counts frames that are left out.

    Attributes:
        columns: of the states.

    Raises:
        InvalidData: none of the rig's markers is on the tree.
    """

    def __init__(
        self,
        rig: Rig,
        tree: KinematicTree,
        told: Callable[[int, FloatArray, FloatArray], None],
        say: Callable[[str], None],
        tally: Tally,
    ) -> None:
        self.columns = seen_columns(rig.table, tree)
        self._rig, self._told, self._say, self._tally = rig, told, say, tally
        still = tree.method.get("root") != MOVING
        numbers = camera_numbers(tree, rig.camera_model.readout_s or 0.0)
        self._follower = StateFollower(tree, rig.markers.parts, numbers, still=still)
        self._start_ns = rig.clock.now_ns()
        self._failed = False
        self._worker: Worker[Callable[[], None]] = Worker(
            "live states", lambda work: work(), {"frame": 1}, waits=rig.virtual
        )
        self.start, self.end = self._worker.start, self._worker.end

    def offer(self, t_ns: int, markers: FrameMarkers) -> None:
        """Estimate the states in a frame, if there is time."""
        if not self._failed and not self._worker.offer("frame", lambda: self._estimate(t_ns, markers)):
            self._tally.add("states_left_out")

    def _estimate(self, t_ns: int, markers: FrameMarkers) -> None:
        try:
            t_s = (t_ns - self._start_ns) / NS_PER_S
            views = views_of_frame(t_s, markers, self._rig.markers, self._rig.camera_model)
            seen = self._follower.follow(views)
            self._told(t_ns, self.columns.ordered(seen.q), self.columns.ordered(seen.std))
        except Exception as error:  # what is only looked at must not end the capture
            self._failed = True
            self._say(f"joint states are no longer estimated: {str(error) or type(error).__name__}")


def camera_numbers(tree: KinematicTree, readout_s: float) -> CameraNumbers | None:
    """The shift of edges that a tree was fitted with, with a readout; None where its file tells none.

    A factor of focal lengths isn't taken: it was of the calibration that there was then.
    """
    camera = tree.method.get("camera")
    shift = cast(Mapping[str, object], camera).get("edge_shift_px") if isinstance(camera, Mapping) else None
    value = cast(Mapping[str, object], shift).get("value") if isinstance(shift, Mapping) else None
    return CameraNumbers(edge_shift_px=float(value), readout_s=readout_s) if isinstance(value, float) else None


class Beside:
    """Puts detected states beside what the servos say: with the constant that the two differ by, as their zeros do.

    The constant of each joint is the mean of all differences so far.

    Args:
        columns: of the detected states: those of the arm's joints, then others, which stay as they are.
        joints: how many the arm has.
        latency_s: by which a frame's stamp is later than its exposure.
    """

    def __init__(self, columns: int, joints: int, latency_s: float) -> None:
        self._joints = joints
        self._latency_ns = round(latency_s * NS_PER_S)
        self._readings: tuple[tuple[int, FloatArray], ...] = ()
        self._sum, self._count = np.zeros(columns), np.zeros(columns)

    def read(self, t_ns: int, q: FloatArray) -> None:
        """What the servos said (J,); from any one thread."""
        self._readings = (*self._readings[-READINGS_KEPT:], (t_ns, q))

    def shown(self, t_ns: int, q: FloatArray) -> FloatArray:
        """(C,) states that were detected in a frame, told from the arm's zeros; from any other one thread."""
        if readings := self._readings:
            since_ns = np.array([t - t_ns + self._latency_ns for t, _ in readings], dtype=np.float64)
            said = np.array([np.interp(0.0, since_ns, [q[j] for _, q in readings]) for j in range(self._joints)])
            off = said - q[: self._joints]
            known = np.flatnonzero(np.isfinite(off))
            self._sum[known] += off[known]
            self._count[known] += 1
        return q + self._sum / np.maximum(self._count, 1)
