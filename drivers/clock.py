"""Clocks: monotonic nanoseconds, real or virtual, that are handed to everything that waits or stamps."""

from __future__ import annotations

import threading
import time
from contextlib import AbstractContextManager, nullcontext
from types import TracebackType
from typing import Protocol


class Clock(Protocol):
    """Monotonic time in nanoseconds."""

    def now_ns(self) -> int:
        """Time since an arbitrary start."""
        ...

    def sleep_until_ns(self, t_ns: int) -> None:
        """Return when `now_ns() >= t_ns`; at once if that has passed."""
        ...

    def seat(self) -> AbstractContextManager[object]:
        """A place among the threads that share this time, taken now; a thread works within it as a context.

        Take a thread's seat before the thread is started, in the order that the threads are to have.
        """
        ...


class MonotonicClock:
    """The machine's monotonic clock, which no clock adjustment moves."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_until_ns(self, t_ns: int) -> None:
        while (wait_ns := t_ns - time.monotonic_ns()) > 0:
            time.sleep(wait_ns * 1e-9)

    def seat(self) -> AbstractContextManager[object]:
        return nullcontext()


class VirtualClock:
    """A clock that stands still but for those who sleep on it: the same run on any machine, however slow.

    Threads that have a seat take turns: one of them works, until it sleeps; the time then goes on to the earliest
    waking time of all, and the thread that is to wake then works next; of several the one whose seat was taken first.
    So time passes, and events happen, in one order. While a thread has its turn, others may work on what doesn't
    sleep here, and it may wait for them in real time; it must not wait for another that has a seat.

    Sleeping without a seat moves the time forward and returns at once, whoever's turn it is: so a servo bus lets its
    wire time pass while the thread whose turn it is waits for the reply.
    """

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns
        self._changed = threading.Condition(threading.RLock())  # a signal may interrupt its own thread in here
        self._seats: list[Seat] = []
        self._turn: Seat | None = None

    def now_ns(self) -> int:
        with self._changed:
            return self._now_ns

    def sleep_until_ns(self, t_ns: int) -> None:
        with self._changed:
            seat = self._turn
            if seat is None or seat.thread_id != threading.get_ident():
                self._now_ns = max(self._now_ns, t_ns)
                return
        self._await(seat, t_ns)

    def seat(self) -> Seat:
        with self._changed:
            seat = Seat(self, self._now_ns)
            self._seats.append(seat)
            if self._turn is None:
                self._pass_on()
        return seat

    def await_turn(self, seat: Seat) -> None:
        """Wait for the first turn of the thread that calls."""
        seat.thread_id = threading.get_ident()
        self._await(seat)

    def leave(self, seat: Seat) -> None:
        """Give a seat back, and with it the turn."""
        with self._changed:
            if seat in self._seats:
                self._seats.remove(seat)
            if self._turn is seat:
                self._pass_on()

    def _await(self, seat: Seat, wakes_ns: int | None = None) -> None:
        """Wait for the seat's turn; with `wakes_ns` it has it, and passes it on until then."""
        try:
            with self._changed:
                if wakes_ns is not None:
                    seat.wakes_ns = max(self._now_ns, wakes_ns)
                    self._pass_on()
                self._wait(seat)
        except BaseException:  # a signal's: its thread has its turn before it goes on
            with self._changed:
                seat.wakes_ns = self._now_ns
                self._wait(seat)
            raise

    def _wait(self, seat: Seat) -> None:
        self._changed.wait_for(lambda: self._turn is seat)

    def _pass_on(self) -> None:
        """Give the turn to the one who wakes first."""
        self._turn = min(self._seats, key=lambda seat: seat.wakes_ns, default=None)
        if self._turn is not None:
            self._now_ns = max(self._now_ns, self._turn.wakes_ns)
        self._changed.notify_all()


class Seat:
    """One thread's place among those who take turns on a virtual clock; a context in which the thread works."""

    def __init__(self, clock: VirtualClock, wakes_ns: int) -> None:
        self._clock = clock
        self.wakes_ns = wakes_ns
        self.thread_id: int | None = None

    def __enter__(self) -> Seat:
        self._clock.await_turn(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._clock.leave(self)
