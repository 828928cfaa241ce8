"""Simulated objects: poses of a tree that moves at random."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

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
from station.cli.show import progress, say_next, warn


@app.command()
def simulate(
    tree: Annotated[
        str,
        typer.Argument(
            metavar="TREE",
            help="kinematics.json, URDF, a fit's folder, or a packaged tree such as swivel_chair.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option("--out", help="The poses.csv to write.", show_default=False)],
    frames: Annotated[int, typer.Option("--frames", help="How many.")] = 100,
    noise_translation_m: Annotated[
        float, typer.Option("--noise-translation-m", help="Magnitude of noise on each axis of a position, eps_T.")
    ] = 0.001,
    noise_rotation_rad: Annotated[
        float, typer.Option("--noise-rotation-rad", help="Magnitude of noise about each axis, eps_R.")
    ] = 0.01,
    inflation: Annotated[
        int, typer.Option("--inflation", help="Virtual trackers near each part, rigidly attached.")
    ] = 0,
    seed: Annotated[int, typer.Option("--seed", help="Of all that is random.")] = 0,
    noise: Annotated[
        str,
        typer.Option(
            "--noise",
            help="uniform (the magnitudes are half widths), gaussian (standard deviations), student (scales) or camera "
            "(standard deviations at 1 m; depth and tilt worse; flips).",
        ),
    ] = "uniform",
    freedom: Freedom = None,
    flips: Flips = None,
    motion: SimulatedMotion = "walk",
    root: SimulatedRoot = "moving",
    planar: Planar = False,
    planar_noise: PlanarNoise = False,
    outliers: Outliers = 0.0,
    missing: Missing = 0.0,
    rate_hz: Annotated[float, typer.Option("--rate-hz", help="Frames a second.")] = 30.0,
    known_noise: Annotated[
        bool, typer.Option("--known-noise", help="Tell the noise's standard deviations in the poses.csv.")
    ] = False,
    truth: Annotated[
        bool,
        typer.Option("--truth", help="Write poses without noise, true states and the true tree beside the poses.csv."),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the files.")] = False,
    as_json: Json = False,
) -> None:
    """Move an articulated object at random and write the poses that a tracker would report (poses.csv).

    Joints walk within their limits, the root wanders, every pose has noise: Algorithm 2 of the paper. Then: station fit
    poses.csv --out DIR.
    """
    from station.commands import simulating
    from station.simulate import SimulationOptions, make_noise

    options = SimulationOptions(
        frames=frames,
        inflation=inflation,
        noise=make_noise(noise, noise_translation_m, noise_rotation_rad, {"freedom": freedom, "flips": flips}),
        motion=motion,
        root=root,
        planar=planar,
        outliers=outliers,
        missing=missing,
        rate_hz=rate_hz,
        known_noise=known_noise,
        planar_noise=planar_noise,
    )
    with progress() as bar:
        bar.stage("simulate")
        written = simulating.simulate(tree, out, options=options, seed=seed, truth=truth, force=force)
    if as_json:
        print(json.dumps(written.as_dict(), allow_nan=False))
    else:
        for path in written.files:
            print(path)
    for warning in written.warnings:
        warn(warning)
    say_next(f"fit it        station fit {out} --out {out.with_suffix('')}_fit")
