"""What a video showed of each marker: how often, longest gap, how oblique, how well its square fits; and warnings."""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from station.logs import FloatArray
from station.perception.markers import MarkerTable
from station.perception.observations import FrameMarkers
from station.perception.pose import viewing_angles
from station.videos.sizes import SizeCheck

# An edge that takes this many px from black to white is blurred; a sharp one takes 1.5 to 2.5.
BLURRED_PX = 4.0
# Worth a word: this share of the frames, or more.
NOTABLE_SHARE = 0.02
# Markers that aren't in the table: fewer sightings than this are taken for chance patterns.
LEAST_SIGHTINGS = 2
SHOWN_IDS = 8


@dataclass(frozen=True)
class MarkerRow:
    """One marker of the table, over the N frames of a video.

    Attributes:
        marker_id, part: of the table.
        seen: in how many frames.
        frames: N.
        gap_frames, gap_s: longest run of frames without it, the video's ends included, and how long it lasts.
        tilt_deg: median angle between its normal and the line of sight; None where it was never seen.
        rms_px: median reprojection error; None where it was never seen.
    """

    marker_id: int
    part: str
    seen: int
    frames: int
    gap_frames: int
    gap_s: float
    tilt_deg: float | None
    rms_px: float | None

    def as_dict(self) -> dict[str, object]:
        """The row as JSON."""
        return asdict(self)


@dataclass
class _Sightings:
    """Of one marker: the rows of the frames that showed it, and what was measured there. 16 bytes a sighting."""

    rows: array[int] = field(default_factory=lambda: array("l"))
    tilt_rad: array[float] = field(default_factory=lambda: array("f"))
    rms_px: array[float] = field(default_factory=lambda: array("f"))


class MarkerTally:
    """Counts markers frame by frame, in little memory however long the video is."""

    def __init__(self, table: MarkerTable) -> None:
        self._table = table
        self._t_s = array("d")
        self._sightings: dict[int, _Sightings] = defaultdict(_Sightings)
        self._strangers: Counter[int] = Counter()
        self._sizes = SizeCheck(table)
        self._blurred = 0
        self._with_markers = 0

    def add(self, t_s: float, markers: FrameMarkers, strangers: Sequence[int], width_px: FloatArray) -> None:
        """Add the next frame.

        Args:
            t_s: its time.
            markers: those of the table, with poses.
            strangers: ids that were detected and aren't in the table.
            width_px: (M, 4) widths of the edges of all that were detected; NaN where unknown.
        """
        row = len(self._t_s)
        self._t_s.append(t_s)
        self._strangers.update(strangers)
        tilts = viewing_angles(markers.T_cam_marker[:, 0])
        for n, tilt, rms in zip(markers.marker_id.tolist(), tilts, markers.rms_px[:, 0], strict=True):
            seen = self._sightings[n]
            seen.rows.append(row)
            seen.tilt_rad.append(float(tilt))
            seen.rms_px.append(float(rms))
        self._sizes.add(markers)
        if len(width_px):
            self._with_markers += 1
            self._blurred += bool(np.any(width_px >= BLURRED_PX))

    @property
    def last_ns(self) -> int:
        """Stamp of the latest frame."""
        return round(self._t_s[-1] * 1e9) if self._t_s else 0

    def rows(self) -> tuple[MarkerRow, ...]:
        """A row for each marker of the table, in its order."""
        return tuple(self._row(marker.id, marker.part) for marker in self._table.markers)

    def warnings(self) -> Iterator[str]:
        """What a person should know before trusting the result, in sentences."""
        frames = len(self._t_s)
        for row in self.rows():
            if not row.seen:
                yield f"marker {row.marker_id} ({row.part}) was never seen"
        least = max(LEAST_SIGHTINGS, round(NOTABLE_SHARE * frames))
        strangers = [f"{n} ({count} frames)" for n, count in sorted(self._strangers.items()) if count >= least]
        if strangers:
            more = f" and {len(strangers) - SHOWN_IDS} more" if len(strangers) > SHOWN_IDS else ""
            yield f"markers were seen that are not in the table: {', '.join(strangers[:SHOWN_IDS])}{more}"
        for doubt in self._sizes.doubts():
            yield str(doubt)
        if self._blurred > NOTABLE_SHARE * self._with_markers:
            yield (
                f"{self._blurred} of {self._with_markers} frames with markers are blurred (edges of {BLURRED_PX:g} px "
                "and more): move more slowly, or shorten the exposure with more light"
            )

    def _row(self, marker_id: int, part: str) -> MarkerRow:
        frames, seen = len(self._t_s), self._sightings.get(marker_id, _Sightings())
        ends = np.concatenate([[-1], np.asarray(seen.rows, dtype=np.int64), [frames]])
        gaps = np.diff(ends) - 1
        longest = int(np.argmax(gaps))
        return MarkerRow(
            marker_id=marker_id,
            part=part,
            seen=len(seen.rows),
            frames=frames,
            gap_frames=int(gaps[longest]),
            gap_s=self._lasted_s(int(ends[longest]), int(ends[longest + 1])) if gaps[longest] else 0.0,
            tilt_deg=float(np.degrees(np.median(seen.tilt_rad))) if seen.rows else None,
            rms_px=float(np.median(seen.rms_px)) if seen.rows else None,
        )

    def _lasted_s(self, before: int, after: int) -> float:
        """Time between two rows, either of which may lie just outside of the video."""
        inside = self._t_s[max(before, 0)], self._t_s[min(after, len(self._t_s) - 1)]
        return inside[1] - inside[0]
