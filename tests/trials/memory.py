"""How much memory programs take, as the kernel counts it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

PAGE = os.sysconf("SC_PAGE_SIZE")
KIBIBYTE = 1024  # ru_maxrss on Linux


def resident_mb(pid: int | str = "self") -> float:
    """What a program has in memory now, MB."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE / 1e6


def run_measured(command: Sequence[str]) -> tuple[int, float, float]:
    """Run a program to its end: exit code, the most it had in memory at once (MB), processor seconds."""
    pid = os.posix_spawnp(command[0], command, os.environ)
    _, status, usage = os.wait4(pid, 0)
    return os.waitstatus_to_exitcode(status), usage.ru_maxrss * KIBIBYTE / 1e6, usage.ru_utime + usage.ru_stime
