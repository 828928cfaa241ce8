"""Clocks: on the virtual one threads take turns, in one order however the machine schedules them."""

from __future__ import annotations

import signal
import threading
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.clock import MonotonicClock, VirtualClock


def in_turns(clock: VirtualClock, sleeps_ns: list[list[int]], dawdle_s: float = 0.0) -> list[tuple[int, int]]:
    """Threads that sleep one time after the other; returns (time, thread) whenever one woke."""
    woke: list[tuple[int, int]] = []

    def work(seat, number: int, sleeps: list[int]) -> None:
        with seat:
            for sleep_ns in sleeps:
                if dawdle_s:
                    time.sleep(dawdle_s * (number % 2))
                clock.sleep_until_ns(clock.now_ns() + sleep_ns)
                woke.append((clock.now_ns(), number))

    with clock.seat():
        threads = [
            threading.Thread(target=work, args=(clock.seat(), number, sleeps))
            for number, sleeps in enumerate(sleeps_ns)
        ]
        for thread in threads:
            thread.start()
    for thread in threads:
        thread.join()
    return woke


def simulated(sleeps_ns: list[list[int]]) -> list[tuple[int, int]]:
    """The same without threads: always the one that wakes first goes on, of several the first."""
    wakes = [0] * len(sleeps_ns)
    left = [[*sleeps] for sleeps in sleeps_ns]
    begun = [False] * len(sleeps_ns)
    woke: list[tuple[int, int]] = []
    now = 0
    while any(not has or more for has, more in zip(begun, left, strict=True)):
        number = min((n for n in range(len(left)) if not begun[n] or left[n]), key=lambda n: wakes[n])
        now = max(now, wakes[number])
        if begun[number]:
            left[number].pop(0)
            woke.append((now, number))
        begun[number] = True
        if left[number]:
            wakes[number] = now + left[number][0]
    return woke


@settings(max_examples=40)
@given(st.lists(st.lists(st.integers(0, 5), max_size=6), min_size=1, max_size=4))
def test_threads_wake_in_the_order_of_their_times_and_seats(sleeps_ns: list[list[int]]) -> None:
    assert in_turns(VirtualClock(), sleeps_ns) == simulated(sleeps_ns)


def test_a_thread_that_dawdles_changes_nothing() -> None:
    sleeps = [[3, 3, 1], [2, 2, 2], [1, 5]]
    assert in_turns(VirtualClock(), sleeps, dawdle_s=0.02) == in_turns(VirtualClock(), sleeps)


def test_one_without_a_seat_moves_the_time_and_the_others_wake_late() -> None:
    clock = VirtualClock()
    with clock.seat():
        other = threading.Thread(target=clock.sleep_until_ns, args=(50,))
        other.start()
        other.join()
        assert clock.now_ns() == 50
        clock.sleep_until_ns(20)
        assert clock.now_ns() == 50
    clock.sleep_until_ns(70)
    assert clock.now_ns() == 70


def test_a_signal_while_others_have_their_turn_leaves_the_order_as_it_is() -> None:
    clock, seen = VirtualClock(), []

    def work(seat) -> None:
        with seat:
            clock.sleep_until_ns(10)
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)  # it waits for its turn
            time.sleep(0.05)
            seen.append(("work", clock.now_ns()))

    with clock.seat():
        thread = threading.Thread(target=work, args=(clock.seat(),))
        thread.start()
        with pytest.raises(KeyboardInterrupt):
            clock.sleep_until_ns(1000)
        seen.append(("main", clock.now_ns()))
        clock.sleep_until_ns(2000)
        assert clock.now_ns() == 2000
    thread.join()
    assert seen == [("work", 10), ("main", 10)]


def test_a_real_clocks_seat_holds_nobody_up() -> None:
    clock = MonotonicClock()
    with clock.seat(), clock.seat():
        before_ns = clock.now_ns()
        clock.sleep_until_ns(before_ns + 1_000_000)
        assert clock.now_ns() >= before_ns + 1_000_000
