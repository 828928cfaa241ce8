"""Detects the markers of a capture's frames in a thread of its own, and hands both on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from drivers.camera import Frame
from station.capture.counts import Tally
from station.capture.live_view import LiveFrame, LiveView
from station.capture.worker import Worker
from station.perception.marker_tracker import MarkerTracker
from station.perception.observations import MARKER_SHAPES, FrameMarkers
from station.rig import Rig
from station.tracking import observe

# A quarter of a second at 30 frames/s: what waits is lost to a kill.
FRAMES_WAITING = 8
# One that has waited for so long is dropped on a real clock: the machine can't keep up, and newer ones wait behind it.
OLDEST_NS = 250_000_000
# The live view gets a frame only while fewer of the places are taken.
LIVE_UP_TO = 0.5
_NONE = {name: np.zeros((0, *shape)) for name, shape in MARKER_SHAPES.items() if name != "marker_id"}
NO_MARKERS = FrameMarkers(np.zeros(0, dtype=np.int64), **_NONE)


Found = Callable[[Frame, FrameMarkers], None]


class Detection:
    """Finds the markers of frames, one frame after another.

    An exception in it ends the capture: frames of which nobody knows what is in them are of no use to a fit.

    Args:
        found: gets each frame with its markers, in the thread.
        live: shown what there is time for.
        waits: on a virtual clock: no frame is dropped, whoever hands one over waits.
    """

    def __init__(
        self,
        rig: Rig,
        found: Found,
        tally: Tally,
        live: LiveView | None,
        *,
        waits: bool,
    ) -> None:
        self._rig, self._found, self._tally, self._live = rig, found, tally, live
        ids = [marker.id for marker in rig.markers.markers]
        self._part_of = {marker.id: marker.part for marker in rig.markers.markers}
        self._tracker = MarkerTracker(rig.markers.dictionary, rig.camera_model, ids)
        self._worker: Worker[Callable[[], None]] = Worker(
            "detection", lambda work: work(), {"frame": FRAMES_WAITING}, waits=waits
        )
        self.start, self.check, self.end = self._worker.start, self._worker.check, self._worker.end
        self._seen_ns: dict[str, int] = {}

    @property
    def seen_ns(self) -> Mapping[str, int]:
        """When each part was last seen; those that never were are missing."""
        return MappingProxyType(dict(self._seen_ns))

    def offer(self, frame: Frame) -> None:
        """Detect a frame's markers; drops and counts it where there is no place left."""
        if not self._worker.offer("frame", lambda: self._detect(frame)):
            self._tally.add("dropped_by_detection")

    def show(self, frame: Frame) -> None:
        """Only show a frame, if there is time; nobody looks for its markers."""
        if self._live is not None:
            self._show(frame, NO_MARKERS)

    def afterwards(self, work: Callable[[], None]) -> None:
        """Do something in the thread once all frames so far are done."""
        self._worker.give("then", work)

    def _detect(self, frame: Frame) -> None:
        if not self._worker.waits and self._rig.clock.now_ns() - _arrival_ns(frame) > OLDEST_NS:
            self._tally.add("dropped_by_detection")
            return
        detections = self._tracker.detect(frame.image)
        markers = observe(detections, self._rig.markers, self._rig.camera_model)
        self._found(frame, markers)
        self._seen_ns.update({self._part_of[n]: frame.t_ns for n in markers.marker_id.tolist()})
        self._show(frame, markers)

    def _show(self, frame: Frame, markers: FrameMarkers) -> None:
        if self._live is None:
            return
        if self._worker.fullness("frame") > LIVE_UP_TO:
            self._tally.add("live_view_shed")
        else:
            self._live.offer(LiveFrame(frame.index, frame.t_ns, frame.image, markers))


def _arrival_ns(frame: Frame) -> int:
    return frame.t_ns if frame.arrived_ns is None else frame.arrived_ns
