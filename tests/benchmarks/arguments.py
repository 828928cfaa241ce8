"""The command line that all benchmarks of the learner share, and the loop over their trials."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def parser(description: str | None, *, trials: int, quick: int) -> argparse.ArgumentParser:
    """Options --seed, --trials, --quick and --workers; `quick` trials stand in for `trials` when it is asked for."""
    options = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seed", type=int, default=0, help="of all random numbers")
    options.add_argument("--trials", type=int, default=None, help=f"in each cell ({trials}; --quick: {quick})")
    options.add_argument("--quick", action="store_true", help="few trials, small cases")
    options.add_argument("--workers", type=int, default=1, help="processes; the numbers don't depend on it")
    options.set_defaults(trials_by_speed=(trials, quick))
    return options


def trials_of(chosen: argparse.Namespace) -> int:
    """Trials in each cell."""
    slow, quick = chosen.trials_by_speed
    return chosen.trials if chosen.trials is not None else quick if chosen.quick else slow


def each(function: Callable[[Job], Result], jobs: Iterable[Job], workers: int) -> list[Result]:
    """The function's results in the order of the jobs; both have to be picklable when there are several workers."""
    if workers == 1:
        return [function(job) for job in jobs]
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(function, jobs))
