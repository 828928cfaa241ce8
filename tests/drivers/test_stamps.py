"""What the driver's stamps tell of frames that never came."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.stamps import OLDEST_NS, Gaps, choose_stamp

MS = 1_000_000


def missing(intervals_ms: list[float]) -> list[int]:
    gaps = Gaps()
    return [gaps.missing_before(round(t * MS)) for t in np.cumsum([0.0, *intervals_ms])]


def test_gaps_are_told_once_the_period_is_known() -> None:
    assert missing([66.0, 33, 33, 33, 33, 66, 33, 100, 33]) == [0, 0, 0, 0, 0, 0, 1, 0, 2, 0]


@given(jitter=st.lists(st.floats(-8, 8), min_size=10, max_size=100))
def test_jitter_is_no_gap(jitter: list[float]) -> None:
    assert not any(missing([33 + j / 2 for j in jitter]))


def test_a_camera_that_slows_down_is_believed_after_a_few_frames() -> None:
    told = missing([33.0] * 20 + [66.0] * 30)
    assert sum(told) == 5 and not any(told[26:])


@given(arrived_ns=st.integers(1, 10**18), driver_ms=st.floats(-1e3, 2e12))
def test_a_stamp_is_the_arrival_or_at_most_a_second_before(arrived_ns: int, driver_ms: float) -> None:
    t_ns, stamp = choose_stamp(driver_ms, arrived_ns)
    assert 0 <= arrived_ns - t_ns <= OLDEST_NS
    assert stamp == "driver" or t_ns == arrived_ns


def test_a_drivers_stamp_keeps_its_microseconds() -> None:
    # As OpenCV computes it: 1000 * tv_sec + tv_usec / 1000.
    driver_ms = 1000 * 8_640_000 + 123_457 / 1000
    assert choose_stamp(driver_ms, 8_640_000_140_000_000) == (8_640_000_123_457_000, "driver")
