"""A thread with a bounded queue before it: pieces of work are done one after the other, or refused."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Worker(Generic[Item]):
    """Does one kind of work in a thread of its own, in the order in which it is given.

    After its first failure, which `check` raises, what is given is thrown away: nobody waits for a thread that has
    failed.

    Args:
        name: of the thread.
        work: does one piece; called in the thread.
        limits: how many pieces of each kind may wait.
        waits: whether one who offers a piece for which there is no place waits for it (on a virtual clock, where a slow
            machine must not lose anything) or is refused.
    """

    def __init__(self, name: str, work: Callable[[Item], None], limits: Mapping[str, int], *, waits: bool) -> None:
        self._work, self._limits, self.waits = work, limits, waits
        self._queue: deque[tuple[str, Item]] = deque()
        self._waiting: Counter[str] = Counter()
        self._changed = threading.Condition()
        self._ended = False
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin to work."""
        self._thread.start()

    def offer(self, kind: str, item: Item) -> bool:
        """Give a piece of work; False where too many of its kind wait."""
        with self._changed:
            if self.waits:
                self._changed.wait_for(lambda: self._waiting[kind] < self._limits[kind])
            elif self._waiting[kind] >= self._limits[kind]:
                return False
            self._append(kind, item)
            return True

    def give(self, kind: str, item: Item) -> None:
        """Give a piece of work that is too small to be refused."""
        with self._changed:
            self._append(kind, item)

    def fullness(self, kind: str) -> float:
        """The share of the places for a kind that are taken."""
        with self._changed:
            return self._waiting[kind] / self._limits[kind]

    def check(self) -> None:
        """Raise what went wrong in the thread, if anything did."""
        if self._failure is not None:
            raise self._failure

    def end(self) -> None:
        """Wait until all that was given is done; harmless where the thread never began."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join()

    def _append(self, kind: str, item: Item) -> None:
        if not self._ended:
            self._queue.append((kind, item))
            self._waiting[kind] += 1
            self._changed.notify_all()

    def _next(self) -> tuple[str, Item] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._queue or self._ended)
            return self._queue.popleft() if self._queue else None

    def _run(self) -> None:
        while (given := self._next()) is not None:
            kind, item = given
            try:
                if self._failure is None:
                    self._work(item)
            except BaseException as error:  # a thread can't raise to anyone: kept for check()
                self._failure = error
            with self._changed:  # a piece under way still has its place: so few pieces are ever held
                self._waiting[kind] -= 1
                self._changed.notify_all()
            del given, item
