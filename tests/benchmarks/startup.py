"""How long the command line takes to answer, as whole processes.

Run: python -m tests.benchmarks.startup
"""

from __future__ import annotations

import subprocess
import sys
import time

RUNS = 7
COMMANDS = (("--help",), ("demo", "--help"), ("plan", "demo", "demo"))


def main() -> None:
    """Print a row a command: least, median and greatest wall time."""
    print(f"{'command':24}  {'min [s]':>8}  {'median':>8}  {'max':>8}")
    for arguments in COMMANDS:
        times_s = []
        for _ in range(RUNS):
            start_s = time.perf_counter()
            code = "from station.cli import main; main()"
            subprocess.run([sys.executable, "-c", code, *arguments], check=True, stdout=subprocess.DEVNULL)
            times_s.append(time.perf_counter() - start_s)
        times_s.sort()
        row = (times_s[0], times_s[RUNS // 2], times_s[-1])
        print(f"station {' '.join(arguments):16}  " + "  ".join(f"{value:8.2f}" for value in row))


if __name__ == "__main__":
    main()
