"""Experiment 1 and other sweeps: many simulated objects fitted, scored, and told in tables and figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from statistics import median

from station.errors import InvalidData
from station.experiments import DaskCluster, Grid, NamedTree, NoiseLevel, Processes, Row, Sweep, Workers, run_sweep
from station.experiments.store import CSV_FILE, PARQUET_FILE
from station.formats.trees import load_tree
from station.logs import SLUG

# Experiment 1, and a first look at it.
TREES = ("experiment1",)
QUICK_REPEATS, QUICK_INFLATION = 1, (0, 1)
PROCESSES = "processes"


@dataclass(frozen=True)
class LevelSummary:
    """What came of the fits of one tree by one method at one noise level and inflation.

    Attributes:
        fits: that are done; the next three count among them.
        structure_correct, types_correct, failed: how many.
        axis_error_deg: median over the fits that have one; None if none has.
        fit_s: median processor time.
    """

    tree: str
    method: str
    noise_translation_m: float
    noise_rotation_rad: float
    inflation: int
    fits: int
    structure_correct: int
    types_correct: int
    failed: int
    axis_error_deg: float | None
    fit_s: float


@dataclass(frozen=True, eq=False)
class SweepResult:
    """What a sweep came to, and the files that tell it."""

    sweep: Sweep
    files: tuple[Path, ...]

    @property
    def failed(self) -> tuple[Row, ...]:
        """The fits that failed."""
        return tuple(row for row in self.sweep.rows if row.error is not None)


def sweep(
    out: str | PathLike[str],
    grid: Grid | None = None,
    *,
    workers: Workers | Executor | None = None,
    force: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> SweepResult:
    """Fit all cells of a grid, or those that a folder doesn't have yet, and write what came of them.

    Writes sweep.csv, sweep.parquet, figure5.png and .svg, and three figures more (`station.report.figure5`); see
    `station.experiments.store` for the rest. The rows don't depend on who fits them or when.

    Args:
        out: new, empty, or of a sweep whose cells are all in the grid: it is gone on with.
        grid: to be swept; `named_trees` and `noise_levels` make parts of it; Experiment 1 if None.
        workers: who fits: `workers_at`, or any executor of concurrent.futures; processes of this machine if None.
        force: begin anew, whatever is in `out`.
        progress: told the number of rows that there are, and of all.

    Raises:
        StationError: `out` is occupied; the workers can't be reached or die; what is done stays.
    """
    from station.report.figure5 import write_figure5

    grid = Grid(named_trees(TREES)) if grid is None else grid
    done = run_sweep(grid, out, workers, force=force, progress=progress)
    files = [done.folder / name for name in (CSV_FILE, PARQUET_FILE)]
    return SweepResult(done, (*files, *write_figure5(done, done.folder)))


def workers_at(executor: str, count: int | None = None) -> Workers:
    """Who does the work: "processes" of this machine, `count` of them, or the address of a Dask scheduler.

    Raises:
        InvalidData: for what is neither; for a number of processes with an address, or one that can't be.
    """
    if executor == PROCESSES:
        return Processes(count)
    if count is not None:
        raise InvalidData(f"workers: have {count} with {executor}; a Dask cluster has the workers that it has")
    return DaskCluster(executor)


def named_trees(names: Sequence[str | PathLike[str]]) -> tuple[NamedTree, ...]:
    """Packaged trees by name, and files: named by their stem, or their folder's name where that says nothing.

    Raises:
        InvalidFile: for a tree that can't be read.
        InvalidData: for a file whose name is no name for a tree.
    """
    return tuple(NamedTree(_tree_name(name), load_tree(name)) for name in names)


def _tree_name(name: str | PathLike[str]) -> str:
    path = Path(name)
    stem = path.resolve().parent.name if path.stem == "kinematics" else path.stem
    slug = stem.lower().replace("-", "_").replace(" ", "_")
    if not SLUG.fullmatch(slug):
        raise InvalidData(f"tree '{name}' can't be named '{stem}' in tables; rename the file: letters, digits and _")
    return slug


def noise_levels(translation_m: Sequence[float], rotation_rad: Sequence[float]) -> tuple[NoiseLevel, ...]:
    """Levels of pairs; a single value goes with all of the other.

    Raises:
        InvalidData: for lists of different lengths.
    """
    most = max(len(translation_m), len(rotation_rad))
    translations, rotations = (
        list(values) * most if len(values) == 1 else list(values) for values in (translation_m, rotation_rad)
    )
    if len(translations) != len(rotations):
        have = f"{len(translations)} of translation, {len(rotations)} of rotation"
        raise InvalidData(f"noise: have {have}; want a rotation for each translation, or one for all")
    return tuple(NoiseLevel(*pair) for pair in zip(translations, rotations, strict=True))


def summary(sweep: Sweep) -> tuple[LevelSummary, ...]:
    """The rows of each tree, method, noise level and inflation together, in the grid's order."""
    together: dict[tuple[str, str, float, float, int], list[Row]] = {}
    for row in sorted(sweep.rows, key=lambda row: row.cell.repeat > 0):  # the levels in the order of the first repeat
        together.setdefault(row.cell.key[:-1], []).append(row)
    return tuple(map(_summary, together.values()))


def _summary(rows: Sequence[Row]) -> LevelSummary:
    cell = rows[0].cell
    errors = [row.axis_error_deg for row in rows if row.axis_error_deg is not None]
    return LevelSummary(
        tree=cell.tree,
        method=cell.method,
        noise_translation_m=cell.noise.translation_m,
        noise_rotation_rad=cell.noise.rotation_rad,
        inflation=cell.options.inflation,
        fits=len(rows),
        structure_correct=sum(row.structure_correct for row in rows),
        types_correct=sum(row.types_correct for row in rows),
        failed=sum(row.error is not None for row in rows),
        axis_error_deg=median(errors) if errors else None,
        fit_s=median(row.fit_s for row in rows),
    )


def parse_numbers(text: str, what: str) -> list[float]:
    """Numbers between commas; raises InvalidData for what is none."""
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise InvalidData(f"{what} is '{text}'; want numbers with commas between them, such as 0.001,0.01") from None


def parse_counts(text: str, what: str) -> list[int]:
    """Whole numbers between commas; raises InvalidData for what is none."""
    values = parse_numbers(text, what)
    if not all(math.isfinite(value) and value == int(value) for value in values):
        raise InvalidData(f"{what} is '{text}'; want whole numbers with commas between them, such as 0,1,2")
    return [int(value) for value in values]
