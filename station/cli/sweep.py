"""Many simulated objects fitted: Experiment 1 of the paper, and any other grid."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from station.cli.app import app
from station.cli.options import (
    Flips,
    Freedom,
    Json,
    Missing,
    Outliers,
    Planar,
    PlanarNoise,
    SimulatedMotion,
    SimulatedRoot,
)
from station.cli.show import progress, say_next, table, warn

if TYPE_CHECKING:
    from station.commands.sweeping import LevelSummary, SweepResult
    from station.experiments import Grid

SOME_ERRORS = 3


@app.command()
def sweep(
    out: Annotated[
        Path,
        typer.Option(
            "--out", help="Folder for the result: new, empty, or a sweep's, which is gone on with.", show_default=False
        ),
    ],
    quick: Annotated[bool, typer.Option("--quick", help="Few fits: one repeat, inflation 0 and 1.")] = False,
    trees: Annotated[
        list[str] | None,
        typer.Option(
            "--trees",
            metavar="TREE",
            help="Packaged tree, kinematics.json or URDF; may be repeated; experiment1 if none is given.",
            show_default=False,
        ),
    ] = None,
    methods: Annotated[str, typer.Option("--methods", help="Methods of the fit.")] = "paper,station",
    noise_translation_m: Annotated[
        str | None,
        typer.Option("--noise-translation-m", metavar="M,...", help="Noise levels, rising.", show_default=False),
    ] = None,
    noise_rotation_rad: Annotated[
        str | None,
        typer.Option(
            "--noise-rotation-rad", metavar="RAD,...", help="One for each level, or one for all.", show_default=False
        ),
    ] = None,
    inflation: Annotated[
        str | None,
        typer.Option(
            "--inflation",
            metavar="N,...",
            help="Numbers of virtual trackers near each part, rising; 0,1,2,3 if not given.",
            show_default=False,
        ),
    ] = None,
    repeats: Annotated[
        int | None, typer.Option("--repeats", help="Fits of each kind; 4 if not given.", show_default=False)
    ] = None,
    frames: Annotated[int, typer.Option("--frames", help="Of each simulation.")] = 200,
    seed: Annotated[int, typer.Option("--seed", help="Of everything random.")] = 0,
    noise: Annotated[
        str, typer.Option("--noise", help="uniform, gaussian, student or camera; see station simulate.")
    ] = "uniform",
    freedom: Freedom = None,
    flips: Flips = None,
    motion: SimulatedMotion = "walk",
    root: SimulatedRoot = "moving",
    planar: Planar = False,
    planar_noise: PlanarNoise = False,
    outliers: Outliers = 0.0,
    missing: Missing = 0.0,
    known_noise: Annotated[
        bool, typer.Option("--known-noise", help="Tell the fit the covariance of the noise.")
    ] = False,
    executor: Annotated[
        str,
        typer.Option("--executor", help="processes of this machine, or a Dask scheduler such as tcp://127.0.0.1:8786."),
    ] = "processes",
    workers: Annotated[
        int | None, typer.Option("--workers", help="Processes; one a core if not given.", show_default=False)
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Begin anew, whatever is in the folder.")] = False,
    as_json: Json = False,
) -> None:
    """Simulate, fit and score trees x methods x noise levels x inflation x repeats (Experiment 1, Figure 5).

    Run the same command again to go on with a sweep that was broken off, or with more levels or repeats to extend one.
    """
    from station.commands import sweeping
    from station.experiments import Grid
    from station.experiments.grid import NOISE_LEVELS
    from station.simulate import SimulationOptions

    levels = NOISE_LEVELS
    if noise_translation_m is not None or noise_rotation_rad is not None:
        levels = sweeping.noise_levels(
            _numbers(noise_translation_m, "--noise-translation-m"), _numbers(noise_rotation_rad, "--noise-rotation-rad")
        )
    usual = sweeping.QUICK_INFLATION if quick else Grid.inflation
    grid = Grid(
        trees=sweeping.named_trees(trees or sweeping.TREES),
        methods=tuple(methods.split(",")),
        noise=levels,
        inflation=usual if inflation is None else tuple(sweeping.parse_counts(inflation, "--inflation")),
        repeats=(sweeping.QUICK_REPEATS if quick else Grid.repeats) if repeats is None else repeats,
        seed=seed,
        noise_model=noise,
        noise_parameters={"freedom": freedom, "flips": flips},
        options=SimulationOptions(
            frames=frames,
            motion=motion,
            root=root,
            planar=planar,
            planar_noise=planar_noise,
            outliers=outliers,
            missing=missing,
            known_noise=known_noise,
        ),
    )
    with _telling_how_to_go_on(out, grid), progress() as bar:
        bar.stage("sweep")

        def count(done: int, total: int) -> None:
            bar.count(done, total, "fits")
            if done == total:
                bar.stage("figures")

        result = sweeping.sweep(out, grid, workers=sweeping.workers_at(executor, workers), force=force, progress=count)
    _show(result, sweeping.summary(result.sweep), as_json)


def _numbers(text: str | None, what: str) -> list[float]:
    from station.commands.sweeping import parse_numbers

    return [0.0] if text is None else parse_numbers(text, what)


@contextmanager
def _telling_how_to_go_on(out: Path, grid: Grid) -> Iterator[None]:
    """After a signal, tell what there is."""
    from station.experiments import read_sweep

    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        if (out / "sweep.json").exists():
            done = len(read_sweep(out).rows)
            say_next(f"{done} of {len(grid)} fits are kept in {out}; run the same command again to go on")
        raise


def _show(result: SweepResult, levels: Sequence[LevelSummary], as_json: bool) -> None:
    found = result.sweep
    if as_json:
        told = {
            "fits": len(found.rows),
            "failed": len(result.failed),
            "seed": found.grid.seed,
            "levels": [asdict(level) for level in levels],
            "files": [str(path) for path in result.files],
        }
        print(json.dumps(told, allow_nan=False))
    else:
        table(f"{len(found.rows)} fits", _level_rows(levels))
    for notice in found.notices:
        warn(notice)
    for row in result.failed[:SOME_ERRORS]:
        warn(f"a fit failed ({row.cell.tree} by {row.cell.method}, seed {row.cell.seed}): {row.error}")
    if len(result.failed) > SOME_ERRORS:
        warn(f"{len(result.failed)} fits failed; column error of sweep.csv says why")
    say_next(*(str(path) for path in result.files))


def _level_rows(levels: Sequence[LevelSummary]) -> list[list[str]]:
    many = len({level.tree for level in levels}) > 1
    header = ["method", "noise\n[mm]", "noise\n[deg]", "inflation", "fits", "structure\ncorrect", "types\ncorrect"]
    header = [*(["tree"] if many else []), *header, "axis error\n[deg]", "a fit\n[s]"]
    return [header, *([*([level.tree] if many else []), *_level_row(level)] for level in levels)]


def _level_row(level: LevelSummary) -> list[str]:
    from math import degrees

    error = "" if level.axis_error_deg is None else f"{level.axis_error_deg:.2f}"
    return [
        level.method,
        f"{1e3 * level.noise_translation_m:g}",
        f"{degrees(level.noise_rotation_rad):.2g}",
        str(level.inflation),
        str(level.fits),
        f"{100 * level.structure_correct / level.fits:.0f} %",
        f"{100 * level.types_correct / level.fits:.0f} %",
        error,
        f"{level.fit_s:.2f}",
    ]
