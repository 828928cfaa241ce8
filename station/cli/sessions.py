"""From a recording to Figure 7: fit, compare, report, view."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from station.cli.app import app
from station.cli.options import Commands, Force, Json, Method, Refine, SessionArgument, Told
from station.cli.show import say_next, show_comparison, table, warn

if TYPE_CHECKING:
    from station.fit.image.image_fit import ImageFit
    from station.kinematics.tree import KinematicTree


@app.command()
def fit(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="Session folder, recording.rrd, or a log of poses.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the result, new or empty; for a session its fit/.")
    ] = None,
    method: Annotated[Method, typer.Option("--method", help="How to fit.")] = Method.station,
    criterion: Annotated[
        str, typer.Option("--criterion", help="Selection criterion: evidence, bic, aic, aicc, paper-aic.")
    ] = "evidence",
    joint_types: Annotated[
        str,
        typer.Option(
            "--joint-types", help="Candidates, comma-separated, of rigid, prismatic, revolute, screw, spherical, free."
        ),
    ] = "rigid,prismatic,revolute",
    root: Annotated[
        str | None, typer.Option("--root", help="Part at the root of the tree.", show_default=False)
    ] = None,
    include_reference: Annotated[
        bool, typer.Option("--include-reference", help="Take the frame of the poses for a static part.")
    ] = False,
    root_static: Annotated[
        Told, typer.Option("--root-static", help="Whether the root stands still before the camera.")
    ] = Told.auto,
    refine: Annotated[
        Refine | None,
        typer.Option(
            "--refine",
            help="What the whole tree is refined on: image, the markers' corners (if not given, where there are any); "
            "pose, the markers' poses; or none: joints stay as pairs of parts told them.",
            show_default=False,
        ),
    ] = None,
    estimate: Annotated[
        str,
        typer.Option(
            "--estimate",
            metavar="NUMBERS",
            help="Of the camera, from the corners too, beside the shift of edges: focal, readout, or focal,readout.",
            show_default=False,
        ),
    ] = "",
    smooth: Annotated[
        str | None,
        typer.Option(
            "--smooth",
            help="Smooth the poses first, and refine on them: lowpass:HZ, kalman, or kalman:S (fills gaps up to S s). "
            "It correlates their noise: stated deviations get too small.",
            show_default=False,
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Discover the kinematic tree in a session or a log of poses, and the states of its joints.

    Reads a session folder, a recording.rrd, poses.csv, TUM files, plain tracks (x y z qx qy qz qw) and the ArUco
    library's old rows. Writes kinematics.json, joint_states.csv, kinematics.urdf and a drawing.
    """
    from station.commands import fitting
    from station.fit.options import FitOptions
    from station.fit_files import TREE_FILE

    options = FitOptions(
        method=method.value,
        criterion=criterion,
        joint_types=tuple(name.strip() for name in joint_types.split(",")),
        root=root,
        include_reference=include_reference,
        root_static=None if root_static is Told.auto else root_static is Told.yes,
        refine=None if refine is None else refine.value,
        camera_numbers=("edge_shift_px", *_estimated(estimate)),
    )
    result = fitting.fit(source, out, options=options, smooth=smooth, force=force)
    if as_json:
        print((result.folder / TREE_FILE).read_text(encoding="utf-8"))
    else:
        _show_tree(result.fit.tree)
        if result.fit.image is not None:
            print(_image_line(result.fit.image))
        if result.checks is not None:
            print(f"model checks: {result.checks.summary}")
    for notice in (*result.notices, *result.fit.tree.warnings):
        warn(notice)
    say_next(f"tree          {result.folder / TREE_FILE}", f"drawing       {result.folder / 'tree.png'}")


@app.command()
def compare(session: SessionArgument, commands_csv: Commands = None, as_json: Json = False) -> None:
    """Compare detected joint angles with commands and read-back.

    Errors are after one sign and one offset a joint, and the camera's lag where it is sure; each joint's own lag and
    gain are shown beside. Writes comparison.csv and comparison.json into the session's report/.
    """
    from station.commands import reporting

    show_comparison(reporting.compare(session, commands=commands_csv), as_json)


@app.command()
def report(session: SessionArgument, commands_csv: Commands = None, as_json: Json = False) -> None:
    """Write a session's report: Figure 7, tables, the tree.

    Without commands, as for a video: the tree, the joints' states, when the parts were seen. Takes a fit's folder, too.
    """
    from station.commands import reporting
    from station.compare import Comparison
    from station.fit_files import TREE_FILE, read_tree
    from station.session import FIT_FOLDER

    comparison = reporting.report(session, commands=commands_csv)
    trees = (folder / TREE_FILE for folder in (session / FIT_FOLDER, session))
    if comparison is not None or as_json:
        show_comparison(comparison or Comparison(()), as_json)
    elif (tree := next(filter(Path.exists, trees), None)) is not None:
        _show_tree(read_tree(tree))
    else:
        warn("nothing was fitted: the report has no tree")
    say_next(f"report        {session / 'report' / 'report.html'}")


@app.command()
def view(session: SessionArgument) -> None:
    """Open a session in the rerun viewer."""
    from station.commands import sessions

    sessions.view(session)


def _estimated(names: str) -> tuple[str, ...]:
    """The camera's numbers that --estimate asks for."""
    known = {"focal": "focal", "readout": "readout_s"}
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    for name in wanted:
        if name not in known:
            raise typer.BadParameter(f"--estimate '{name}'; want focal, readout, or focal,readout")
    return tuple(dict.fromkeys(known[name] for name in wanted))


def _image_line(image: ImageFit) -> str:
    """What the tree was refined on, and what that tells of the camera."""
    from station.fit.noise import INLIER_ABOVE

    outliers = int((image.inlier <= INLIER_ABOVE).sum())
    numbers, std = image.numbers, image.numbers_std
    told = [f"edges are seen {numbers.edge_shift_px:+.4f} ± {std.edge_shift_px:.4f} px outward"]
    if math.isfinite(std.focal):
        told.append(f"focal lengths are {numbers.focal:.5f} ± {std.focal:.5f} of the calibration's")
    if math.isfinite(std.readout_s):
        told.append(f"a frame is read in {1e3 * numbers.readout_s:.2f} ± {1e3 * std.readout_s:.2f} ms")
    seen = f"refined on the corners of {len(image.chi2)} markers in {len(image.views.t_s)} frames, {outliers} outliers"
    return "\n".join([seen, *told])


def _show_tree(tree: KinematicTree) -> None:
    from station.report import tree_rows

    table(f"{len(tree.bodies)} bodies of {len(tree.parts)} tracked parts, root {tree.root}", tree_rows(tree))
    for group in tree.rigid_groups:
        print(f"one body: {', '.join(group)}")
