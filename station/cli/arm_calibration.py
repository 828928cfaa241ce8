"""Calibration of an arm: the camera's latency against the servos, the servos' zeros, the markers' scale."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from station.cli.app import calibrate
from station.cli.options import Force, Json, Realtime, Seed, Simulate
from station.cli.show import progress, say_next, table, warn

if TYPE_CHECKING:
    from station.arm_calibration import CameraLatency

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
    from station import arm_calibration
    from station.errors import InvalidData
    from station.session import RECORDING_FILE

    session = Path(source)
    of_rig = not (session.suffix == ".rrd" or (session / RECORDING_FILE).exists())
    if of_rig and out is None:
        raise InvalidData(f"'{source}' is no session: to swing the joints of a rig, name a folder with --out")
    if not of_rig and write:
        raise InvalidData("a session doesn't know where its rig's file is: put the line into it by hand")
    if write:
        arm_calibration.check_writable(source)
    with progress() as bar:
        if of_rig and out is not None:
            bar.stage("swing")
            arm_calibration.capture_swings(
                source,
                out,
                joints=joint or [],
                seed=seed,
                simulate=simulate,
                realtime=realtime,
                force=force,
                progress=bar.update,
            )
            session = out
        bar.stage("latency")
        result = arm_calibration.latency_of(session)
    if as_json:
        print(json.dumps(_latency_document(result), allow_nan=False))
    else:
        _show_latency(result)
    if write:
        kept = arm_calibration.write_into_rig(source, {("camera", "latency_s"): result.value_s})
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
