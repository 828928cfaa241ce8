"""Who does the work of a sweep: an executor of the standard concurrent.futures interface, here or on a cluster."""

from __future__ import annotations

from abc import ABC, abstractmethod
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from types import TracebackType

from station.errors import StationError
from station.fit.parallel import cores


class Workers(ABC):
    """Lends an executor inside a `with` block, and another one when its workers died.

    Attributes:
        executor: where to submit to; it changes with `renew`.
        lost: errors of a future whose worker died, or which was lost with its executor.
    """

    executor: Executor
    lost: tuple[type[BaseException], ...] = (BrokenExecutor, CancelledError)

    @abstractmethod
    def __enter__(self) -> Workers: ...

    @abstractmethod
    def __exit__(self, kind: type[BaseException] | None, *_: BaseException | TracebackType | None) -> None:
        """End what was started; at once, whatever runs, after an error or a signal."""

    @abstractmethod
    def slots(self) -> int:
        """How many pieces of work can run at a time."""

    @abstractmethod
    def renew(self) -> None:
        """Have an executor that works after futures were lost; raises StationError where there can be none."""


class Borrowed(Workers):
    """An executor of the caller's, who ends it.

    Args:
        executor: any; what is submitted and returned can be pickled.
        slots: how many pieces of work it runs at a time.
    """

    def __init__(self, executor: Executor, slots: int | None = None) -> None:
        self.executor = executor
        self._slots = cores() if slots is None else slots

    def __enter__(self) -> Borrowed:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: BaseException | TracebackType | None) -> None:
        """Nothing was started here."""

    def slots(self) -> int:
        return self._slots

    def renew(self) -> None:
        raise StationError("the executor that was given lost its workers; go on with another one")
