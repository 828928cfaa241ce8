"""Clocks: monotonic nanoseconds, real or virtual, that are handed to everything that waits or stamps."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Monotonic time in nanoseconds."""

    def now_ns(self) -> int:
        """Time since an arbitrary start."""
        ...

    def sleep_until_ns(self, t_ns: int) -> None:
        """Return when `now_ns() >= t_ns`; at once if that has passed."""
        ...


class MonotonicClock:
    """The machine's monotonic clock, which no clock adjustment moves."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until_ns(self, t_ns: int) -> None:
        while (wait_ns := t_ns - time.monotonic_ns()) > 0:
            time.sleep(wait_ns * 1e-9)


class VirtualClock:
    """A clock that stands still but for those who sleep on it: the same run on any machine, however slow.

    Sleeping moves the time forward and returns at once. Safe to use from several threads; the order of events is
    determined as long as only one of them is at work at a time.
    """

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns
        self._lock = threading.Lock()

    def now_ns(self) -> int:
        with self._lock:
            return self._now_ns

    def sleep_until_ns(self, t_ns: int) -> None:
        with self._lock:
            self._now_ns = max(self._now_ns, t_ns)
