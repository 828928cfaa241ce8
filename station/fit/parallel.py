"""Runs a function over pieces of work on all cores that this program may use; NumPy lets go of the interpreter."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits  # pyright: ignore[reportMissingTypeStubs]

Work = TypeVar("Work")
Result = TypeVar("Result")

# Frames of all pairs in a piece: their numbers stay in a core's cache.
FRAMES_AT_ONCE = 8_000
# Just below the most that glibc can be told; and what it calls what it is told.
LARGEST_KEPT_BYTES = 31 * 2**20
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3

_alone: ContextVar[bool] = ContextVar("alone", default=False)


@contextmanager
def in_this_thread() -> Generator[None, None, None]:
    """While it is entered, `each` starts no threads: for where many fits run side by side, one on each core.

    It holds for the thread that enters it. The numbers are the same.
    """
    before = _alone.set(True)
    try:
        yield
    finally:
        _alone.reset(before)


def cores() -> int:
    """How many cores this program may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def pieces(pairs: int, frames: int) -> list[NDArray[np.intp]]:
    """Rows of pairs of so many frames, in pieces of about equal size."""
    count = min(-(-pairs * frames // FRAMES_AT_ONCE), pairs)
    return np.array_split(np.arange(pairs), max(count, 1))


def each(function: Callable[[Work], Result], work: Sequence[Work]) -> list[Result]:
    """The function's results in the order of the work, which must not depend on each other."""
    workers = 1 if _alone.get() else min(cores(), len(work))
    if workers <= 1:
        return [function(piece) for piece in work]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(function, work))


def keep_freed_memory() -> None:
    """Have the C library keep what arrays give back, for the next ones: getting it from the system anew takes a fifth
    of the time of fits that are made together, and two fifths in a Dask worker, which is told to keep next to nothing.

    By glibc's mallopt(3): blocks of what size stay with the process, and how much free memory; other libraries that
    have none are left alone.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, LARGEST_KEPT_BYTES)
        mallopt(M_TRIM_THRESHOLD, 2 * LARGEST_KEPT_BYTES)


def products_in_one_thread() -> AbstractContextManager[object]:
    """While it is entered, each product of matrices is computed in the thread that asks for it.

    Were the pieces that `each` shares out shared out again, threads would wait for each other most of the time; and
    sums would be made in another order on another computer.
    """
    return threadpool_limits(1, user_api="blas")
