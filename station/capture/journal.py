"""What a capture says of itself: events, each with its time, into the recording; the last warning for who watches."""

from __future__ import annotations

from drivers.clock import Clock
from station.capture.live_view import LiveEvent, LiveView
from station.capture.recorder import Recorder


class Journal:
    """Events of one capture, from any of its threads."""

    def __init__(self, clock: Clock, recorder: Recorder, live: LiveView | None) -> None:
        self._clock, self._recorder, self._live = clock, recorder, live
        self.said = ""

    def info(self, text: str) -> None:
        """Something that is as it should be."""
        self._record("INFO", text)

    def warn(self, text: str) -> None:
        """Something that people should know of."""
        self._say("WARN", text)

    def error(self, error: BaseException, doing: str = "") -> None:
        """Something that failed."""
        self._say("ERROR", f"{doing}: " * bool(doing) + (str(error) or type(error).__name__))

    def _say(self, level: str, text: str) -> None:
        self.said = text
        self._record(level, text)

    def _record(self, level: str, text: str) -> None:
        t_ns = self._clock.now_ns()
        self._recorder.event(t_ns, level, text)
        if self._live is not None:
            self._live.offer(LiveEvent(t_ns, level, text))
