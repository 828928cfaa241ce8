"""The command line that all benchmarks of the learner share, and the loop over their trials."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
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


def show_rows(
    description: str | None,
    head: str,
    rows: Iterable[str],
    run: Callable[[tuple[str, int, int]], Result],
    row: Callable[[str, list[Result]], str],
    faults: Callable[[list[Result]], Iterator[str]],
) -> None:
    """Parse the command line, and print a table: a line for each row, of as many trials.

    Args:
        description: of the program.
        head: of the table.
        rows: their names; --only chooses among them.
        run: a trial, by (row, seed, trial).
        row: a line of the trials of a row.
        faults: lines on trials with a fault, for --listed.
    """
    options = parser(description, trials=40, quick=4)
    options.add_argument("--only", default="", help="rows whose name has this in it")
    options.add_argument("--listed", action="store_true", help="also what went wrong, with its row and trial")
    chosen = options.parse_args()
    print(head)
    for name in rows:
        if chosen.only not in name:
            continue
        found = each(run, [(name, chosen.seed, trial) for trial in range(trials_of(chosen))], chosen.workers)
        print(row(name, found), flush=True)
        for line in faults(found) if chosen.listed else ():
            print(f"    {line}", flush=True)
