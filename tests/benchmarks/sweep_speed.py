"""How long a sweep of 4,096 fits takes on the cores of this machine: on processes, and on a local Dask cluster.

The grid: the packaged tree experiment1 (four parts, three joints), 200 frames, Algorithm 2's walk, uniform noise at
the four levels of Experiment 1, inflation 0, method station, 1,024 repeats; `--methods` and `--inflation` take others.
Wanted: less than 120 s on 2 cores by each.

Parallel efficiency is what one process does in a second, by how many processes there are, against what they do: 1 is
perfect. One process fits a part of the same grid (every n-th repeat), before and after the others, so that a machine
that other programs use is seen: the two rates are printed, their mean counts. Start-up is told apart: it is paid once.

Run: python -m tests.benchmarks.sweep_speed [--repeats N] [--workers N] [--methods station,paper] [--inflation 0,1]
     [--only processes|dask] [--quick]
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from station.commands.sweeping import named_trees, parse_counts
from station.experiments import DaskCluster, Grid, Processes, Sweep, Workers, run_sweep
from station.fit.parallel import cores

WANTED_S, REPEATS, QUICK_REPEATS = 120.0, 1024, 8
# Of the grid's repeats, one process fits so many at a time: enough for batches as large as those of the whole.
ALONE_SHARE = 0.125


@dataclass(frozen=True)
class Timing:
    """Of one sweep: wall-clock time in all and until its first rows, its fits' processor time, and that of all."""

    fits: int
    wall_s: float
    first_s: float
    first_fits: int
    fits_s: float
    processor_s: float

    @property
    def rate(self) -> float:
        """Fits a second, of those after the first rows: start-up is over then."""
        return (self.fits - self.first_fits) / (self.wall_s - self.first_s)


def timed(grid: Grid, workers: Workers) -> Timing:
    """Sweep the grid into a folder that is thrown away."""
    first: list[tuple[float, int]] = []
    start_s, processor_s = time.perf_counter(), processor_time_s()

    def seen(done: int, total: int) -> None:
        if done and not first:
            first.append((time.perf_counter() - start_s, done))

    with tempfile.TemporaryDirectory() as folder:
        sweep: Sweep = run_sweep(grid, Path(folder) / "out", workers, progress=seen)
    wall_s = time.perf_counter() - start_s
    fits_s = sum(row.fit_s for row in sweep.rows)
    return Timing(len(sweep.rows), wall_s, *first[0], fits_s, processor_time_s() - processor_s)


def processor_time_s() -> float:
    """Of this program and of the processes that it started and that ended."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def show(name: str, timing: Timing, alone: float | None, workers: int) -> None:
    """Print one line."""
    efficiency = "" if alone is None else f"{timing.rate / (alone * workers):10.2f}"
    print(f"{name:22s} {timing.fits:6d} {timing.wall_s:9.1f} {timing.first_s:11.1f} {timing.fits_s:11.1f} "
          f"{timing.processor_s:12.1f} {timing.rate:8.1f} {efficiency}", flush=True)  # fmt: skip


def on_dask(grid: Grid, workers: int) -> Timing:
    """Sweep on a cluster of this machine: its start and end don't count, as those of a cluster that is there."""
    from distributed import LocalCluster

    start_s = processor_time_s()
    options = {"n_workers": workers, "threads_per_worker": 1, "processes": True, "host": "127.0.0.1"}
    with LocalCluster(**options, dashboard_address="127.0.0.1:0") as cluster:
        timing = timed(grid, DaskCluster(cluster.scheduler_address))
    return replace(timing, processor_s=processor_time_s() - start_s)  # a worker's counts when it has ended


def parsed() -> argparse.Namespace:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--repeats", type=int, default=REPEATS, help="of each of four noise levels")
    options.add_argument("--workers", type=int, default=cores())
    options.add_argument("--methods", default="station")
    options.add_argument("--inflation", default="0")
    options.add_argument("--only", choices=("processes", "dask"), default=None)
    options.add_argument("--quick", action="store_true", help=f"{QUICK_REPEATS} repeats")
    return options.parse_args()


def main() -> None:
    """Print the table."""
    chosen = parsed()
    grid = Grid(
        named_trees(["experiment1"]),
        methods=tuple(chosen.methods.split(",")),
        inflation=tuple(parse_counts(chosen.inflation, "--inflation")),
        repeats=QUICK_REPEATS if chosen.quick else chosen.repeats,
    )
    part = replace(grid, repeats=max(2, round(ALONE_SHARE * grid.repeats)))
    ways: dict[str, Callable[[], Timing]] = {
        "processes": lambda: timed(grid, Processes(chosen.workers)),
        "dask": lambda: on_dask(grid, chosen.workers),
    }
    print(f"{len(grid)} fits on {chosen.workers} of {cores()} cores; wanted {WANTED_S:g} s for 4096")
    print(f"{'':22s} {'fits':>6} {'wall [s]':>9} {'first after':>11} {'in fits [s]':>11} {'in all [s]':>12} "
          f"{'fits / s':>8} {'efficiency':>10}")  # fmt: skip
    before = timed(part, Processes(1))
    show("one process", before, None, 1)
    taken = {name: way() for name, way in ways.items() if chosen.only in (None, name)}
    after = timed(part, Processes(1))
    for name, timing in taken.items():
        show(f"{name}, {chosen.workers} workers", timing, (before.rate + after.rate) / 2, chosen.workers)
    show("one process, again", after, None, 1)


if __name__ == "__main__":
    main()
