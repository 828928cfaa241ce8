"""The live view's queue: takes what a capture offers, without ever waiting, and shows what there is time for.

The recording doesn't depend on it: a viewer that is slow or dead costs the capture nothing but the offers, and what
isn't shown is counted by reason.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from station.logs import FloatArray
from station.perception.observations import FrameMarkers

# What waits is shown once in this time of the wall clock, s: a person sees no more, and each frame costs a JPEG.
PERIOD_S = 1 / 15
# What waits to be shown, at most: the newest frame; readings and events of some seconds.
WAITING = 250
# At the end what waits is still shown, but for no longer than this, s.
CLOSE_S = 2.0
# Why something wasn't shown.
RATE, BEHIND, FAILED, CLOSED = "over the view's rate", "view behind", "view failed", "view closed"


@dataclass(frozen=True, eq=False, slots=True)
class LiveFrame:
    """A frame and its markers; the image (H, W, 3) BGR or (H, W) grey is only read."""

    index: int
    t_ns: int
    image: NDArray[np.uint8]
    markers: FrameMarkers


@dataclass(frozen=True, eq=False, slots=True)
class LiveReading:
    """The joints (J,) that were read, and what they were told; None where torque is off."""

    t_ns: int
    q: FloatArray
    goal: FloatArray | None


@dataclass(frozen=True, slots=True)
class LiveEvent:
    """Something that happened, as in the recording's log."""

    t_ns: int
    level: str
    text: str


@dataclass(frozen=True, eq=False, slots=True)
class LiveDetected:
    """The joint states (C,) that were detected in a frame, by the tree that is known; NaN unseen."""

    t_ns: int
    q: FloatArray


Offer = LiveFrame | LiveReading | LiveEvent | LiveDetected


class LiveView(Protocol):
    """What a capture knows of a live view; both may be used from any thread."""

    def offer(self, item: Offer) -> None:
        """Show it if there is time; returns at once and never raises."""
        ...

    @property
    def shed(self) -> Mapping[str, int]:
        """How much of what was offered wasn't shown, by reason."""
        ...


class Screen(Protocol):
    """Where a live view is shown; may be slow, may raise anything."""

    def show_frame(self, index: int, t_ns: int, image: NDArray[np.uint8], markers: FrameMarkers) -> None:
        """Show a frame and its markers."""
        ...

    def show_readings(self, t_ns: NDArray[np.int64], q: FloatArray, goal: FloatArray) -> None:
        """Show N readings (N,), (N, J), (N, J); goals are NaN where there are none."""
        ...

    def show_detected(self, t_ns: NDArray[np.int64], q: FloatArray) -> None:
        """Show N states (N,), (N, C) that were detected; NaN unseen."""
        ...

    def show_event(self, t_ns: int, level: str, text: str) -> None:
        """Show something that happened."""
        ...

    def close(self) -> None:
        """Show nothing more."""
        ...


class QueuedView:
    """A live view that shows on a screen, in a thread of its own.

    Use it in a `with` block; the screen is closed on leaving.

    Args:
        screen: used by the thread alone.
        say: told once, by the thread, why the screen failed; nothing is shown from then on.
    """

    def __init__(self, screen: Screen, say: Callable[[str], None] | None = None) -> None:
        self._screen, self._say = screen, say
        self._waiting = _Waiting()
        self._shed: Counter[str] = Counter()
        self._changed = threading.Condition()
        self._showing = False
        self._over: str | None = None  # why nothing is taken any more
        self._thread = threading.Thread(target=self._run, name="live view", daemon=True)

    def __enter__(self) -> QueuedView:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._over = self._over or CLOSED
            self._changed.notify()
        self._thread.join(CLOSE_S)  # a screen that hangs is left to itself

    @property
    def shed(self) -> Mapping[str, int]:
        """How much of what was offered wasn't shown, by reason."""
        with self._changed:
            return dict(self._shed)

    def offer(self, item: Offer) -> None:
        """Show it if there is time: of what waits too long, the newest wins; returns at once."""
        with self._changed:
            if self._over is not None:
                self._shed[self._over] += 1
            elif self._waiting.add(item):
                self._shed[BEHIND if self._showing else RATE] += 1
            self._changed.notify()

    def _run(self) -> None:
        try:
            while (due := self._due()) is not None:
                self._show(due)
        except Exception as error:  # a view that fails must not end the capture: it is said once, and counted
            self._fail(str(error) or type(error).__name__)
        finally:
            self._screen.close()

    def _due(self) -> _Waiting | None:
        """What is to be shown next; None at the end."""
        with self._changed:
            self._showing = False
            self._changed.wait_for(lambda: self._over is not None, PERIOD_S)
            self._changed.wait_for(lambda: self._over is not None or self._waiting)
            due, self._waiting = self._waiting, _Waiting()
            self._showing = True
            return due or None

    def _show(self, due: _Waiting) -> None:
        for event in due.events:
            self._screen.show_event(event.t_ns, event.level, event.text)
        if due.readings:
            t_ns = np.array([reading.t_ns for reading in due.readings], dtype=np.int64)
            q = np.array([reading.q for reading in due.readings])
            goals = [np.full(q.shape[1:], np.nan) if r.goal is None else r.goal for r in due.readings]
            self._screen.show_readings(t_ns, q, np.array(goals))
        if due.detected:
            t_ns = np.array([seen.t_ns for seen in due.detected], dtype=np.int64)
            self._screen.show_detected(t_ns, np.array([seen.q for seen in due.detected]))
        if (frame := due.frame) is not None:
            self._screen.show_frame(frame.index, frame.t_ns, frame.image, frame.markers)

    def _fail(self, why: str) -> None:
        with self._changed:
            self._over = FAILED
        if self._say is not None:
            self._say(why)


class _Waiting:
    """What waits to be shown."""

    def __init__(self) -> None:
        self.frame: LiveFrame | None = None
        self.readings: deque[LiveReading] = deque(maxlen=WAITING)
        self.detected: deque[LiveDetected] = deque(maxlen=WAITING)
        self.events: deque[LiveEvent] = deque(maxlen=WAITING)

    def __bool__(self) -> bool:
        return self.frame is not None or bool(self.readings) or bool(self.detected) or bool(self.events)

    def add(self, item: Offer) -> bool:
        """Take it; returns whether an older one had to go for it."""
        if isinstance(item, LiveFrame):
            full, self.frame = self.frame is not None, item
        elif isinstance(item, LiveReading):
            full = len(self.readings) == WAITING
            self.readings.append(item)
        elif isinstance(item, LiveDetected):
            full = len(self.detected) == WAITING
            self.detected.append(item)
        else:
            full = len(self.events) == WAITING
            self.events.append(item)
        return full
