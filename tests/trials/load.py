"""What a program and its machine are busy with, sampled while it runs, as the kernel counts it."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from types import TracebackType

import numpy as np

from tests.trials.memory import resident_mb

TICK_S = 1 / os.sysconf("SC_CLK_TCK")
EVERY_S = 0.25
COLUMNS = ("t_s", "idle_s", "own_s", "resident_mb", "threads", "files")


class LoadSampler:
    """Samples a program four times a second in a thread, until it has ended or the block is left.

    Attributes:
        rows: (N, 6) by COLUMNS: s of the monotonic clock; s that all cores were idle since the machine's start; s of
            processor time that the program took; MB in memory; threads; open files.
    """

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._rows: list[tuple[float, ...]] = []
        self._leave = threading.Event()
        self._thread = threading.Thread(target=self._run, name="load")

    def __enter__(self) -> LoadSampler:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._leave.set()
        self._thread.join()

    @property
    def rows(self) -> np.ndarray:
        return np.array(self._rows).reshape(-1, len(COLUMNS))

    def idle_share(self, from_s: float, to_s: float) -> float:
        """The share of all cores that was idle between two times, of the samples around them."""
        rows = self.rows
        a = max(0, int(np.searchsorted(rows[:, 0], from_s)) - 1)
        b = min(len(rows) - 1, max(a + 1, int(np.searchsorted(rows[:, 0], to_s))))
        cores = len(os.sched_getaffinity(0))
        return float((rows[b, 1] - rows[a, 1]) / (rows[b, 0] - rows[a, 0]) / cores)

    def _run(self) -> None:
        while not self._leave.wait(EVERY_S):
            try:
                self._rows.append(self._sample())
            except (FileNotFoundError, ProcessLookupError, IndexError):
                return  # it has ended

    def _sample(self) -> tuple[float, ...]:
        folder = Path(f"/proc/{self._pid}")
        idle = Path("/proc/stat").read_text().split("\n", 1)[0].split()[4:6]  # idle and waiting for a disk, proc(5)
        own = (folder / "stat").read_text().rpartition(")")[2].split()
        threads = len(list((folder / "task").iterdir()))
        files = len(list((folder / "fd").iterdir()))
        ticks = sum(map(int, idle)), int(own[11]) + int(own[12])
        return (
            time.monotonic(),
            ticks[0] * TICK_S,
            ticks[1] * TICK_S,
            resident_mb(self._pid),
            float(threads),
            float(files),
        )
