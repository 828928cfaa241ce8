"""Sharing out the work of a fit."""

import threading

import pytest

from station.fit import parallel


def test_work_is_shared_out_but_where_fits_run_side_by_side_already(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(parallel, "cores", lambda: 4)
    here, meeting = threading.get_ident(), threading.Barrier(2)

    def who(_: int) -> int:
        meeting.wait(10)  # two threads come here together, or none gets on
        return threading.get_ident()

    assert here not in parallel.each(who, range(2))
    with parallel.in_this_thread():
        assert parallel.each(lambda _: threading.get_ident(), range(2)) == [here, here]
    assert here not in parallel.each(who, range(2))
