"""Sweeps: the same rows whoever fits them; a fit that fails, and a worker that dies, cost no other row."""

from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import pytest

from station.errors import InvalidData, StationError
from station.experiments import Processes, Workers, fitted, read_sweep, run_sweep, simulated
from station.experiments import sweep as sweep_module
from station.experiments.fits import kind_of, run_cells
from station.experiments.store import is_kept
from station.kinematics.tree_json import to_json
from station.simulate import SimulationOptions
from tests.experiments.made_sweeps import DOOR, DRAWER, LEVELS, Here, made_up_cells, numbers, small_grid

GRID = small_grid()
# Python's own watcher over what spawned processes share lives as long as the program that spawned some.
resource_tracker.ensure_running()


@pytest.fixture
def without_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows are made up: who hands out which cells is to be seen, not what a fit finds."""
    monkeypatch.setattr(sweep_module, "run_cells", made_up_cells)


class Dying(Workers):
    """Workers that die with the first of some cells, a number of times each.

    Args:
        deaths: how often, by the cell's key.
    """

    def __init__(self, deaths: dict[object, int]) -> None:
        self.deaths, self.renewed = deaths, 0

    def __enter__(self) -> "Dying":
        self.executor = Dies(self.deaths)
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def slots(self) -> int:
        return 2

    def renew(self) -> None:
        self.renewed += 1
        self.executor = Dies(self.deaths)


class Dies(Here):
    """Takes and returns nothing more once it is dead, as a pool of processes does."""

    def __init__(self, deaths: dict[object, int]) -> None:
        self._deaths, self._dead = deaths, False

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        if self._dead:
            raise BrokenExecutor("dead")
        for cell in args[0]:
            if self._deaths.get(cell.key, 0):
                self._deaths[cell.key] -= 1
                self._dead = True
                future: Future[Any] = Future()
                future.set_exception(BrokenExecutor("died"))
                return future
        return super().submit(fn, *args, **kwargs)


def told(folder: Path, grid: Any = GRID, workers: Any = None) -> list[tuple[object, ...]]:
    return [numbers(row) for row in run_sweep(grid, folder, Here() if workers is None else workers).rows]


def test_the_rows_are_the_same_in_this_thread_in_threads_and_in_processes(tmp_path: Path):
    grid = small_grid(trees=(DOOR, DRAWER), methods=("paper", "station"), noise=LEVELS[:1], inflation=(0,), repeats=1)
    here = told(tmp_path / "here", grid)
    with ThreadPoolExecutor(3) as threads:
        assert told(tmp_path / "threads", grid, threads) == here
    assert told(tmp_path / "processes", grid, Processes(2)) == here
    csv = [(tmp_path / name / "sweep.csv").read_text().splitlines() for name in ("here", "processes")]
    assert len(csv[0]) == len(csv[1]) == 1 + len(grid)
    fits = [sorted(path.name for path in (tmp_path / name / "fits").iterdir()) for name in ("here", "processes")]
    assert fits[0] == fits[1]


def test_a_cells_numbers_do_not_depend_on_the_grid_or_on_what_was_done_before(tmp_path: Path):
    alone = told(tmp_path / "alone", small_grid(repeats=1, inflation=(1,)))
    told(tmp_path / "extended", small_grid(repeats=1, noise=LEVELS[1:], inflation=(1,)))
    among = told(tmp_path / "extended", small_grid(trees=(DRAWER, DOOR), repeats=1))
    assert set(alone) <= set(among)


def test_a_finished_sweep_is_not_fitted_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sweep_module, "run_cells", made_up_cells)
    first = told(tmp_path)
    monkeypatch.setattr(sweep_module, "run_cells", None)
    assert told(tmp_path) == first


@pytest.mark.usefixtures("without_fits")
def test_progress_counts_all_rows_and_those_that_were_there(tmp_path: Path):
    run_sweep(small_grid(repeats=1), tmp_path, Here())
    steps: list[tuple[int, int]] = []
    run_sweep(GRID, tmp_path, Here(), progress=lambda done, total: steps.append((done, total)))
    assert steps[0] == (4, 8) and steps[-1] == (8, 8) and steps == sorted(steps)


def test_found_trees_are_kept_for_drawing_and_made_again_by_their_seed(tmp_path: Path):
    grid = small_grid(repeats=1)
    found = run_sweep(grid, tmp_path, Here())
    kept = [row.cell for row in found.rows if found.found_tree(row.cell) is not None]
    assert kept == [row.cell for row in found.rows if is_kept(row.cell, grid)] and len(kept) == 2
    tree = found.found_tree(kept[0])
    assert tree is not None
    assert to_json(fitted(kept[0], simulated(kept[0], DOOR.tree)).tree) == to_json(tree)


def test_a_fit_that_fails_is_a_row_that_says_why_and_the_others_are_fitted(tmp_path: Path):
    grid = small_grid(methods=("paper", "station"), repeats=1, options=SimulationOptions(frames=12, missing=0.6))
    rows = run_sweep(grid, tmp_path, Here()).rows
    failed = [row for row in rows if row.error]
    assert len(rows) == len(grid) and failed
    assert "frames" in (failed[0].error or "") and "Traceback" not in (failed[0].error or "")
    for row in failed:
        assert not row.structure_correct and not row.types_correct and row.axis_error_deg is None and not row.joints


def test_an_error_that_nobody_foresaw_is_a_row_with_its_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def breaks(*_: object) -> None:
        raise ZeroDivisionError("division by\nzero")

    monkeypatch.setattr("station.experiments.fits.learn_all", breaks)
    assert {row.error for row in run_sweep(small_grid(), tmp_path, Here()).rows} == {
        "ZeroDivisionError: division by zero"
    }


def test_a_worker_gives_back_what_it_has_not_begun_when_it_is_time_to_tell():
    cells = sorted(GRID.cells(), key=kind_of)
    trees, kept = {"door": DOOR.tree}, [False] * len(cells)
    told = [outcome.row.cell for outcome in run_cells(cells, trees, kept, tell_every_s=0.0)]
    assert told == [cell for cell in cells if kind_of(cell) == kind_of(cells[0])]
    assert len(run_cells(cells, trees, kept, tell_every_s=60.0)) == len(cells)


@pytest.mark.usefixtures("without_fits")
def test_workers_that_die_lose_and_double_nothing(tmp_path: Path):
    whole = told(tmp_path / "whole")
    cells = GRID.cells()
    dying = Dying({cells[0].key: 2, cells[5].key: 1})
    assert told(tmp_path / "dying", workers=dying) == whole
    assert dying.renewed == 3
    assert len((tmp_path / "dying" / "rows.jsonl").read_text().splitlines()) == len(GRID)


@pytest.mark.usefixtures("without_fits")
def test_a_cell_that_always_kills_its_worker_ends_the_sweep_with_what_is_kept(tmp_path: Path):
    bad = GRID.cells()[2]
    noise = f"noise 0.01 m 0.02 rad, inflation {bad.options.inflation}, repeat {bad.repeat}"
    with pytest.raises(
        StationError, match=rf"a worker died 3 times .* door by station, {noise}\n\d of 8 fits are kept"
    ):
        told(tmp_path, workers=Dying({bad.key: 1000}))
    kept = read_sweep(tmp_path)
    assert bad.key not in {row.cell.key for row in kept.rows}
    assert len((tmp_path / "sweep.csv").read_text().splitlines()) == 1 + len(kept.rows) > 1
    assert len(told(tmp_path)) == len(GRID)


class Together(Executor):
    """Begins what was submitted when it is waited for, all at a time: who dies takes the others along."""

    def __init__(self, bad: object) -> None:
        self.bad, self.begun = bad, list[tuple[Future[Any], Any, Any]]()

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.begun.append((future, fn, args))
        return future

    def end(self) -> None:
        died = any(cell.key == self.bad for _, _, (cells, *_) in self.begun for cell in cells)
        for future, fn, args in self.begun:
            if died:
                future.set_exception(BrokenExecutor("died"))
            else:
                future.set_result(fn(*args))
        self.begun.clear()


@pytest.mark.usefixtures("without_fits")
def test_only_the_cell_whose_fault_it_is_is_named_though_others_die_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    grid = small_grid(repeats=20)
    other, bad = [cell for cell in grid.cells() if kind_of(cell) == kind_of(grid.cells()[1])][:2]

    class Lending(Dying):
        def __enter__(self) -> "Lending":
            self.executor = Together(bad.key)
            return self

        def renew(self) -> None:
            pass

    workers = Lending({})

    def waits(*args: Any, **kwargs: Any) -> Any:
        workers.executor.end()
        return wait(*args, **kwargs)

    monkeypatch.setattr(sweep_module, "wait", waits)
    with pytest.raises(StationError) as error:
        run_sweep(grid, tmp_path, workers)
    told = f"inflation {bad.options.inflation}, repeat {bad.repeat}"
    assert told in str(error.value).splitlines()[0] and "; or" not in str(error.value)
    assert other.key in {row.cell.key for row in read_sweep(tmp_path).rows}  # which had died with it


@pytest.mark.usefixtures("without_fits")
def test_cells_that_workers_give_back_are_handed_out_again(tmp_path: Path):
    assert run_sweep(small_grid(repeats=40), tmp_path, Here()).complete


class Interrupting(Here):
    """As if Ctrl-C were pressed while a later piece of work is handed out."""

    def __init__(self) -> None:
        self.left = 2

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return super().submit(fn, *args, **kwargs)


@pytest.mark.usefixtures("without_fits")
def test_an_interrupted_sweep_keeps_its_rows_writes_its_table_and_is_gone_on_with(tmp_path: Path):
    grid = replace(GRID, repeats=4)
    run_sweep(small_grid(repeats=1), tmp_path, Here())
    with pytest.raises(KeyboardInterrupt):
        run_sweep(grid, tmp_path, Interrupting())
    kept = len(read_sweep(tmp_path).rows)
    assert 4 <= kept < len(grid)
    assert len((tmp_path / "sweep.csv").read_text().splitlines()) == 1 + kept
    assert [numbers(row) for row in run_sweep(grid, tmp_path, Here()).rows] == told(tmp_path.with_name("at_once"), grid)


@pytest.mark.usefixtures("without_fits")
def test_an_executor_of_the_callers_that_is_shut_down_is_an_error_and_not_a_loop(tmp_path: Path):
    executor: Executor = ThreadPoolExecutor(1)
    executor.shutdown()
    with pytest.raises(StationError, match="the executor that was given"):
        run_sweep(GRID, tmp_path, executor)


@pytest.mark.parametrize("count", [0, -1, 10**6])
def test_numbers_of_processes_that_cannot_be_are_refused(count: int):
    with pytest.raises(InvalidData, match="want 1 to 1000"):
        Processes(count)
