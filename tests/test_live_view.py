"""The live view takes whatever a capture offers without holding it up, and counts what it doesn't show."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import numpy as np
import pytest

from station.capture.live_view import (
    BEHIND,
    CLOSED,
    FAILED,
    RATE,
    WAITING,
    LiveEvent,
    LiveFrame,
    LiveReading,
    QueuedView,
)
from tests.made_sessions import make_frames

PATIENCE_S = 20.0


@dataclass
class MadeScreen:
    """Keeps what it is shown; waits in each frame until it is let go on; fails where it is told to."""

    shown: list[object] = field(default_factory=list)
    goes_on: threading.Event = field(default_factory=threading.Event)
    reached: threading.Event = field(default_factory=threading.Event)
    fails: bool = False
    closed: threading.Event = field(default_factory=threading.Event)

    def show_frame(self, index, t_ns, image, markers) -> None:
        self.reached.set()
        if self.fails:
            raise OSError("the server is dead")
        assert self.goes_on.wait(PATIENCE_S)
        self.shown.append(index)

    def show_readings(self, t_ns, q, goal) -> None:
        self.shown.append((t_ns, q, goal))

    def show_event(self, t_ns, level, text) -> None:
        self.shown.append(text)

    def close(self) -> None:
        self.closed.set()


def frame(index: int) -> LiveFrame:
    made = make_frames(1)[0]
    return LiveFrame(index, made.t_ns + index, made.image, made.markers)


def reading(k: int, goal: float | None = 0.5) -> LiveReading:
    return LiveReading(k, np.array([0.1, 0.2]) * k, None if goal is None else np.full(2, goal))


def test_all_is_shown_where_there_is_time():
    screen = MadeScreen()
    screen.goes_on.set()
    with QueuedView(screen) as view:
        for k in range(3):
            view.offer(reading(k, None if k == 1 else 0.5))
        view.offer(LiveEvent(4, "WARN", "hot"))
        view.offer(frame(7))
    assert view.shed == {}
    assert {"hot", 7} <= {item for item in screen.shown if not isinstance(item, tuple)}
    rows = [item for item in screen.shown if isinstance(item, tuple)]
    assert np.concatenate([t for t, _, _ in rows]).tolist() == [0, 1, 2]
    goals = np.concatenate([goal for _, _, goal in rows])
    np.testing.assert_array_equal(goals, [[0.5, 0.5], [np.nan, np.nan], [0.5, 0.5]])
    assert screen.closed.is_set()


def test_of_what_waits_for_a_slow_screen_the_newest_wins_and_the_rest_is_counted():
    screen = MadeScreen()
    with QueuedView(screen) as view:
        view.offer(frame(0))
        assert screen.reached.wait(PATIENCE_S)
        for index in range(1, 101):
            view.offer(frame(index))
        for k in range(WAITING + 10):
            view.offer(reading(k))
        assert view.shed == {BEHIND: 99 + 10}
        screen.goes_on.set()
    assert [item for item in screen.shown if isinstance(item, int)] == [0, 100]
    (rows,) = (item for item in screen.shown if isinstance(item, tuple))
    assert rows[0].tolist() == list(range(10, WAITING + 10))


def test_frames_beyond_the_rate_are_counted_as_such():
    screen = MadeScreen()
    screen.goes_on.set()
    with QueuedView(screen) as view:
        for index in range(500):
            view.offer(frame(index))
    shown = [item for item in screen.shown if isinstance(item, int)]
    assert shown[-1] == 499
    assert len(shown) + sum(view.shed.values()) == 500
    assert set(view.shed) <= {RATE, BEHIND} and view.shed[RATE] > 0


def test_a_screen_that_fails_is_told_once_and_the_capture_goes_on():
    screen, said = MadeScreen(fails=True), []
    with QueuedView(screen, said.append) as view:
        view.offer(frame(0))
        assert screen.closed.wait(PATIENCE_S)
        for index in range(1, 11):
            view.offer(frame(index))
        assert view.shed == {FAILED: 10}
    assert said == ["the server is dead"]


def test_what_is_offered_after_the_end_is_counted():
    with QueuedView(MadeScreen()) as view:
        pass
    view.offer(frame(0))
    assert view.shed == {CLOSED: 1}


def test_a_screen_that_hangs_does_not_hold_up_the_end(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("station.capture.live_view.CLOSE_S", 0.05)
    screen = MadeScreen()
    with QueuedView(screen) as view:
        view.offer(frame(0))
        assert screen.reached.wait(PATIENCE_S)
    assert not screen.closed.is_set()  # we are here although it still shows
    screen.goes_on.set()
    assert screen.closed.wait(PATIENCE_S)
