"""The thread that owns the bus: in order, for whoever asks, and with no one left waiting when it ends."""

from __future__ import annotations

import threading

import pytest

from drivers.owner import OwnerEnded, OwnerThread


def test_work_is_done_in_order_on_one_thread_and_what_it_raises_is_the_askers() -> None:
    owner = OwnerThread("owner")
    try:
        assert owner.do(lambda: threading.current_thread().name) == "owner"
        with pytest.raises(ZeroDivisionError):
            owner.do(lambda: 1 // 0)
        assert owner.do(lambda: 5) == 5
    finally:
        owner.end()
    with pytest.raises(OwnerEnded):
        owner.do(lambda: 5)
    owner.end()  # a second time does no harm


def test_nobody_waits_for_an_owner_that_has_ended() -> None:
    for _ in range(20):
        owner = OwnerThread("owner")
        done: list[int] = []
        ended: list[bool] = []

        def ask(owner: OwnerThread = owner, done: list[int] = done, ended: list[bool] = ended) -> None:
            try:
                while True:
                    done.append(owner.do(lambda: 1))
            except OwnerEnded:
                ended.append(True)

        askers = [threading.Thread(target=ask) for _ in range(4)]
        for asker in askers:
            asker.start()
        owner.end()
        for asker in askers:
            asker.join(timeout=30)
        assert ended == [True] * 4
