"""Files of others: track a video into a session."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from station.cli.app import app
from station.cli.options import Force, Json, Out
from station.cli.show import progress, say_next, saying_what_is_left, table, warn

if TYPE_CHECKING:
    from station.videos.tally import MarkerRow


@app.command()
def track(
    video: Annotated[str, typer.Argument(metavar="VIDEO", help="Video file, or folder of images.", show_default=False)],
    camera: Annotated[
        str,
        typer.Option(
            "--camera", help="camera.toml, OpenCV's YAML or XML, ROS's camera_info YAML, or a rig.", show_default=False
        ),
    ],
    markers: Annotated[str, typer.Option("--markers", help="markers.toml, or a rig.", show_default=False)],
    out: Out,
    timestamps: Annotated[
        Path | None,
        typer.Option("--timestamps", help="CSV frame,t_s in place of the video's own stamps.", show_default=False),
    ] = None,
    fps: Annotated[
        float | None, typer.Option("--fps", min=0.001, help="Frames a second of images.", show_default=False)
    ] = None,
    scale_camera: Annotated[
        bool, typer.Option("--scale-camera", help="Scale the calibration to the size of the video.")
    ] = False,
    frames: Annotated[bool, typer.Option("--frames/--no-frames", help="Keep the images in the recording.")] = True,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Find the markers in a video and make a session of it.

    Then: station fit DIR, station view DIR, station report DIR. Frames without a stamp are left out.
    """
    from station.commands import videos

    with saying_what_is_left(out), progress() as bar:
        bar.stage("track")
        tracked = videos.track(
            video,
            camera=camera,
            markers=markers,
            out=out,
            timestamps=timestamps,
            fps=fps,
            scale_camera=scale_camera,
            keep_frames=frames,
            force=force,
            progress=bar.update,
        )
    if as_json:
        print(json.dumps(tracked.as_dict(), allow_nan=False))
    else:
        table(f"{tracked.counts['frames']} frames of {Path(video).name}", _marker_rows(tracked.markers))
    for warning in tracked.warnings:
        warn(warning)
    say_next(f"fit it        station fit {out}", f"see it        station view {out}")


def _marker_rows(rows: tuple[MarkerRow, ...]) -> list[list[str]]:
    header = ["marker", "part", "seen in", "longest gap", "median tilt\n[deg]", "median error\n[px]"]
    return [header, *(_marker_row(row) for row in rows)]


def _marker_row(row: MarkerRow) -> list[str]:
    return [
        str(row.marker_id),
        row.part,
        f"{row.seen} of {row.frames}",
        f"{row.gap_frames} ({row.gap_s:.2f} s)" if row.gap_frames else "none",
        "" if row.tilt_deg is None else f"{row.tilt_deg:.0f}",
        "" if row.rms_px is None else f"{row.rms_px:.3f}",
    ]


@app.command()
def export(
    source: Annotated[
        Path,
        typer.Argument(metavar="INPUT", help="Session, recording.rrd, fit folder, log of poses, or calibration."),
    ],
    out: Annotated[
        Path, typer.Option("--out", help="File, whose ending tells the format; or a folder.", show_default=False)
    ],
    what: Annotated[
        list[str] | None,
        typer.Option(
            "--what",
            help="poses, states, commands, readings, tree, observations, camera or images; may be repeated.",
            show_default=False,
        ),
    ] = None,
    format_: Annotated[
        str | None,
        typer.Option("--format", help="csv, tum, parquet, urdf, json, mcap, toml, opencv, ros.", show_default=False),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Write what an input has in the formats of others.

    A session becomes poses.csv, TUM files (one a part), Parquet or MCAP; a fit becomes URDF; a calibration becomes
    OpenCV's or ROS's.
    """
    from station.commands import exports

    written = exports.export(source, out, what=what or (), format=format_, force=force)
    if as_json:
        print(json.dumps({"files": [str(path) for path in written]}))
    else:
        for path in written:
            print(path)
