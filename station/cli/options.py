"""Arguments and options that several commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Method(StrEnum):
    """Methods of the fit."""

    station = "station"
    paper = "paper"


class Refine(StrEnum):
    """What a tree is refined on."""

    image = "image"
    pose = "pose"
    none = "none"


class Told(StrEnum):
    """Something that is found out, or told."""

    auto = "auto"
    yes = "yes"
    no = "no"


class Frames(StrEnum):
    """Ways to keep images."""

    jpeg = "jpeg"
    none = "none"
    ffv1 = "ffv1"


Out = Annotated[Path, typer.Option("--out", help="Folder for the result; must be new or empty.", show_default=False)]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is in the folder.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Seed = Annotated[
    int | None, typer.Option("--seed", help="Seed of everything random in a simulation.", show_default=False)
]
Resume = Annotated[
    Path | None,
    typer.Option(
        "--resume",
        metavar="SESSION",
        help="Go on with an interrupted session from its last checkpoint, in its own folder.",
        show_default=False,
    ),
]
Realtime = Annotated[bool, typer.Option("--realtime", help="Simulate on the real clock instead of a virtual one.")]
Simulate = Annotated[
    bool, typer.Option("--simulate", help="Emulated servos and a rendered camera, whatever the rig names.")
]
FramesKept = Annotated[
    Frames | None,
    typer.Option(
        "--frames",
        help="How images are kept: jpeg (if not given), none, or ffv1, without loss, which needs the extra 'lossless'.",
        show_default=False,
    ),
]
UntilEnough = Annotated[
    int,
    typer.Option(
        "--until-enough",
        metavar="N",
        min=0,
        help="Go on after the motion, N further rounds at most, while a joint moved too little for a fit where the "
        "camera saw it; 0: don't.",
    ),
]
KnownTree = Annotated[
    Path | None,
    typer.Option(
        "--tree",
        metavar="FIT",
        help="The tree, if it is known: a fitted session, a fit's folder or a kinematics.json. Joint angles are then "
        "seen by the camera while it records, and shown.",
        show_default=False,
    ),
]
View = Annotated[bool, typer.Option("--view", help="Open the rerun viewer on the capture as it goes.")]
Headless = Annotated[
    bool, typer.Option("--headless", help="Serve the live view on 127.0.0.1 and open no viewer: connect one yourself.")
]
Port = Annotated[
    int | None,
    typer.Option("--port", min=1, max=65535, help="Port of the live view; else a free one.", show_default=False),
]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Check the motion and foresee what the camera will see; opens no device.")
]
Yes = Annotated[bool, typer.Option("--yes", help="Don't ask: the arm is held, and may drop.")]
RigArgument = Annotated[
    str, typer.Argument(metavar="RIG", help="Rig: a file, or the name of a packaged one such as demo.")
]
MotionArgument = Annotated[
    str,
    typer.Argument(
        metavar="MOTION",
        help="Motion: a file, the name of a packaged one such as each_joint, or a session's folder or a commands.csv, "
        "which are replayed.",
    ),
]
SessionArgument = Annotated[Path, typer.Argument(metavar="SESSION", help="Session folder.", show_default=False)]
Commands = Annotated[
    Path | None, typer.Option("--commands", help="commands.csv of another clock, in place of the recorded commands.")
]

# Of `capture`, which takes a session instead of these with --resume, and no motion with --hand.
RigOrNone = Annotated[
    str | None, typer.Argument(metavar="RIG", help="Rig: a file, or a packaged one's name.", show_default=False)
]
MotionOrNone = Annotated[
    str | None,
    typer.Argument(
        metavar="[MOTION]",
        help="Motion: a file, a packaged one's name, or a session or commands.csv to replay; none with --hand.",
    ),
]
OutOrNone = Annotated[
    Path | None, typer.Option("--out", help="Session folder; must be new or empty.", show_default=False)
]
Hand = Annotated[bool, typer.Option("--hand", help="Torque OFF: people move the arm, or any marked object.")]
DurationS = Annotated[
    float | None, typer.Option("--duration-s", min=0.1, help="How long to record with --hand; until Ctrl-C.")
]
Freedom = Annotated[
    int | None, typer.Option("--freedom", help="Degrees of freedom of student noise (3).", show_default=False)
]
Flips = Annotated[
    float | None,
    typer.Option("--flips", help="Share of poses that camera noise turns over (0.02).", show_default=False),
]
SimulatedMotion = Annotated[str, typer.Option("--motion", help="walk (the paper's bounded random walk) or smooth.")]
SimulatedRoot = Annotated[str, typer.Option("--root", help="moving, as in the paper, or static.")]
Planar = Annotated[bool, typer.Option("--planar", help="A 2D object: it moves in the xy plane.")]
PlanarNoise = Annotated[bool, typer.Option("--planar-noise", help="With --planar: the noise is in the plane too.")]
Outliers = Annotated[float, typer.Option("--outliers", help="Share of poses that are wrong.")]
Missing = Annotated[float, typer.Option("--missing", help="Share of poses that are not seen.")]
