"""When a frame was taken: the driver's own stamp where it can be believed, else the arrival; and what got lost."""

from __future__ import annotations

from collections import deque
from statistics import median

from drivers.camera import Stamp

NS_PER_US = 1_000
# A driver's stamp is believed if it is no later than the arrival and no more than this before it.
OLDEST_NS = 1_000_000_000
# Intervals that tell the camera's period; fewer than the least of them tell nothing.
INTERVALS = 9
LEAST_INTERVALS = 5
# Of the period. An interval longer than this had a frame in it that never came.
GAP = 1.5


def choose_stamp(driver_ms: float, arrived_ns: int) -> tuple[int, Stamp]:
    """The driver's stamp if it is consistent with the arrival on the monotonic clock, else the arrival.

    OpenCV hands v4l2_buffer.timestamp through as CAP_PROP_POS_MSEC, in ms with microseconds behind the point, but not
    the flags that tell its clock (modules/videoio/src/cap_v4l.cpp, read_frame_v4l2 and getProperty). uvcvideo and
    most drivers stamp with CLOCK_MONOTONIC (V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC); a stamp of another clock is far off.
    """
    driver_ns = round(driver_ms * 1e3) * NS_PER_US
    if driver_ms > 0 and 0 <= arrived_ns - driver_ns <= OLDEST_NS:
        return driver_ns, "driver"
    return arrived_ns, "arrival"


class Gaps:
    """Tells from the driver's stamps how many frames are missing between two.

    The period is the median of the last intervals, so that a camera that lowers its rate in dim light is believed
    after a few frames; those few are counted as gaps.
    """

    def __init__(self) -> None:
        self._intervals_ns: deque[int] = deque(maxlen=INTERVALS)
        self._last_ns: int | None = None

    def missing_before(self, t_ns: int) -> int:
        """Frames missing between the frame told before and this one."""
        last_ns, self._last_ns = self._last_ns, t_ns
        if last_ns is None:
            return 0
        interval_ns = t_ns - last_ns
        known = len(self._intervals_ns) >= LEAST_INTERVALS
        period_ns = median(self._intervals_ns) if known else interval_ns
        self._intervals_ns.append(interval_ns)
        return round(interval_ns / period_ns) - 1 if interval_ns > GAP * period_ns > 0 else 0
