"""What one worker does: cells of a grid are simulated, fitted and scored; those of one kind together."""

from __future__ import annotations

import math
import platform
import threading
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from itertools import groupby

from threadpoolctl import threadpool_limits

from station.errors import InvalidData, StationError
from station.experiments.grid import Cell
from station.experiments.rows import JointRow, Row
from station.fit.learner import Fit, FitOptions, learn, learn_all
from station.fit.parallel import FRAMES_AT_ONCE, in_this_thread, keep_freed_memory
from station.kinematics.tree import KinematicTree
from station.kinematics.tree_json import to_json
from station.simulate import Simulated, simulate
from station.tree_scores import JointScore, TreeScores, score_tree

# A worker tells what it has after so long, s: that much, and what is fitted together, is lost if it is killed.
TELL_EVERY_S = 1.0
# Cells that are fitted together, at most, and frames of all their pairs; more at a time take as long.
MOST_TOGETHER, FRAMES_TOGETHER = 32, 8 * FRAMES_AT_ONCE
STATE_UNITS = {"rad": 180 / math.pi, "m": 1000.0}


@dataclass(frozen=True)
class Outcome:
    """A row, and the text of the found tree's kinematics.json if it is to be kept."""

    row: Row
    found: str | None


def simulated(cell: Cell, tree: KinematicTree) -> Simulated:
    """What a cell's fit is given: the very same log each time, and for each method."""
    return simulate(tree, cell.options, cell.seed)


def fitted(cell: Cell, made: Simulated) -> Fit:
    """What a cell's method learns from the log; raises InvalidData where it can't."""
    return learn(made.log, FitOptions(method=cell.method))


def run_cells(
    cells: Sequence[Cell], trees: Mapping[str, KinematicTree], kept: Sequence[bool], tell_every_s: float = TELL_EVERY_S
) -> list[Outcome]:
    """Run one or more cells, from the first, until it is time to tell what there is; neighbours of a kind together.

    Args:
        cells: to run.
        trees: that generate them, by name.
        kept: whether each one's tree is to be kept.
        tell_every_s: no further cells are begun after so long.
    """
    end_s = time.monotonic() + tell_every_s
    keep_freed_memory()
    found: list[Outcome] = []
    with _one_thread():
        for some in _together(cells, trees):
            keeps = kept[len(found) : len(found) + len(some)]
            found += _run(some, trees[some[0].tree], keeps)
            if time.monotonic() > end_s:
                break
    return found


def kind_of(cell: Cell) -> tuple[str, str, int]:
    """What cells have in common whose fits take about as long, and can be made together."""
    return cell.tree, cell.method, cell.options.inflation


def _together(cells: Sequence[Cell], trees: Mapping[str, KinematicTree]) -> Iterator[Sequence[Cell]]:
    """Neighbours of a kind, in batches that are worth it: of the paper's method one at a time."""
    for _, group in groupby(cells, key=kind_of):
        alike = list(group)
        first = alike[0]
        parts = len(trees[first.tree].parts) * (1 + first.options.inflation)
        frames = first.options.frames * (parts + 1) * parts // 2
        most = 1 if first.method == "paper" else max(1, min(MOST_TOGETHER, FRAMES_TOGETHER // frames))
        yield from (alike[start : start + most] for start in range(0, len(alike), most))


def run_cell(cell: Cell, tree: KinematicTree, *, keep: bool = False) -> Outcome:
    """Simulate, fit and score; a fit that fails, however, is a row that says so.

    Args:
        cell: what to run.
        tree: that generates it.
        keep: whether the found tree is to be kept.
    """
    return _run([cell], tree, [keep])[0]


def _run(cells: Sequence[Cell], tree: KinematicTree, kept: Sequence[bool]) -> list[Outcome]:
    """Cells of a kind together; each one's time is an even share of that of all."""
    begun_s = time.thread_time()
    try:
        made = [simulated(cell, tree) for cell in cells]
        begun_s = time.thread_time()
        fits = learn_all([each.log for each in made], FitOptions(method=cells[0].method))
    except Exception as error:  # whatever it is, and whosever, the other cells are to be fitted
        if len(cells) > 1:
            return [run_cell(cell, tree, keep=keep) for cell, keep in zip(cells, kept, strict=True)]
        return [Outcome(_failed(cells[0], error, time.thread_time() - begun_s), None)]
    fit_s = (time.thread_time() - begun_s) / len(cells)
    found = zip(cells, made, fits, kept, strict=True)
    return [_scored(cell, one, fit, fit_s, keep=keep) for cell, one, fit, keep in found]


def _scored(cell: Cell, made: Simulated, fit: Fit | InvalidData, fit_s: float, *, keep: bool) -> Outcome:
    if isinstance(fit, InvalidData):
        return Outcome(_failed(cell, fit, fit_s), None)
    try:
        scores = score_tree(fit.tree, made.tree, made.truth, found_states=fit.states, true_states=made.states)
    except Exception as error:  # whatever it is, the other cells are to be told
        return Outcome(_failed(cell, error, fit_s), None)
    return Outcome(_row(cell, made.tree, scores, fit_s), to_json(fit.tree) if keep else None)


def _row(cell: Cell, tree: KinematicTree, scores: TreeScores, fit_s: float) -> Row:
    joints = tuple(_joint_row(score, tree.joint(score.joint).unit) for score in scores.joints)
    return Row(
        cell=cell,
        groups_correct=scores.groups_correct,
        structure_correct=scores.structure_correct,
        types_correct=scores.types_correct,
        axis_error_deg=_largest([joint.axis_error_deg for joint in joints]),
        point_error_mm=_largest([joint.point_error_mm for joint in joints]),
        joints=joints,
        fit_s=fit_s,
        error=None,
        versions=versions(),
    )


def _failed(cell: Cell, error: Exception, fit_s: float) -> Row:
    what = "" if isinstance(error, StationError) else f"{type(error).__name__}: "
    text = what + " ".join(str(error).split())
    return Row(cell, False, False, False, None, None, (), fit_s, text, versions())


def _joint_row(score: JointScore, unit: str) -> JointRow:
    return JointRow(
        joint=score.joint,
        true_type=score.true_type,
        found_type=score.found_type,
        found_joint=score.found_joint,
        axis_error_deg=_scaled(score.axis_error_rad, 180 / math.pi),
        point_error_mm=_scaled(score.point_error_m, 1000.0),
        state_rms=_scaled(score.state_rms, STATE_UNITS.get(unit, 1.0)),
    )


def _scaled(value: float | None, scale: float) -> float | None:
    """None also for what is no number: JSON has none such."""
    return None if value is None or not math.isfinite(value) else scale * value


def _largest(values: Sequence[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


@cache
def versions() -> str:
    """Of the programs that a fit's last digits depend on."""
    packages = {"station": "capture-fit-station", "numpy": "numpy", "scipy": "scipy"}
    told = [f"{name} {version(package)}" for name, package in packages.items()]
    return ", ".join([*told, f"python {platform.python_version()}", platform.machine()])


_lock = threading.Lock()
_inside: list[threadpool_limits] = []
_count = 0


@contextmanager
def _one_thread() -> Generator[None, None, None]:
    """One thread a fit. The limit is the whole program's: the first thread that comes sets it, the last lifts it."""
    global _count
    with _lock:
        _count += 1
        if _count == 1:
            _inside.append(threadpool_limits(1, user_api="blas"))
    try:
        with in_this_thread():
            yield
    finally:
        with _lock:
            _count -= 1
            if not _count:
                _inside.pop().restore_original_limits()
