"""Sweeps a grid: hands its cells out to workers and has each row on the disk as it comes."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from os import PathLike
from pathlib import Path

from station.errors import StationError
from station.experiments.fits import Outcome, kind_of, run_cells
from station.experiments.grid import Cell, CellKey, Grid
from station.experiments.local_processes import Processes
from station.experiments.store import Store, Sweep, is_kept
from station.experiments.workers import Borrowed, Workers

# Cells that are handed out together, at most; a worker tells what it has every second and gives the others back.
MOST_AT_ONCE = 32
# Waiting cells among which those of one kind are sought.
LOOK_AHEAD = 1024
# Pieces of work that are on their way for each that runs, so that no worker waits.
AHEAD = 2
# A cell whose worker died so often is not tried again.
MOST_DEATHS = 3

Progress = Callable[[int, int], None]


def run_sweep(
    grid: Grid,
    folder: str | PathLike[str],
    workers: Workers | Executor | None = None,
    *,
    force: bool = False,
    progress: Progress | None = None,
) -> Sweep:
    """Fit all cells of a grid that the folder doesn't hold yet; the rows don't depend on who fits them, or when.

    What is done when an error, a signal or a kill ends the sweep stays, and a second call goes on from there.

    Args:
        grid: to be swept.
        folder: new, empty, or of a sweep whose cells are all in the grid.
        workers: who fits; an executor is used as it is and not ended; processes of this machine if None.
        force: begin anew, whatever is in the folder.
        progress: told the number of rows that there are, and of all.

    Raises:
        StationError: see `Store.open`; the workers can't be reached, or die again and again.
    """
    workers = Processes() if workers is None else Borrowed(workers) if isinstance(workers, Executor) else workers
    tell = progress or (lambda done, total: None)
    with Store.open(Path(folder), grid, force=force) as store:
        tell(store.done, len(grid))
        try:
            if store.missing():
                with workers:
                    _Round(store, workers, tell).run()
        finally:
            store.write_tables()
        return store.sweep()


class _Round:
    """The cells that wait, those that are with workers, and how often each one's worker died."""

    def __init__(self, store: Store, workers: Workers, tell: Progress) -> None:
        self._store, self._workers, self._tell = store, workers, tell
        self._trees = {named.name: named.tree for named in store.grid.trees}
        self._waiting = deque(store.missing())
        self._flying: dict[Future[list[Outcome]], Sequence[Cell]] = {}
        self._deaths: Counter[CellKey] = Counter()

    def run(self) -> None:
        while self._waiting or self._flying:
            broken = not self._hand_out()
            done, _ = wait(self._flying, return_when=FIRST_COMPLETED)
            for future in done:
                broken |= not self._take(future, self._flying.pop(future))
            if broken:
                self._mend()

    def _hand_out(self) -> bool:
        """Have enough on its way; False if the executor takes nothing more."""
        slots = self._workers.slots()
        while self._waiting and len(self._flying) < (1 if self._searching() else AHEAD * slots):
            cells = self._next(slots)
            kept = [is_kept(cell, self._store.grid) for cell in cells]
            trees = {cell.tree: self._trees[cell.tree] for cell in cells}
            try:
                future = self._workers.executor.submit(run_cells, cells, trees, kept)
            except (RuntimeError, *self._workers.lost):
                self._waiting.extendleft(reversed(cells))
                return False
            self._flying[future] = cells
        return True

    def _searching(self) -> bool:
        """Whether a cell whose worker died is next, or under way: alone, so that it is seen whose fault it was."""
        return self._suspects(self._waiting[0], *(cell for cells in self._flying.values() for cell in cells))

    def _next(self, slots: int) -> list[Cell]:
        """Cells of a kind, to hand out together: fewer towards the end, so that all workers end at a time; suspects go
        alone.
        """
        share = math.ceil(len(self._waiting) / (2 * AHEAD * slots))
        cells = [self._waiting.popleft()]
        most = 1 if self._suspects(cells[0]) else min(share, MOST_AT_ONCE)
        others: list[Cell] = []
        while self._waiting and len(cells) < most and len(others) < LOOK_AHEAD:
            cell = self._waiting.popleft()
            alike = kind_of(cell) == kind_of(cells[0]) and not self._suspects(cell)
            (cells if alike else others).append(cell)
        self._waiting.extendleft(reversed(others))
        return cells

    def _suspects(self, *cells: Cell) -> bool:
        return any(self._deaths[cell.key] for cell in cells)

    def _take(self, future: Future[list[Outcome]], cells: Sequence[Cell]) -> bool:
        """Have what came on the disk, and what did not wait again; False if the worker died."""
        try:
            outcomes = future.result()
        except self._workers.lost:
            self._deaths.update(cell.key for cell in cells)
            self._waiting.extendleft(reversed(cells))
            return False
        self._store.add(outcomes)
        self._tell(self._store.done, len(self._store.grid))
        self._waiting.extendleft(reversed(cells[len(outcomes) :]))
        return True

    def _mend(self) -> None:
        """After a worker died: all that is on its way ends or is lost, then there is a new executor."""
        wait(self._flying)
        for future, cells in self._flying.items():
            self._take(future, cells)
        self._flying.clear()
        worst = [cell for cell in self._waiting if self._deaths[cell.key] >= MOST_DEATHS]
        if worst:
            raise StationError(self._gave_up(worst))
        try:
            self._workers.renew()
        except StationError as error:
            raise StationError(f"{error}\n{self._kept()}; run the same command again to go on") from error

    def _kept(self) -> str:
        return f"{self._store.done} of {len(self._store.grid)} fits are kept in '{self._store.folder}'"

    def _gave_up(self, cells: Sequence[Cell]) -> str:
        named = "; or ".join(map(_told, cells[:2]))
        return (
            f"a worker died {MOST_DEATHS} times (killed, or out of memory?) while it fitted {named}\n"
            f"{self._kept()}\n"
            "give them more memory or take fewer --workers, and run the same command again to go on"
        )


def _told(cell: Cell) -> str:
    noise = f"{cell.noise.translation_m:g} m {cell.noise.rotation_rad:g} rad"
    return f"{cell.tree} by {cell.method}, noise {noise}, inflation {cell.options.inflation}, repeat {cell.repeat}"
