"""From a motion to Figure 7: demo, run, capture, fit, compare, report, view."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from station.cli.app import app
from station.cli.options import (
    Commands,
    Force,
    Json,
    Method,
    MotionArgument,
    Out,
    Realtime,
    RigArgument,
    Seed,
    SessionArgument,
    Simulate,
    Yes,
)
from station.cli.show import asking, progress, say_next, saying_what_is_left, table, warn

if TYPE_CHECKING:
    from station.compare import Comparison
    from station.kinematics.tree import KinematicTree


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", help="Session folder; must be new or empty.")] = Path("demo"),
    seed: Seed = None,
    realtime: Realtime = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run the whole station without hardware, to Figure 7.

    Captures the packaged demo motion on an emulated arm and a rendered camera, fits the recording, and compares the
    detected joint angles with the commands and the read-back.
    """
    _run("demo", "demo", out, as_json, seed=seed, realtime=realtime, force=force)


@app.command()
def run(
    rig: RigArgument,
    motion: MotionArgument,
    out: Out,
    seed: Seed = None,
    simulate: Simulate = False,
    realtime: Realtime = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Capture, fit, compare and report in one go."""
    _run(rig, motion, out, as_json, seed=seed, simulate=simulate, realtime=realtime, force=force)


def _run(rig: str, motion: str, out: Path, as_json: bool, **settings: Any) -> None:
    from station.commands import sessions

    with saying_what_is_left(out), progress() as bar:
        comparison = sessions.run(rig, motion, out, stage=bar.stage, progress=bar.update, **settings)
    _show_comparison(comparison, as_json)
    say_next(
        f"Figure 7      {out / 'report' / 'figure7.png'}",
        f"report        {out / 'report' / 'report.html'}",
        f"tree          {out / 'fit' / 'kinematics.json'}",
        f"recording     station view {out}",
    )


@app.command()
def capture(
    rig: RigArgument,
    out: Out,
    motion: Annotated[
        str | None,
        typer.Argument(metavar="[MOTION]", help="Motion: a file, or a packaged one's name; none with --hand."),
    ] = None,
    hand: Annotated[
        bool, typer.Option("--hand", help="Torque OFF: people move the arm, or any marked object.")
    ] = False,
    duration_s: Annotated[
        float | None, typer.Option("--duration-s", min=0.1, help="How long to record with --hand; until Ctrl-C.")
    ] = None,
    yes: Yes = False,
    seed: Seed = None,
    simulate: Simulate = False,
    realtime: Realtime = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run a motion on a rig and record it into a session folder; with --hand, record what people move.

    With --hand torque goes off and stays off: an arm that was held DROPS, and you are asked before. The rig needs no
    servos then. Ctrl-C is the normal end.
    """
    from station.commands import capturing

    if hand == (motion is not None):
        raise typer.BadParameter("want a motion, or --hand" if not hand else "want a motion or --hand, not both")
    if duration_s is not None and not hand:
        raise typer.BadParameter("--duration-s goes with --hand; a motion lasts as long as it does")
    if hand:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job has it ignored
    settings: dict[str, Any] = {"seed": seed, "simulate": simulate, "realtime": realtime, "force": force}
    with saying_what_is_left(out), progress() as bar:
        bar.stage("by hand" if hand else "capture")
        settings["progress"] = bar.update
        if motion is None:
            counts = capturing.capture_by_hand(rig, out, ask=asking(yes), duration_s=duration_s, **settings)
        else:
            counts = capturing.capture(rig, motion, out, **settings)
    if as_json:
        print(json.dumps(counts.as_dict()))
    else:
        for name, number in counts.as_dict().items():
            print(f"{name.replace('_', ' '):16} {number}")
    say_next(f"fit it        station fit {out}")


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
    smooth: Annotated[
        str | None,
        typer.Option(
            "--smooth",
            help="Smooth the poses first: lowpass:HZ, kalman, or kalman:S (fills gaps up to S s). "
            "It correlates their noise: stated deviations get too small.",
            show_default=False,
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Discover the kinematic tree in a session or a log of poses.

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
    )
    result = fitting.fit(source, out, options=options, smooth=smooth, force=force)
    if as_json:
        print((result.folder / TREE_FILE).read_text(encoding="utf-8"))
    else:
        _show_tree(result.fit.tree)
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

    _show_comparison(reporting.compare(session, commands=commands_csv), as_json)


@app.command()
def report(session: SessionArgument, commands_csv: Commands = None, as_json: Json = False) -> None:
    """Write a session's report: Figure 7, tables, the tree.

    Without commands, as for a video: the tree, the joints' states, when the parts were seen.
    """
    from station.commands import reporting
    from station.compare import Comparison
    from station.fit_files import read_fit
    from station.session import FIT_FOLDER

    comparison = reporting.report(session, commands=commands_csv)
    if comparison is not None or as_json:
        _show_comparison(comparison or Comparison(()), as_json)
    else:
        _show_tree(read_fit(session / FIT_FOLDER).tree)
    say_next(f"report        {session / 'report' / 'report.html'}")


@app.command()
def view(session: SessionArgument) -> None:
    """Open a session in the rerun viewer."""
    from station.commands import sessions

    sessions.view(session)


def _show_comparison(comparison: Comparison, as_json: bool) -> None:
    from station.comparison_files import comparison_json
    from station.report import session_lag_text, summary_rows

    if as_json:
        print(comparison_json(comparison))
        return
    told = not comparison.joints or any(joint.against_commanded is not None for joint in comparison.joints)
    against = "read-back and command" if told else "read-back (there are no commands)"
    table(f"Detected against {against}, after sign, offset and the session's lag", summary_rows(comparison))
    if comparison.joints:
        print(session_lag_text(comparison))
    for name in comparison.unmatched_commanded:
        warn(f"{name}: no detected joint follows it")
    for name in comparison.unmatched_fitted:
        warn(f"{name}: detected, but follows no joint of the arm")


def _show_tree(tree: KinematicTree) -> None:
    from station.report import tree_rows

    table(f"{len(tree.bodies)} bodies of {len(tree.parts)} tracked parts, root {tree.root}", tree_rows(tree))
    for group in tree.rigid_groups:
        print(f"one body: {', '.join(group)}")
