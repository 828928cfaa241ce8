"""Calibration of an arm: the camera's latency against the servos, the servos' zeros, the markers' scale."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from station.cli.app import calibrate
from station.cli.options import Force, Json, Realtime, RigArgument, Seed, SessionArgument, Simulate, Yes
from station.cli.show import asking, progress, say_next, table, warn

if TYPE_CHECKING:
    from station.commands.arms import CameraLatency, ServoZeros
    from station.commands.capturing import CaptureSettings

Write = Annotated[bool, typer.Option("--write", help="Write the result into the rig; the old file is kept beside it.")]


@calibrate.command()
def latency(
    source: Annotated[
        str,
        typer.Argument(
            metavar="RIG|SESSION", help="Rig whose joints are swung, or a session in which they moved alone."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("--out", help="Session folder of a rig's swings; new or empty.", show_default=False)
    ] = None,
    joint: Annotated[
        list[str] | None, typer.Option("--joint", help="Joint to swing; may be repeated; all revolute ones.")
    ] = None,
    write: Write = False,
    seed: Seed = None,
    simulate: Simulate = False,
    realtime: Realtime = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Measure how late the camera's frames are, against the servos' read-back.

    Of a rig: the arm MOVES. Each joint swings by up to 15 degrees to either side of the park pose, one after the other,
    within all limits. Needs markers on what moves.
    """
    from station.commands import arms
    from station.commands.fitting import is_session
    from station.errors import InvalidData

    of_rig = not is_session(Path(source))
    if of_rig and out is None:
        raise InvalidData(f"'{source}' is no session: to swing the joints of a rig, name a folder with --out")
    if not of_rig and write:
        raise InvalidData("a session doesn't know where its rig's file is: put the line into it by hand")
    if write:
        arms.check_writable(source)
    session = out if of_rig and out is not None else Path(source)
    with progress() as bar:
        if of_rig:
            bar.stage("swing")
            settings: CaptureSettings = {"seed": seed, "simulate": simulate, "realtime": realtime, "force": force}
            settings["progress"] = bar.update
            arms.capture_swings(source, session, joints=joint or [], **settings)
        bar.stage("latency")
        result = arms.latency_of(session)
    if as_json:
        print(json.dumps(_latency_document(result), allow_nan=False))
    else:
        _show_latency(result)
    if write:
        kept = arms.write_into_rig(source, {("camera", "latency_s"): result.value_s})
        say_next(f"written into {source}; the old file is {kept}")
    elif not result.agrees:
        say_next(f"put this line under [camera]{f' in {source}' if of_rig else ' in the rig'}:", f"  {result.line}")


def _show_latency(result: CameraLatency) -> None:
    found = result.found
    print(f"latency_s = {found.latency_s:.4f} +- {found.std_s:.4f} s")
    apart_ms = (result.present_s - found.latency_s) * 1e3
    print(f"the rig says {result.present_s:.4f} s, which {'agrees' if result.agrees else f'is {apart_ms:+.1f} ms off'}")
    rows = [["joint", "latency [ms]", "std [ms]", "frames"]]
    for each in found.joints:
        std = "" if each.lag_std_s is None else f"{each.lag_std_s * 1e3:.2f}"
        rows.append([each.joint, f"{each.lag_s * 1e3:.2f}" if std else "", std, str(each.frames)])
    table("What each joint alone says", rows)
    for warning in result.warnings:
        warn(warning)


def _latency_document(result: CameraLatency) -> dict[str, object]:
    return {
        "latency_s": result.found.latency_s,
        "std_s": result.found.std_s,
        "rig_latency_s": result.present_s,
        "line": result.line,
        "joints": [
            {"joint": each.joint, "latency_s": each.lag_s, "std_s": each.lag_std_s, "frames": each.frames}
            for each in result.found.joints
        ],
        "warnings": list(result.warnings),
    }


@calibrate.command()
def servos(
    rig: RigArgument,
    pose: Annotated[
        list[str] | None,
        typer.Option("--pose", metavar="JOINT=DEG", help="Where a joint is held (deg, mm); 0 if left out; repeatable."),
    ] = None,
    yes: Yes = False,
    write: Write = False,
    simulate: Simulate = False,
    as_json: Json = False,
) -> None:
    """Find the servos' zeros: a person holds the arm in a reference pose.

    Torque goes OFF and stays off: an arm that was held DROPS. You are asked before, and again when the arm is in its
    pose. Exit code 1 if a zero can't be used.
    """
    from station.commands import arms
    from station.errors import StationError

    given = _pose(pose or [])
    if write:
        arms.check_writable(rig)
    result = arms.servo_zeros(rig, pose=given, ask=asking(yes), simulate=simulate)
    if as_json:
        print(json.dumps(_zeros_document(result), allow_nan=False))
    else:
        _show_zeros(result)
    for warning in (text for zero in result.zeros for text in zero.warnings):
        warn(warning)
    if result.problems:
        raise StationError("\n".join(["these zeros can't be used", *result.problems]))
    if write:
        say_next(f"written into {rig}; the old file is {arms.write_into_rig(rig, result.values)}")
    else:
        lines = (f"  zero = {zero.zero:<6} # servo {zero.servo_id}, {zero.joint}" for zero in result.zeros)
        say_next(f"put these into each [[joint.servo]] of {rig}, or use --write:", *lines)


@calibrate.command()
def scale(
    session: SessionArgument,
    axis_distance: Annotated[
        list[str] | None,
        typer.Option(
            "--axis-distance", metavar="JOINT,JOINT=MM", help="Known distance of two joints' axes; may be repeated."
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Check the markers' size by known motion of the arm.

    Of a fitted session: travels of prismatic joints against their read-back, and distances of axes that you know.
    Angles don't tell a size. Exit code 1 if the lengths are off by more than 0.5 % and three standard deviations.
    """
    from station.commands import arms

    result = arms.scale_of(session, _distances(axis_distance or []))
    if as_json:
        lengths = [{"what": each.what, "ratio": each.ratio, "std": each.std} for each in result.lengths]
        document = {"ratio": result.ratio, "std": result.std, "off": result.off, "verdict": result.verdict}
        print(json.dumps({**document, "lengths": lengths}, allow_nan=False))
    else:
        rows = [[each.what, f"{each.ratio:.4f}", f"{each.std:.4f}"] for each in result.lengths]
        table("Fitted over known lengths", [["length", "ratio", "std"], *rows])
        print(result.verdict)
    if result.off:
        raise typer.Exit(1)


def _distances(given: list[str]) -> dict[tuple[str, str], float]:
    from station.errors import InvalidData

    distances: dict[tuple[str, str], float] = {}
    for text in given:
        names, _, value = text.partition("=")
        first, _, second = names.partition(",")
        try:
            distances[first.strip(), second.strip()] = float(value) / 1e3
        except ValueError:
            raise InvalidData(f"--axis-distance {text}: want two joints and mm, such as shoulder,elbow=140") from None
    return distances


def _pose(given: list[str]) -> dict[str, float]:
    from station.errors import InvalidData

    pose: dict[str, float] = {}
    for text in given:
        joint, _, value = text.partition("=")
        try:
            pose[joint.strip()] = float(value)
        except ValueError:
            raise InvalidData(f"--pose {text}: want a joint and where it is held, such as elbow=90") from None
    return pose


def _show_zeros(result: ServoZeros) -> None:
    rows = [["joint", "servo", "zero", "moved by", "std", "spread [counts]"]]
    for zero, unit in zip(result.zeros, result.units, strict=True):
        scale, name = (57.29577951308232, "deg") if unit == "rad" else (1e3, "mm")
        moved, std = f"{scale * zero.moved:+.2f} {name}", f"{scale * zero.std:.2f} {name}"
        rows.append([zero.joint, str(zero.servo_id), str(zero.zero), moved, std, str(zero.spread_counts)])
    table(f"Zeros with the arm held at {result.pose}", rows)


def _zeros_document(result: ServoZeros) -> dict[str, object]:
    return {
        "servos": [
            {
                "joint": zero.joint,
                "servo": zero.servo_id,
                "zero": zero.zero,
                "unit": unit,
                "std": zero.std,
                "moved": zero.moved,
                "spread_counts": zero.spread_counts,
                "problems": list(zero.problems),
                "warnings": list(zero.warnings),
            }
            for zero, unit in zip(result.zeros, result.units, strict=True)
        ]
    }
