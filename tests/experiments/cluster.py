"""A real Dask cluster on this machine, in programs of its own: it tells its address and its workers, and ends with its
standard input. No dashboard, and nothing listens but on 127.0.0.1.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

# Far more than it takes on a busy machine.
END_S = 120.0
ROOT = Path(__file__).parent.parent.parent


@dataclass(frozen=True)
class Cluster:
    """Where its scheduler listens, the process that is it, and the processes of its workers."""

    address: str
    pid: int
    workers: tuple[int, ...]


@contextmanager
def running_cluster(workers: int = 2) -> Generator[Cluster, None, None]:
    """A cluster with so many workers of one thread each; a worker that dies is started again."""
    command = [sys.executable, "-m", "tests.experiments.cluster", str(workers)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, cwd=ROOT, text=True, **pipes) as program:  # type: ignore[call-overload]
        told = json.loads(program.stdout.readline())
        try:
            yield Cluster(told["address"], program.pid, tuple(told["workers"]))
        finally:
            program.stdin.close()
            try:
                program.wait(END_S)
            finally:
                program.kill()


def main() -> None:
    """Run until standard input ends."""
    from distributed import Client, LocalCluster

    count = int(sys.argv[1])
    options = {"n_workers": count, "threads_per_worker": 1, "processes": True, "host": "127.0.0.1"}
    with LocalCluster(**options, dashboard_address="127.0.0.1:0") as cluster:
        with Client(cluster) as client:
            workers = list(client.run(os.getpid).values())
        sys.stdout.write(json.dumps({"address": cluster.scheduler_address, "workers": workers}) + "\n")
        sys.stdout.flush()
        sys.stdin.read()


if __name__ == "__main__":
    main()
