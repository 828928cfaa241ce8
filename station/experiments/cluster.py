"""Workers of a Dask cluster, by the address of its scheduler; needs the extra `cluster`."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Generator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, cast

from station.errors import InvalidData, StationError
from station.experiments.fits import versions
from station.experiments.workers import Workers

if TYPE_CHECKING:
    from distributed import Client

ADDRESS = re.compile(r"(tcp|tls|ws|wss|ucx)://[^\s/]+:\d+/?")
# A scheduler that doesn't answer, one that has no workers, and workers that import what a fit needs (from a disk that
# they share, say) are waited for so long, s.
ANSWER_S, WORKERS_S, IMPORT_S = 5.0, 20.0, 120.0
# Between two looks at how many workers there are, s: a cluster may grow and shrink.
LOOK_EVERY_S = 5.0


class DaskCluster(Workers):
    """The workers of a scheduler.

    Args:
        address: of the scheduler, such as tcp://127.0.0.1:8786.

    Raises:
        InvalidData: for what is no address.
        StationError: on entering, where there is no scheduler, where it has no workers, where these can't run a fit;
            without the extra `cluster`.
    """

    def __init__(self, address: str) -> None:
        if not ADDRESS.fullmatch(address):
            raise InvalidData(f"executor '{address}' is no address; want processes, or such as tcp://127.0.0.1:8786")
        self._address = address
        self._client: Client | None = None
        self._slots, self._looked_s = 0, 0.0

    def __enter__(self) -> DaskCluster:
        self._connect()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: BaseException | TracebackType | None) -> None:
        self._close()

    def slots(self) -> int:
        if time.monotonic() > self._looked_s + LOOK_EVERY_S:
            self._slots, self._looked_s = self._threads(), time.monotonic()
        return max(1, self._slots)

    def renew(self) -> None:
        """The same client as long as the scheduler is there: it has seen to its workers by itself."""
        if self._client is None or self._client.status != "running":
            self._close()
            self._connect()

    def _threads(self) -> int:
        """Of all workers; as last seen while the scheduler doesn't answer, which its futures will tell."""
        try:
            return 0 if self._client is None else sum(cast(dict[str, int], self._client.nthreads()).values())
        except (OSError, TimeoutError):
            return self._slots

    def _connect(self) -> None:
        try:
            from dask import config
            from distributed import Client, KilledWorker
        except ImportError:
            raise StationError(
                "a Dask cluster needs the extra 'cluster'\nrun: pip install 'capture-fit-station[cluster]'"
            ) from None
        self._inside = ExitStack()
        self._inside.enter_context(config.set({"distributed.comm.timeouts.connect": ANSWER_S}))
        self._inside.enter_context(_silent(logging.getLogger("distributed.client")))
        try:
            self._client = Client(self._address, timeout=ANSWER_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            self._inside.close()
            raise StationError(
                f"no Dask scheduler answers at {self._address} within {ANSWER_S:g} s: {_first_line(error)}\n"
                "start one: dask scheduler --host 127.0.0.1, and dask worker ADDRESS; or leave --executor out"
            ) from None
        self.lost = (*Workers.lost, KilledWorker)
        self.executor = self._client.get_executor(pure=False)
        try:
            self._check_workers()
        except BaseException:
            self._close()
            raise

    def _check_workers(self) -> None:
        """Raise StationError unless there are workers, and one can do the work."""
        if self._client is None:
            return
        try:
            self._client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError:
            raise StationError(
                f"the scheduler at {self._address} has no workers, and none came within {WORKERS_S:g} s\n"
                f"start some: dask worker {self._address}"
            ) from None
        self._slots, self._looked_s = self._threads(), time.monotonic()
        try:
            self.executor.submit(versions).result(IMPORT_S)
        except (TimeoutError, CancelledError):
            raise StationError(
                f"the workers of {self._address} answer nothing within {IMPORT_S:g} s: busy, or gone\n"
                "see to them, or leave --executor out"
            ) from None
        except Exception as error:
            raise StationError(
                f"the workers of {self._address} can't fit: {_first_line(error)}\n"
                "want the same version of this package, and of Python and Dask, installed there"
            ) from None

    def _close(self) -> None:
        if self._client is not None:
            self.executor.shutdown(wait=False)
            self._client.close(timeout=ANSWER_S)
            self._client = None
            self._inside.close()


@contextmanager
def _silent(logger: logging.Logger) -> Generator[None, None, None]:
    """While it is entered, what goes wrong is told by our errors, and not by a logger's tracebacks as well."""
    before = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        logger.setLevel(before)


def _first_line(error: BaseException) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
