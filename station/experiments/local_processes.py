"""Workers that are processes of this machine.

They are spawned, not forked: a fork copies locks that other threads hold. Each has a line to the program that spawned
it, and ends at once when that is gone or hangs up: no signal has to reach it, and a kill leaves no orphan.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from multiprocessing.connection import Connection
from types import TracebackType

from station.errors import InvalidData
from station.experiments.workers import Workers
from station.fit.parallel import cores

MOST_PROCESSES = 1000


class Processes(Workers):
    """Processes of this machine, one for each core that this program may use if no number is given.

    Args:
        count: of processes.

    Raises:
        InvalidData: for a number that can't be.
    """

    def __init__(self, count: int | None = None) -> None:
        if count is not None and not 1 <= count <= MOST_PROCESSES:
            raise InvalidData(f"workers: have {count}; want 1 to {MOST_PROCESSES}, or none for one a core")
        self._count = cores() if count is None else count

    def __enter__(self) -> Processes:
        self._start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: BaseException | TracebackType | None) -> None:
        self._stop(at_once=kind is not None)

    def slots(self) -> int:
        return self._count

    def renew(self) -> None:
        self._stop(at_once=True)
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._line_end, self._line = context.Pipe(duplex=False)
        self.executor = ProcessPoolExecutor(self._count, context, _begin, (self._line_end,))
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))  # which what is spawned here inherits
        try:
            for _ in range(self._count):  # each finds none idle, and has one spawned
                self.executor.submit(os.getpid)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def _stop(self, *, at_once: bool) -> None:
        if at_once:
            self._line.close()
        self.executor.shutdown(wait=True, cancel_futures=True)
        self._line.close()
        self._line_end.close()


def _begin(line_end: Connection) -> None:
    """In a new worker: Ctrl-C, which a terminal sends to all, is the parent's affair; the line tells when to end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(line_end,), daemon=True).start()


def _end_with(line_end: Connection) -> None:
    with suppress(EOFError, OSError):
        line_end.recv()
    os._exit(0)
