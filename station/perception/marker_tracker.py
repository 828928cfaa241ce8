"""Markers in a stream of images: followed from frame to frame, searched for where one is missing."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from calibration.intrinsics import CameraModel
from station.perception.corners import Detections, Image, IntArray, MarkerDetector, RoughMarkers, as_grey

# A search at one window of the threshold is made at least this often, for markers that have come into view; and in each
# frame that has lost a marker seen within the last RECENT_FRAMES.
SEARCH_EVERY_FRAMES = 10
RECENT_FRAMES = 30
# The full search is made where an expected or recent marker is missing, but not more often than this; and at least this
# often, for markers that nobody expects and only the full search finds.
FULL_EVERY_FRAMES = 10
FULL_AT_LEAST_EVERY_FRAMES = 60


class MarkerTracker:
    """Finds the markers of one dictionary in frames that follow each other.

    A marker is first looked for where its last two sightings let it be expected, and named by its bits there; only
    where that fails is the image searched. What the detector's full search would find is missed for no more than
    FULL_EVERY_FRAMES - 1 frames in succession if the marker is expected or was seen within RECENT_FRAMES, and
    FULL_AT_LEAST_EVERY_FRAMES - 1 otherwise. A second marker with an id that is being followed is noticed, and the id
    dropped, with the next search. The same frames give the same markers. One stream each; not for two threads at once.

    Args:
        dictionary: such as "DICT_4X4_50".
        camera: whose lens bends edges; None = not known.
        expected: ids that should be seen; None = those seen so far.

    Raises:
        InvalidData: if OpenCV has no dictionary of that name.
    """

    def __init__(
        self, dictionary: str, camera: CameraModel | None = None, expected: Collection[int] | None = None
    ) -> None:
        self._detector = MarkerDetector(dictionary, camera)
        self._expected = frozenset(expected or ())
        self._last: tuple[RoughMarkers, RoughMarkers] = (_none(), _none())
        self._seen_in: dict[int, int] = {}
        self._frame = 0
        self._searched_in = self._searched_fully_in = -FULL_AT_LEAST_EVERY_FRAMES

    def detect(self, image: Image) -> Detections:
        """The markers in the stream's next image, 8-bit grey (H, W) or BGR (H, W, 3)."""
        grey = as_grey(image)
        found = self._detector.follow(grey, self._predicted())
        if self._search_is_due(found):
            self._searched_in = self._frame
            found = self._detector.refine(grey, self._detector.search(grey).joined(_rough(found)))
        if self._full_search_is_due(found):
            self._searched_in = self._searched_fully_in = self._frame
            found = self._detector.refine(grey, self._detector.search_fully(grey).joined(_rough(found)))
        self._remember(found)
        return found

    def _predicted(self) -> RoughMarkers:
        """Where the last frame's markers would be now: moved on as they moved from the frame before."""
        before, last = self._last
        moved_px = np.zeros(last.corners_px.shape)
        again, rows, rows_before = np.intersect1d(last.ids, before.ids, assume_unique=True, return_indices=True)
        if len(again):
            moved_px[rows] = last.corners_px[rows] - before.corners_px[rows_before]
        return RoughMarkers(last.ids, last.corners_px + moved_px)

    def _search_is_due(self, found: Detections) -> bool:
        if self._frame - self._searched_in >= SEARCH_EVERY_FRAMES:
            return True
        return bool(self._recent() - set(found.ids.tolist()))

    def _full_search_is_due(self, found: Detections) -> bool:
        since = self._frame - self._searched_fully_in
        missing = (self._recent() | self._expected) - set(found.ids.tolist())
        return since >= FULL_AT_LEAST_EVERY_FRAMES or (bool(missing) and since >= FULL_EVERY_FRAMES)

    def _recent(self) -> set[int]:
        return {marker for marker, frame in self._seen_in.items() if self._frame - frame <= RECENT_FRAMES}

    def _remember(self, found: Detections) -> None:
        self._last = (self._last[1], _rough(found))
        self._seen_in.update(dict.fromkeys(found.ids.tolist(), self._frame))
        self._frame += 1


def _none() -> RoughMarkers:
    ids: IntArray = np.zeros(0, dtype=np.int64)
    return RoughMarkers(ids, np.zeros((0, 4, 2)))


def _rough(found: Detections) -> RoughMarkers:
    return RoughMarkers(found.ids, found.corners_px)
