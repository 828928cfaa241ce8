"""A thread that owns something: others have it do their work on it, one piece after the other, and wait."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, TypeVar

T = TypeVar("T")


class OwnerEnded(Exception):
    """The owner thread takes no more work."""


class OwnerThread:
    """A thread that does what it is given, in order; `concurrent.futures` does the same in several times the time.

    A signal ends the wait of the one who asked, not the work.
    """

    def __init__(self, name: str) -> None:
        self._work: SimpleQueue[tuple[Callable[[], Any], SimpleQueue[Any]] | None] = SimpleQueue()
        self._gate = threading.Lock()  # between those who ask and the one who ends it
        self._ended = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def do(self, work: Callable[[], T]) -> T:
        """Have something done and wait for it; returns what it returns, raises what it raises, or OwnerEnded."""
        done: SimpleQueue[tuple[T | None, BaseException | None]] = SimpleQueue()
        with self._gate:
            if self._ended:
                raise OwnerEnded
            self._work.put((work, done))
        value, error = done.get()
        if error is not None:
            raise error
        return value  # pyright: ignore[reportReturnType]

    def end(self) -> None:
        """Let it finish what it was given, and wait until it has ended."""
        with self._gate:
            self._ended = True
            self._work.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (given := self._work.get()) is not None:
            work, done = given
            try:
                done.put((work(), None))
            except BaseException as error:  # it is the one's who asked
                done.put((None, error))
            del given, work, done  # or the last piece of work, and what it holds, would stay until the next
